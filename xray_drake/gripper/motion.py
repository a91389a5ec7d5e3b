"""Smooth straight motions, and the wrench that makes a body follow one."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from xray_drake.messages import Message


@dataclass(frozen=True, eq=False)
class Segment(Message):
    """A straight motion from rest to rest.

    Attributes:
        start: 4×4 pose at time ``begin``, m.
        end: 4×4 pose at time ``begin + duration``, m.
        begin: s.
        duration: s; positive.
    """

    start: np.ndarray
    end: np.ndarray
    begin: float
    duration: float

    def is_over(self, time: float) -> bool:
        """Says whether the end is reached at ``time`` (s)."""
        return time >= self.begin + self.duration

    def sample(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns the motion at a time, held at either end.

        The way is a quintic in time, so that velocity and acceleration begin
        and end at zero.

        Args:
            time: s.

        Returns:
            4×4 pose, (3,) velocity in m/s and (3,) acceleration in m/s² of its
            origin. The angular velocity is not returned: what follows a
            segment by force keeps its orientation.
        """
        s = float(np.clip((time - self.begin) / self.duration, 0.0, 1.0))
        way = min(s**3 * (10 - 15 * s + 6 * s**2), 1.0)
        speed = 30 * s**2 * (1 - s) ** 2 / self.duration
        bend = 60 * s * (1 - s) * (1 - 2 * s) / self.duration**2
        step = self.end[:3, 3] - self.start[:3, 3]
        turns = Slerp(
            [0, 1], Rotation.from_matrix([self.start[:3, :3], self.end[:3, :3]])
        )
        pose = np.eye(4)
        pose[:3, :3] = turns(way).as_matrix()
        pose[:3, 3] = self.start[:3, 3] + way * step
        return pose, speed * step, bend * step


def straight(
    start: np.ndarray,
    to: np.ndarray,
    begin: float,
    *,
    speed: float,
    shortest: float = 0.2,
) -> Segment:
    """Returns a translation to a point.

    Args:
        start: 4×4 pose, m.
        to: (3,) point that the origin goes to, m.
        begin: s.
        speed: highest speed on the way, m/s.
        shortest: least duration, s.
    """
    end = np.array(start)
    end[:3, 3] = to
    distance = float(np.linalg.norm(end[:3, 3] - start[:3, 3]))
    return Segment(start, end, begin, max(1.875 * distance / speed, shortest))


def tracking_wrench(
    *,
    mass: float,
    inertia_W: np.ndarray,
    desired: tuple[np.ndarray, np.ndarray, np.ndarray],
    R_WO: np.ndarray,
    p_WCom: np.ndarray,
    w_WO: np.ndarray,
    v_WCom: np.ndarray,
    frequency: float,
    gravity: float = 9.81,
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the wrench of a critically damped spring to a moving pose.

    The spring is scaled by the body's own mass and inertia, so that a 3 g
    target and a 400 g bottle follow alike, and one time step is safe for both:
    evaluated explicitly at step h, it is stable while ``frequency``·h < 0.5.

    Args:
        mass: kg.
        inertia_W: (3, 3) about the centre of mass, in the world, kg·m².
        desired: 4×4 pose of body frame orientation with the centre of mass as
            its origin, its (3,) velocity and its (3,) acceleration.
        R_WO: (3, 3) orientation.
        p_WCom: (3,) centre of mass, m.
        w_WO: (3,) angular velocity, rad/s.
        v_WCom: (3,) velocity of the centre of mass, m/s.
        frequency: natural frequency of the spring, rad/s.
        gravity: to hold the body against, m/s².

    Returns:
        (3,) torque in N·m and (3,) force in N at the centre of mass, in the
        world.
    """
    X, v, a = desired
    stiffness, damping = frequency**2, 2 * frequency
    turn = Rotation.from_matrix(X[:3, :3] @ R_WO.T).as_rotvec()
    torque = inertia_W @ (stiffness * turn - damping * w_WO)
    force = mass * (
        a
        + stiffness * (X[:3, 3] - p_WCom)
        + damping * (v - v_WCom)
        + np.array([0.0, 0.0, gravity])
    )
    return torque, force
