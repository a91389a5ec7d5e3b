"""Whether a gripper at a given pose lifts an object: contacts and weight."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from xray_drake.cell.gripper import GripperSpec, load_gripper
from xray_drake.configuration import number
from xray_drake.grasping.gripper_geometry import gripper_geometry
from xray_drake.grasping.wrench import suction_holding_force

GRAVITY = 9.81
"""m/s²."""

DOWN = np.array([0.0, 0.0, -1.0])
"""Direction of gravity in the world."""

TOO_WEAK = "holds "
"""How the reason begins where the contacts cannot hold the weight."""


def too_weak(holding: float, weight: float) -> str:
    """Returns the reason of a grasp that cannot hold a weight, both in N."""
    return f"{TOO_WEAK}{holding:.2f} N, weighs {weight:.2f} N"


@dataclass
class JudgementConfig:
    """How execution is judged."""

    # Free space between each pad and the object while the jaw descends, m.
    clearance: float = number(0.005, "[0, 0.1]")
    # The gripper stops at contact at most this far before the given pose, m;
    # if it would have to stop earlier, the grasp fails.
    max_retreat: float = number(0.006, "[0, 0.1]")
    # In execution it is commanded this far beyond the given pose, m, because
    # it stops at contact anyway.
    overtravel: float = number(0.002, "[0, 0.1]")
    # Distance that the fingertips keep from the bin's floor, m.
    floor_clearance: float = number(0.0005, "[0, 0.1]")
    # Length of the straight approach that must be free, m.
    approach_distance: float = number(0.10, "(0, 1]")
    # The rigid part of the cup ends this far before its lip, m.
    cup_standoff: float = number(0.002, "[0, 0.1]")
    # A cup seals where the surface is this near the lip's plane, m, …
    seal_tolerance: float = number(0.0025, "(0, 0.1]")
    # … and its normals deviate by no more than this, rad. Both together let
    # the cup seal on cylinders of 25 mm radius, as bellows cups do.
    seal_angle: float = number(0.70, "(0, 1.5708]")


@dataclass(frozen=True, eq=False)
class JudgedGrasp:
    """What would come of a grasp.

    Attributes:
        quality: in [0, 1]; 0 where the object is not lifted.
        reason: why not, one line; empty where it is.
        X_WG: (4, 4) pose at which the gripper stops.
        width: distance of the pads when closed, m; 0 for suction.
        holding: the largest weight that the contacts hold, N; 0 where it did
            not come to that.
        space: free around the gripper, m; inf where nobody has measured it.
    """

    quality: float
    reason: str
    X_WG: np.ndarray
    width: float = 0.0
    holding: float = 0.0
    space: float = np.inf

    @property
    def is_too_weak(self) -> bool:
        """The contacts cannot hold the weight; nothing else is wrong."""
        return self.reason.startswith(TOO_WEAK)


class Lip(NamedTuple):
    """The lip of a cup, and what it seals on.

    Attributes:
        radius: m.
        tolerance: largest distance of the surface under the lip from its
            plane, m.
        max_normal_angle: largest deviation of the surface's normals, rad.
    """

    radius: float
    tolerance: float
    max_normal_angle: float

    def loosened(self, factor: float, wider: float = 0.0) -> "Lip":
        """Returns one wider by so much, m, that seals on rougher surfaces."""
        return Lip(
            self.radius + wider,
            factor * self.tolerance,
            min(factor * self.max_normal_angle, np.pi),
        )


class GripperModel:
    """What the gripper can do, where its parts are, and how it is judged.

    Attributes:
        spec: its limits.
        config: how execution is judged.
        geometry: its frames and boxes.
        lip: of its cup.
    """

    def __init__(
        self,
        spec: GripperSpec | None = None,
        config: JudgementConfig | None = None,
    ) -> None:
        """Reads its model.

        Args:
            spec: of the gripper; by default the nominal cell's.
            config: how execution is judged.

        Raises:
            ConfigurationError: the model cannot be read, or is not of that
                gripper.
        """
        self.spec = spec or load_gripper()
        self.config = config or JudgementConfig()
        self.geometry = gripper_geometry(self.spec)
        self.lip = Lip(
            self.spec.cup_radius,
            self.config.seal_tolerance,
            self.config.seal_angle,
        )
        finger = int(np.flatnonzero(self.geometry.closing)[0])
        self._tip_y = float(
            self.geometry.upper[finger, 1] - self.geometry.lower[finger, 1]
        )

    def opening(self, width: np.ndarray) -> np.ndarray:
        """Returns the (...) openings with which the jaw descends, m.

        Args:
            width: (...) distances of the contacts, m.
        """
        return np.minimum(width + 2 * self.config.clearance, self.spec.opening)

    def most_held(self, friction: float) -> float:
        """Returns two friction cones' edges: no jaw holds more, N."""
        return 2 * self.spec.force * float(np.sqrt(1 + friction**2))

    def cup_holds(
        self,
        R_WC: np.ndarray,
        lever: np.ndarray,
        friction: np.ndarray | float,
    ) -> np.ndarray:
        """Returns the (n,) largest weights that sealed cups hold, N.

        Args:
            R_WC: (n, 3, 3) contact frames, z into the object.
            lever: (n, 3) centre of mass minus the lip's centre, in W, m.
            friction: Coulomb coefficients.
        """
        return suction_holding_force(
            np.einsum("nji,nj->ni", R_WC, lever),
            np.einsum("nji,j->ni", R_WC, DOWN),
            self.spec,
            friction,
        )

    def floor_retreat(
        self, X_WG: np.ndarray, opening: np.ndarray | float
    ) -> np.ndarray:
        """Returns how far short of a pose the fingertips meet the floor, m.

        Negative where they would have to go further to meet it.

        Args:
            X_WG: (..., 4, 4) commanded poses of the jaw.
            opening: (...) distance of the pads, m.

        Returns:
            (...) array; inf where the approach does not descend.
        """
        half_x = 0.5 * self.spec.pad_width
        half_y = 0.5 * np.asarray(opening) + self._tip_y
        lowest = (
            X_WG[..., 2, 3]
            + X_WG[..., 2, 2] * self.geometry.tip_length
            - np.abs(X_WG[..., 2, 0]) * half_x
            - np.abs(X_WG[..., 2, 1]) * half_y
        )
        descent = -X_WG[..., 2, 2]
        need = self.config.floor_clearance - lowest
        return np.where(descent > 0.1, need / np.maximum(descent, 0.1), np.inf)
