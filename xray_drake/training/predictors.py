"""The package's inferences, as an evaluation asks them."""

from functools import lru_cache
from pathlib import Path

import numpy as np

from xray_drake.choices import DTYPES, TALL_TARGETS, WITHOUT_NETWORK
from xray_drake.dataset.sample import Sample
from xray_drake.geometry.floor_grid import Floor
from xray_drake.messages import OccupancyDistribution
from xray_drake.occupancy.geometric.config import GeometricConfig
from xray_drake.occupancy.inference import make_inference
from xray_drake.occupancy.observation import OccupancyModel
from xray_drake.scene.targets import target_model
from xray_drake.training.evaluation import Predictor


def predictor(
    name: str,
    *,
    weights: Path | None = None,
    dtype: str = DTYPES[0],
    scaling: bool = True,
) -> Predictor:
    """Returns an inference that prepares itself for each sample's target.

    The last 16 targets stay prepared. A tall target may rest on any face for
    "geometric" inference; all others lie flat.

    Args:
        name: see :func:`~xray_drake.occupancy.inference.make_inference`, and
            so do the other three; a network is read with the first sample.
        weights: see there.
        dtype: see there.
        scaling: see there.

    Returns:
        Sample to distribution; without a network, a sample of a target that is
        none of the package's is a ``ValueError``.
    """

    @lru_cache(maxsize=16)
    def prepared(
        target: str | tuple[float, ...], floor: Floor
    ) -> OccupancyModel:
        tall = name == "geometric" and target in TALL_TARGETS
        return make_inference(
            name,
            target_model(target)
            if isinstance(target, str)
            else np.array(target),
            floor=floor,
            geometric=GeometricConfig("resting" if tall else "flat"),
            weights=weights,
            dtype=dtype,
            scaling=scaling,
        )

    def predict(sample: Sample) -> OccupancyDistribution:
        model = prepared(
            sample.target_name
            if name in WITHOUT_NETWORK
            else tuple(sample.target_size.tolist()),
            sample.floor,
        )
        return model.infer(sample.depth, sample.target_modal, sample.camera)

    return predict
