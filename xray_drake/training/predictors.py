"""The inferences of the package, as an evaluation asks them."""

from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from xray_drake.choices import DTYPES, TALL_TARGETS
from xray_drake.dataset.sample import Sample
from xray_drake.messages import OccupancyDistribution
from xray_drake.occupancy.geometric.config import ExactInferenceConfig
from xray_drake.occupancy.geometric.expected import ExpectedLabel
from xray_drake.occupancy.geometric.inference import exact_model
from xray_drake.scene.targets import target_model
from xray_drake.training.evaluation import Predictor

if TYPE_CHECKING:
    from xray_drake.occupancy.learned.inference import Output
    from xray_drake.occupancy.system import OccupancyModel


def exact_predictor() -> Predictor:
    """Returns exact inference; each target is prepared once.

    A tall target may rest on any face; the others lie flat.

    A sample of a target that is none of the package's is a ``ValueError``.
    """

    @cache
    def inference(name: str) -> "OccupancyModel":
        poses = "resting" if name in TALL_TARGETS else "flat"
        return exact_model(target_model(name), ExactInferenceConfig(poses))

    return lambda sample: _infer(inference(sample.target_name), sample)


def expected_predictor() -> Predictor:
    """Returns guesses of the label without a network; the target lies flat.

    A sample of a target that is none of the package's is a ``ValueError``.
    """

    @cache
    def inference(name: str) -> "OccupancyModel":
        return ExpectedLabel(target_model(name))

    return lambda sample: _infer(inference(sample.target_name), sample)


def learned_predictor(
    path: Path,
    *,
    scaling: bool = True,
    output: "Output" = "occupancy",
    dtype: str = DTYPES[0],
) -> Predictor:
    """Returns a network's inference; the last sizes of targets stay prepared.

    Args:
        path: of its weights; read when the first sample is asked about.
        scaling: see
            :class:`~xray_drake.occupancy.learned.inference.LearnedInference`.
        output: see there.
        dtype: see there.
    """
    # The networks are not needed where only exact inference is asked.
    from xray_drake.occupancy.learned.inference import load_inference

    @lru_cache(maxsize=16)
    def inference(size: tuple[float, ...]) -> "OccupancyModel":
        return load_inference(
            path,
            target_size=np.array(size),
            scaling=scaling,
            output=output,
            dtype=dtype,
        )

    return lambda sample: _infer(
        inference(tuple(sample.target_size.tolist())), sample
    )


def _infer(model: "OccupancyModel", sample: Sample) -> OccupancyDistribution:
    return model.infer(sample.depth, sample.target_modal, sample.camera)
