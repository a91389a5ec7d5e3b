"""The old name of geometric inference; goes with version 0.3."""

import warnings

from xray_drake.occupancy.geometric.config import GeometricConfig
from xray_drake.occupancy.inference import make_inference
from xray_drake.occupancy.observation import OccupancyModel
from xray_drake.scene.object_model import ObjectModel


def ExactInference(
    target: ObjectModel, config: GeometricConfig | None = None
) -> OccupancyModel:
    """Returns ``make_inference("geometric", target, geometric=config)``."""
    warnings.warn(
        "ExactInference is now xray_drake.occupancy.inference.make_inference("
        "'geometric', target); the old name goes with version 0.3",
        DeprecationWarning,
        stacklevel=2,
    )
    return make_inference("geometric", target, geometric=config)
