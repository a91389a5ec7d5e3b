"""Smooth straight motions, and the grip that makes a body follow one."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from pydrake.math import RotationMatrix
from scipy.spatial.transform import Rotation

from xray_drake.grasping.judgement import GRAVITY
from xray_drake.messages import Message

_SHORTEST = 0.2
"""No motion takes less time, s."""


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
        s = min(max((time - self.begin) / self.duration, 0.0), 1.0)
        way = min(s**3 * (10 - 15 * s + 6 * s**2), 1.0)  # rounding
        speed = 30 * s**2 * (1 - s) ** 2 / self.duration
        bend = 60 * s * (1 - s) * (1 - 2 * s) / self.duration**2
        step = self.end[:3, 3] - self.start[:3, 3]
        pose = np.array(self.start)
        pose[:3, 3] += way * step
        if self._turn.any():
            turn = Rotation.from_rotvec(way * self._turn).as_matrix()
            pose[:3, :3] = turn @ self.start[:3, :3]
        return pose, speed * step, bend * step

    @cached_property
    def _turn(self) -> np.ndarray:
        """The rotation from start to end, as (3,) angle × axis; often zero."""
        if np.array_equal(self.start[:3, :3], self.end[:3, :3]):
            return np.zeros(3)
        return Rotation.from_matrix(
            self.end[:3, :3] @ self.start[:3, :3].T
        ).as_rotvec()


def straight(
    start: np.ndarray,
    to: np.ndarray,
    begin: float,
    *,
    speed: float,
) -> Segment:
    """Returns a translation to a point.

    Args:
        start: 4×4 pose, m.
        to: (3,) point that the origin goes to, m.
        begin: s.
        speed: highest speed on the way, m/s.
    """
    end = np.array(start)
    end[:3, 3] = to
    distance = float(np.linalg.norm(end[:3, 3] - start[:3, 3]))
    return Segment(start, end, begin, max(1.875 * distance / speed, _SHORTEST))


@dataclass(frozen=True)
class Grip:
    """The spring between an ideal gripper and what it holds.

    Attributes:
        stiffness: N/m.
        damping: N·s/m.
        arm: the spring resists rotation as if it were this far out, m.
        force: largest pull beyond the object's own weight, N.
        step: of the simulation, s.
    """

    stiffness: float = 450.0
    damping: float = 30.0
    arm: float = 0.03
    force: float = 20.0
    step: float = 0.005

    def wrench(
        self,
        *,
        mass: float,
        inertia_W: np.ndarray,
        desired: tuple[np.ndarray, np.ndarray, np.ndarray],
        R_WO: np.ndarray,
        p_WCom: np.ndarray,
        w_WO: np.ndarray,
        v_WCom: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Returns the wrench that draws a body to a moving pose.

        A stiff spring evaluated explicitly throws light bodies (a 3 g target
        went to NaN). So it is evaluated by backward Euler: the force is the one
        that the spring would have at the end of the step, were the body free.
        With x and v the lag and its rate, m the mass and h the step,
        f = (K (x + h v) + C v) / (1 + (h C + h² K) / m), and the same for
        rotation.

        Args:
            mass: kg.
            inertia_W: (3, 3) about the centre of mass, in the world, kg·m².
            desired: 4×4 pose with the body's orientation and the centre of
                mass as its origin, its (3,) velocity and (3,) acceleration.
            R_WO: (3, 3) orientation.
            p_WCom: (3,) centre of mass, m.
            w_WO: (3,) angular velocity, rad/s.
            v_WCom: (3,) velocity of the centre of mass, m/s.

        Returns:
            (3,) torque in N·m and (3,) force in N at the centre of mass, in
            the world.
        """
        X, v, a = desired
        K, C, h = self.stiffness, self.damping, self.step
        lag, rate = X[:3, 3] - p_WCom, v - v_WCom
        share = 1 + (h * C + h**2 * K) / mass
        pull = (K * (lag + h * rate) + C * rate) / share
        size = float(np.linalg.norm(pull))
        if size > self.force:
            pull *= self.force / size
        force = pull + mass * (a + np.array([0.0, 0.0, GRAVITY]))

        K, C = K * self.arm**2, C * self.arm**2
        error = RotationMatrix(X[:3, :3] @ R_WO.T).ToAngleAxis()
        turn = error.angle() * error.axis()
        system = np.eye(3) + (h * C + h**2 * K) * np.linalg.inv(inertia_W)
        torque = np.linalg.solve(system, K * (turn - h * w_WO) - C * w_WO)
        size = float(np.linalg.norm(torque))
        if size > self.force * self.arm:
            torque *= self.force * self.arm / size
        return torque, force
