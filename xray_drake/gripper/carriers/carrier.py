"""What moves the gripper about: all that its controller needs to know."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from xray_drake.gripper.carriers.paths import Leg, Path
from xray_drake.gripper.models import JointLimits
from xray_drake.gripper.transfer import TransferError


class ReachError(TransferError):
    """A pose that a carrier cannot take; the message is one line."""


@dataclass(frozen=True, eq=False)
class Tracking:
    """How n joints follow what is desired of them.

    Attributes:
        q: (n,) positions, m or rad.
        v: (n,) velocities.
        q_desired: (n,) positions that they should have by now.
        v_desired: (n,) velocities likewise.
        a_desired: (n,) accelerations likewise.
    """

    q: np.ndarray
    v: np.ndarray
    q_desired: np.ndarray
    v_desired: np.ndarray
    a_desired: np.ndarray

    def effort(self, limits: JointLimits) -> np.ndarray:
        """Returns the (n,) efforts of the position control, N and N·m."""
        return limits.stiffness * (self.q_desired - self.q) + limits.damping * (
            self.v_desired - self.v
        )


class Carrier(Protocol):
    """A wrist or an arm with n joints that holds the gripper at its tool frame.

    The tool frame T is the frame of the gripper's base. Poses X_WT are 4×4, m;
    joint positions q are (n,), m or rad.
    """

    @property
    def name(self) -> str:
        """What messages call it."""

    @property
    def limits(self) -> JointLimits:
        """What its joints can do."""

    @property
    def home(self) -> np.ndarray:
        """The joint positions in which it waits."""

    @property
    def highest(self) -> float:
        """The tool's origin is carried about no higher than this, m."""

    def pose(self, q: np.ndarray) -> np.ndarray:
        """Returns the pose X_WT at joint positions."""

    def along(
        self, poses: Sequence[np.ndarray], *, near: np.ndarray
    ) -> list[np.ndarray]:
        """Returns joint positions at poses that a straight way leads through.

        Args:
            poses: X_WT, one or more.
            near: joint positions; of several solutions those near them.

        Raises:
            ReachError: it cannot be at one of them, or not go straight.
        """

    def at_height(self, q: np.ndarray, height: float) -> np.ndarray:
        """Returns q with the tool straight above or below.

        Where the tool cannot go as far, it goes as far as it can.

        Args:
            q: joint positions.
            height: of the tool's origin, m.
        """

    def over(
        self,
        q: np.ndarray,
        p_T: np.ndarray,
        place: np.ndarray,
        *,
        lowest: float,
    ) -> np.ndarray:
        """Returns q with a point of the tool over a place.

        The tool keeps its height and its tilt; it may turn about the vertical.

        Args:
            q: joint positions.
            p_T: (3,) the point in the tool frame, m.
            place: (2,) in the world, m.
            lowest: height that the tool's origin is to come down to there, m.

        Raises:
            ReachError: beyond its reach.
        """

    def force(self, tracking: Tracking) -> np.ndarray:
        """Returns the (3,) force that the tool presses with, N."""

    def path(
        self,
        start: np.ndarray,
        legs: Sequence[Leg],
        begin: float,
        *,
        acceleration: float,
    ) -> Path:
        """Returns a path from rest to rest along legs, resting between them.

        Args:
            start: joint positions.
            legs: one or more.
            begin: s.
            acceleration: the tool's origin accelerates no more, m/s².

        Raises:
            ReachError: it cannot go along a straight leg.
        """
