"""Labels that an image alone allows: what a network can know of the others.

The paper's label is made by who knows the true pose, and depends on where the
pose is within the grid of candidates, 8 pixels and 22.5° apart. A network that
is trained on such labels sees, of images that are alike, now one and now
another. ``geometric_label`` inference knows which of them an image may have,
and what is the best answer to all: so a network that learns its answers learns
the same from fewer images, and need not search for poses afterwards.
"""

from functools import cache

import numpy as np
import trimesh

from xray_drake.choices import TALL_TARGETS, TARGET_NAMES
from xray_drake.dataset.sample import Sample
from xray_drake.dataset.virtual import is_virtual, virtual_target
from xray_drake.geometry.floor_grid import Floor
from xray_drake.occupancy.geometric.config import (
    GeometricConfig,
    GeometricLabelConfig,
)
from xray_drake.occupancy.inference import make_inference
from xray_drake.occupancy.observation import OccupancyModel
from xray_drake.scene.object_model import ObjectModel, object_from_pieces
from xray_drake.scene.targets import target_model

_SLACK = 0.05
"""The network's answers are off by about this; see ``GeometricLabelConfig``."""

_DENSITY = 1000.0
"""kg/m³; nothing depends on it."""


def expected_occupancy(sample: Sample) -> np.ndarray:
    """Returns the best answer to all labels that an image may have.

    Args:
        sample: with depth and mask as the camera sees them, without errors.

    Returns:
        (H, W) float32 in [0, 1]; the sample's own label where there is no
        other: of a target that is hidden (whose label hardly depends on the
        grid), that need not lie flat, or that is none of the package's.
    """
    name = sample.target_name
    if not sample.target_modal.any():
        return sample.occupancy
    if is_virtual(name):
        inference = _virtual_inference(sample)
    elif name in TARGET_NAMES and name not in TALL_TARGETS:
        inference = _named_inference(name, sample.floor)
    else:
        return sample.occupancy
    return inference.infer(
        sample.depth, sample.target_modal, sample.camera
    ).data


@cache
def _named_inference(name: str, floor: Floor) -> OccupancyModel:
    return _inference(target_model(name), floor)


def _virtual_inference(sample: Sample) -> OccupancyModel:
    """Each virtual target is another."""
    target = virtual_target(sample)
    mesh = trimesh.Trimesh(target.vertices).convex_hull
    model = object_from_pieces(target.name, [mesh], density=_DENSITY)
    return _inference(model, sample.floor)


def _inference(target: ObjectModel, floor: Floor) -> OccupancyModel:
    label = GeometricLabelConfig(slack=_SLACK)
    return make_inference(
        "geometric_label",
        target,
        floor=floor,
        geometric=GeometricConfig("flat", label=label),
    )
