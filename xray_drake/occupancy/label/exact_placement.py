"""▲ The label of exact placement."""

from dataclasses import replace

import numpy as np

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.messages import OccupancyDistribution
from xray_drake.occupancy.geometric.flat import ExactInference
from xray_drake.occupancy.geometric.resting import RestingInference


def exact_label(
    inference: ExactInference | RestingInference,
    scene_depth: np.ndarray,
    modal: np.ndarray,
    camera: PinholeCamera,
) -> OccupancyDistribution:
    """▲ Computes the ground truth with exact placement of a flat target.

    The paper's label (``occupancy_label``) moves an image of the target over a
    grid of 8 pixels. This one places the target itself: flat on the floor, in
    true perspective, on every pixel and in 32 orientations. ``ExactInference``
    does the search, with its rules, given the scene without the target in
    place of the observed depth, and the true modal mask.

    Those rules differ from the paper's: a hidden candidate may show 2 % of its
    silhouette, one that is seen must reach 0.9 of the best IoU, and pixels
    that show the floor are set to zero. Without the latter, the many
    candidates a pixel or two apart would spread a fully visible target's
    support beyond its mask. The true pose lies between those of the lattice
    and is not added. A target that leans has no exact placement; the paper's
    label has it.

    Args:
        inference: prepared for the target.
        scene_depth: (H, W) float32 z-depth of all but the target, m; 0, inf
            and NaN are no reading and hide nothing.
        modal: (H, W) bool, the target's true modal mask.
        camera: the camera of both.

    Returns:
        The distribution, its ``method`` "exact label"; all zero if the target
        cannot be anywhere.

    Raises:
        ValueError: as ``ExactInference.infer``.
    """
    found = inference.infer(scene_depth, modal, camera)
    return replace(found, method="exact label")
