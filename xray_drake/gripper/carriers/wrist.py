"""Kinematics and paths of the Cartesian wrist."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, ModelInstanceIndex
from scipy.spatial.transform import Rotation

from xray_drake.cell.cell import Cell
from xray_drake.gripper.carriers.carrier import ReachError, Tracking
from xray_drake.gripper.carriers.paths import Leg, Path, straight_path
from xray_drake.gripper.models import (
    JointLimits,
    add_carrier,
    joint_limits,
    moving_joints,
)
from xray_drake.messages import Message

JOINTS = ("x", "y", "z", "yaw", "pitch", "roll")
"""The wrist's joints in the order of all vectors here: m and rad."""


_UP = 2
"""Index of the vertical slide among the joints."""


@dataclass(frozen=True, eq=False)
class Wrist(Message):
    """Three slides, then yaw, pitch and roll about axes through one point.

    The tool frame T has its origin at that point, turned against the flange F
    by the mount.

    Attributes:
        R_FT: (3, 3) orientation of the tool on the flange.
        limits: of its six joints.
        mass: (3,) that each slide moves, the gripper included, kg.
        home: (6,) joint positions in which it waits.
    """

    R_FT: np.ndarray
    limits: JointLimits
    mass: np.ndarray
    home: np.ndarray = field(default_factory=lambda: np.zeros(6))
    name: ClassVar[str] = "wrist"

    @property
    def highest(self) -> float:
        """The tool's origin is carried about no higher than this, m."""
        return float(self.limits.upper[_UP])

    def pose(self, q: np.ndarray) -> np.ndarray:
        """Returns the 4×4 pose X_WT at joint positions (6,)."""
        X_WT = np.eye(4)
        R_WF = Rotation.from_euler("ZYX", q[3:]).as_matrix()
        X_WT[:3, :3] = R_WF @ self.R_FT
        X_WT[:3, 3] = q[:3]
        return X_WT

    def joints(self, X_WT: np.ndarray, *, near: np.ndarray) -> np.ndarray:
        """Returns the (6,) joint positions at a tool pose.

        Yaw and roll are those within half a turn of ``near``. At pitch ±90°,
        where they turn about the same axis, yaw stays.

        Args:
            X_WT: 4×4, m.
            near: (6,) joint positions.

        Raises:
            ReachError: beyond the joints' limits.
        """
        R_WF = X_WT[:3, :3] @ self.R_FT.T
        pitch = np.arctan2(-R_WF[2, 0], np.hypot(R_WF[0, 0], R_WF[1, 0]))
        if abs(pitch) < np.pi / 2 - 1e-6:
            yaw = np.arctan2(R_WF[1, 0], R_WF[0, 0])
        else:
            yaw = near[3]
        R_GF = Rotation.from_euler("ZY", [yaw, pitch]).as_matrix().T @ R_WF
        roll = np.arctan2(R_GF[2, 1], R_GF[1, 1])
        q = np.array([*X_WT[:3, 3], yaw, pitch, roll])
        turn = q[[3, 5]] - near[[3, 5]]
        q[[3, 5]] -= 2 * np.pi * np.round(turn / (2 * np.pi))
        lower, upper = self.limits.lower, self.limits.upper
        beyond = (q < lower - 1e-9) | (q > upper + 1e-9)
        if beyond.any():
            names = ", ".join(np.array(JOINTS)[beyond])
            raise ReachError(f"out of the wrist's reach: {names}")
        return q

    def along(
        self, poses: Sequence[np.ndarray], *, near: np.ndarray
    ) -> list[np.ndarray]:
        """Returns joint positions at poses that a straight way leads through.

        Raises:
            ReachError: beyond the joints' limits.
        """
        return [self.joints(X_WT, near=near) for X_WT in poses]

    def at_height(self, q: np.ndarray, height: float) -> np.ndarray:
        """Returns q with the tool straight above or below, at a height (m)."""
        q = np.array(q)
        q[_UP] = height
        return q

    def over(
        self,
        q: np.ndarray,
        p_T: np.ndarray,
        place: np.ndarray,
        *,
        lowest: float,
    ) -> np.ndarray:
        """Returns q with a point of the tool over a place, or as near as it is.

        Args:
            q: (6,) joint positions.
            p_T: (3,) the point in the tool frame, m.
            place: (2,) in the world, m.
            lowest: for other carriers; a wrist comes down anywhere.
        """
        q = np.array(q)
        X_WT = self.pose(q)
        q[:2] += place - (X_WT[:3, :3] @ p_T + X_WT[:3, 3])[:2]
        q[:2] = np.clip(q[:2], self.limits.lower[:2], self.limits.upper[:2])
        return q

    def force(self, tracking: Tracking) -> np.ndarray:
        """Returns the (3,) force that the tool presses with, N.

        What the slides' drives exert without what it takes to accelerate wrist
        and gripper, while the tool does not turn.
        """
        effort = tracking.effort(self.limits)[:3]
        return effort - self.mass * tracking.a_desired[:3]

    def path(
        self,
        start: np.ndarray,
        legs: Sequence[Leg],
        begin: float,
        *,
        acceleration: float = np.inf,
    ) -> Path:
        """Returns a path from rest to rest along legs, resting between them."""
        slides = np.arange(len(start)) < 3
        limits = self.limits
        return straight_path(
            start,
            legs,
            begin,
            velocity=limits.velocity,
            acceleration=np.minimum(
                limits.acceleration, np.where(slides, acceleration, np.inf)
            ),
        )


def add_wrist(
    plant: MultibodyPlant, cell: Cell
) -> tuple[ModelInstanceIndex, Frame]:
    """Adds the wrist to a plant; returns it and its tool frame."""
    return add_carrier(plant, "wrist.sdf", "wrist_base", np.eye(4))


def make_wrist(
    plant: MultibodyPlant,
    instance: ModelInstanceIndex,
    hand: ModelInstanceIndex,
    X_BJ: np.ndarray,
    cell: Cell,
) -> Wrist:
    """Returns the kinematics of the wrist in a plant.

    Args:
        plant: holds it.
        instance: the wrist.
        hand: the gripper on it.
        X_BJ: 4×4 pose of the jaw frame in the tool frame, m.
        cell: says where home is.

    Raises:
        ReachError: it cannot be at home.
    """
    tool = plant.GetFrameByName("tool", instance)
    own = [
        joint.child_body().default_mass()
        for joint in moving_joints(plant, instance)
    ]
    held = [
        plant.get_body(index).default_mass()
        for index in plant.GetBodyIndices(hand)
    ]
    wrist = Wrist(
        R_FT=tool.GetFixedPoseInBodyFrame().rotation().matrix(),
        limits=joint_limits(plant, instance),
        mass=(np.cumsum(own[::-1])[::-1] + sum(held))[:3],
    )
    X_WT = cell.X_WH @ np.linalg.inv(X_BJ)
    return replace(wrist, home=wrist.joints(X_WT, near=wrist.home))
