"""The paper's label, guessed from the image alone and without a network."""

from dataclasses import replace

import numpy as np

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.messages import OccupancyDistribution
from xray_drake.occupancy.geometric.config import (
    ExactInferenceConfig,
    ExpectedLabelConfig,
    check_expected,
)
from xray_drake.occupancy.geometric.flat import ExactInference
from xray_drake.occupancy.geometric.label_mixture import (
    best_answer,
    label_histogram,
)
from xray_drake.occupancy.geometric.pose_search import PoseSearch
from xray_drake.occupancy.label.config import LabelConfig
from xray_drake.scene.object_model import ObjectModel
from xray_drake.seeding import stream

_COVERS = 0.8
"""Orientations none of whose poses covers this share of what the best one
covers differ too much from what is observed."""

_LEAST_WEIGHT = 1e-4
"""Labels less probable than this are left out."""


class ExpectedLabel(ExactInference):
    """Answers with the label that the paper's metrics are expected to like.

    ``ExactInference`` counts each pose that may explain the image. The label,
    made by who knows the true pose, counts those that lie on a lattice through
    it, 8 pixels and 22.5° apart. Whoever sees the image alone knows neither,
    but all poses on one lattice give the same label. So the poses that show
    what is observed are sorted by lattices; each lattice's label is as
    probable as it is that the true pose is one of its own; and for each pixel
    the answer is what is close to most of these labels.

    Where the camera has no reading, it does not see the target either: such a
    pixel speaks neither for a pose nor against one.

    Of a hidden target so many lattices are possible that the sum over all
    poses, with a lower peak, stands for each.
    """

    method = "geometric_label"

    def __init__(
        self, target: ObjectModel, config: ExactInferenceConfig | None = None
    ) -> None:
        """Prepares the silhouettes.

        Args:
            target: what is searched for.
            config: the numbers.

        Raises:
            ValueError: see :class:`ExactInference` and
                :func:`~xray_drake.occupancy.geometric.config.check_expected`.
        """
        config = config or ExactInferenceConfig()
        check_expected(config)
        # The label's candidates of a hidden target show no pixel.
        super().__init__(target, replace(config, blank_tolerance=0.0))

    def _count_seen(
        self, heights: np.ndarray, mask: np.ndarray, camera: PinholeCamera
    ) -> np.ndarray:
        search = self._search(heights, mask, camera)
        return expected_label(search, self._turn, self.config.label)

    def _would_show(self, heights: np.ndarray, mask: np.ndarray) -> np.ndarray:
        return super()._would_show(heights, mask) & (heights > -np.inf) | mask

    @property
    def _turn(self) -> int:
        """Orientations between two of a label's, 1 at the least."""
        angles = self._seen_angles
        if len(angles) < 2:
            return 1
        apart = 2 * np.pi / LabelConfig().rotations
        return max(1, round(apart / (angles[1] - angles[0])))

    def _scaled(
        self, total: np.ndarray, mask: np.ndarray
    ) -> OccupancyDistribution:
        if mask.any():
            return self._distribution(total)
        scaled = super()._scaled(total, mask)
        return self._distribution(self.config.label.peak * scaled.data)


def expected_label(
    search: PoseSearch, turn: int, config: ExpectedLabelConfig
) -> np.ndarray:
    """Guesses the label of a target that is seen; see :class:`ExpectedLabel`.

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
    search: PoseSearch, size: int, config: ExpectedLabelConfig
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
