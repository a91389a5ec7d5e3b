"""How execution differs from the plan."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from xray_drake.configuration import in_order, number
from xray_drake.messages import Grasp


@dataclass
class PerturbationConfig:
    """Errors of a quasi-static execution (PROTOCOL.md, Rollout)."""

    # Standard deviation of the position, per axis, m.
    position_sigma: float = number(0.0025, "[0, 1]")
    # Standard deviation of the rotation's angle, rad; its axis is uniform.
    angle_sigma: float = number(0.05, "[0, 1.5708]")
    # Mean and standard deviation of the friction coefficient, and the value
    # that it always exceeds.
    friction: float = number(0.5, "(0, 5]")
    friction_sigma: float = number(0.1, "[0, 5]")
    friction_min: float = number(0.05, "[0, 5]")

    def complaints(self) -> Iterator[str]:
        """Yields what is wrong between its fields."""
        yield from in_order(self, "friction_min", "friction")


def perturb(
    grasp: Grasp, rng: np.random.Generator, config: PerturbationConfig
) -> tuple[np.ndarray, float]:
    """Draws the pose that a grasp really reaches and the friction it meets.

    The rotation is about the grasp frame's origin.

    Args:
        grasp: as planned.
        rng: random generator; the same number of values is drawn for every
            grasp, except where a friction is redrawn.
        config: sizes of the errors.

    Returns:
        4×4 perturbed X_WG and the Coulomb coefficient.
    """
    shift = config.position_sigma * rng.standard_normal(3)
    axis = rng.standard_normal(3)
    angle = config.angle_sigma * rng.standard_normal()
    friction = -np.inf
    while friction <= config.friction_min:
        friction = (
            config.friction + config.friction_sigma * rng.standard_normal()
        )
    turn = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis))
    X_WG = np.array(grasp.X_WG)
    X_WG[:3, :3] = turn.as_matrix() @ X_WG[:3, :3]
    X_WG[:3, 3] += shift
    return X_WG, float(friction)
