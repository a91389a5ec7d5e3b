"""Kinematics of the Cartesian wrist: joint positions and tool poses."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from xray_drake.messages import Message

JOINTS = ("x", "y", "z", "yaw", "pitch", "roll")
"""The wrist's joints in the order of all vectors here: m and rad."""


class ReachError(ValueError):
    """A pose that the wrist cannot take; the message is one line."""


@dataclass(frozen=True, eq=False)
class Wrist(Message):
    """Three slides, then yaw, pitch and roll about axes through one point.

    The tool frame T has its origin at that point, turned against the flange F
    by the mount.

    Attributes:
        R_FT: (3, 3) orientation of the tool on the flange.
        lower: (6,) lowest positions, m and rad.
        upper: (6,) highest positions, m and rad.
        velocity: (6,) highest speeds, m/s and rad/s.
        acceleration: (6,) highest accelerations, m/s² and rad/s².
        stiffness: (6,) of the position control, N/m and N·m/rad.
    """

    R_FT: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    stiffness: np.ndarray

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
        beyond = (q < self.lower - 1e-9) | (q > self.upper + 1e-9)
        if beyond.any():
            names = ", ".join(np.array(JOINTS)[beyond])
            raise ReachError(f"out of the wrist's reach: {names}")
        return q
