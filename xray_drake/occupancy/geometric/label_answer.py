"""The paper's label, guessed from the image alone and without a network."""

import numpy as np

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.occupancy.geometric.config import (
    GeometricConfig,
    GeometricLabelConfig,
)
from xray_drake.occupancy.geometric.flat import FlatPoses
from xray_drake.occupancy.geometric.label_mixture import (
    best_answer,
    label_histogram,
)
from xray_drake.occupancy.geometric.pose_search import PoseSearch
from xray_drake.occupancy.label.config import LabelConfig
from xray_drake.seeding import stream

_COVERS = 0.8
"""Orientations none of whose poses covers this share of what the best one
covers differ too much from what is observed."""

_LEAST_WEIGHT = 1e-4
"""Labels less probable than this are left out."""


def answer_label(
    poses: FlatPoses,
    heights: np.ndarray,
    mask: np.ndarray,
    camera: PinholeCamera,
    config: GeometricConfig,
) -> np.ndarray:
    """Answers with the label that the paper's metrics are expected to like.

    The label, made from the true pose, counts the poses that lie on a lattice
    through it, 8 pixels and 22.5° apart. The image alone tells neither, but
    all poses on one lattice give the same label. So the poses that show what
    is observed are sorted by lattices; each lattice's label is as probable as
    it is that the true pose is one of its own; and for each pixel the answer
    is what is close to most of these labels.

    Where the camera has no reading, it does not see the target either: such a
    pixel contributes no evidence.

    Args:
        poses: of the target.
        heights: (H, W) float32 of the observed surface, m; −inf where there is
            no reading.
        mask: (H, W) bool, where the target is seen; not blank.
        camera: of both.
        config: the numbers.

    Returns:
        (H, W) float32 in [0, 1]; the mask itself where no pose meets it.
    """
    would_show = (heights < poses.target.top) & (heights > -np.inf) | mask
    search = poses.search(would_show, mask, camera)
    return label_of_poses(search, _turn(poses.seen_angles), config.label)


def _turn(angles: np.ndarray) -> int:
    """Returns the orientations between two of a label's, 1 at the least."""
    if len(angles) < 2:
        return 1
    apart = 2 * np.pi / LabelConfig().rotations
    return max(1, round(apart / (angles[1] - angles[0])))


def label_of_poses(
    search: PoseSearch, turn: int, config: GeometricLabelConfig
) -> np.ndarray:
    """Guesses the label of a target that is seen; see :func:`answer_label`.

    Args:
        search: what its poses would show.
        turn: orientations of the search between two of a label's.
        config: the numbers.

    Returns:
        (H, W) float32 in [0, 1]; the mask itself where no pose meets it.
    """
    mask = search.mask
    poses, excess = _alike(search, int(np.count_nonzero(mask)), config)
    if not len(poses):
        return mask.astype(np.float32)
    step = LabelConfig().step
    _, lattice = np.unique(
        poses % [turn, step, step], axis=0, return_inverse=True
    )
    lattice = _some(lattice.reshape(-1), config.most_poses)
    kept = np.flatnonzero(lattice >= 0)
    kept = kept[np.argsort(lattice[kept], kind="stable")]
    poses, excess, lattice = poses[kept], excess[kept], lattice[kept]
    weight = np.bincount(lattice, np.exp(-excess))
    weight[weight < _LEAST_WEIGHT * weight.sum()] = 0.0

    corner = poses[:, 1:] - search.reach
    low = corner.min(axis=0)
    side = search.silhouettes.shape[1]
    high = corner.max(axis=0) + side
    low, high = np.maximum(low, 0), np.minimum(high, mask.shape)
    histogram = label_histogram(
        search.silhouettes > 0,
        poses[:, 0],
        corner - low,
        np.concatenate([[0], np.cumsum(np.bincount(lattice))]),
        weight / weight.sum(),
        (int(high[0] - low[0]), int(high[1] - low[1])),
    )
    result = np.zeros(mask.shape, dtype=np.float32)
    result[low[0] : high[0], low[1] : high[1]] = best_answer(
        histogram, cost=config.cost, slack=config.slack
    )
    return result


def _alike(
    search: PoseSearch, size: int, config: GeometricLabelConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Finds the poses that show what is observed.

    Args:
        search: what its poses would show.
        size: pixels of the observed mask.
        config: what is the same.

    Returns:
        (n, 3) int64 orientation, and row and column of the axis in the image;
        (n,) how much more they differ from what is observed than the best one,
        in units of which each makes a pose less probable by e.
    """
    most = search.common.amax(dim=(1, 2))
    if most.max() <= 0:
        return np.zeros((0, 3), np.int64), np.zeros(0)
    chosen = (most >= _COVERS * most.max()).nonzero()[:, 0]
    common = search.common[chosen].numpy()
    differing = search.areas(chosen).numpy() + size - 2 * common
    differing[common <= 0] = np.inf
    excess = differing - differing.min()
    k, row, column = np.nonzero(
        excess <= config.tolerance * size + config.pixels
    )
    poses = np.stack(
        [chosen.numpy()[k], row + search.top, column + search.left], axis=1
    )
    unit = config.spread * size + config.pixels
    return poses, excess[k, row, column] / unit


def _some(lattice: np.ndarray, most: int) -> np.ndarray:
    """Draws lattices until they have enough poses; −1 for those left out."""
    sizes = np.bincount(lattice)
    if len(lattice) <= most:
        return lattice
    drawn = stream(0, "lattices").permutation(len(sizes))
    enough = 1 + int(np.searchsorted(np.cumsum(sizes[drawn]), most))
    number = np.full(len(sizes), -1)
    number[drawn[:enough]] = np.arange(min(enough, len(sizes)))
    return number[lattice]
