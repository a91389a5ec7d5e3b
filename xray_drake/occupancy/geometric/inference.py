"""The exact inference that a configuration asks for."""

from xray_drake.occupancy.geometric.config import POSES, ExactInferenceConfig
from xray_drake.occupancy.geometric.flat import ExactInference
from xray_drake.occupancy.geometric.resting import RestingInference
from xray_drake.scene.object_model import ObjectModel


def exact_model(
    target: ObjectModel, config: ExactInferenceConfig
) -> ExactInference | RestingInference:
    """Prepares exact inference for a target.

    Args:
        target: what is searched for.
        config: the numbers; ``poses`` chooses.

    Raises:
        ValueError: ``poses`` is none of ``POSES``, or a number is wrong.
    """
    if config.poses == "flat":
        return ExactInference(target, config)
    if config.poses == "resting":
        return RestingInference(target, config)
    raise ValueError(
        f"poses is {config.poses!r}: choose one of {', '.join(POSES)}"
    )
