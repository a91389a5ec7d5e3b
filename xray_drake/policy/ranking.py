"""The paper's three rankings: which object to grasp first."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.messages import Grasp, InstanceMasks, OccupancyDistribution


class Planning(Protocol):
    """Plans grasps in the heap that is looked at."""

    def __call__(self, name: str, *, without: Collection[str] = ()) -> Grasp:
        """Returns the best grasp on an object; of kind NONE if there is none.

        Args:
            name: of the object.
            without: objects that are thought away.
        """


class Inference(Protocol):
    """Infers where the target could be in an image that is imagined."""

    def __call__(
        self, depth: np.ndarray, target_mask: np.ndarray
    ) -> OccupancyDistribution:
        """Infers the distribution.

        Args:
            depth: (H, W) float32 z-depth, m.
            target_mask: (H, W) bool, the target's modal mask.
        """


@dataclass(frozen=True, eq=False)
class Outlook:
    """What a ranking needs to imagine the image after a removal.

    Attributes:
        depth: (H, W) float32 z-depth that the distribution was inferred from,
            m.
        target_mask: (H, W) bool, the target's modal mask that it was.
        camera: of both.
        target_size: (3,) length, width, thickness of the target, m.
        infer: the inference.
    """

    depth: np.ndarray
    target_mask: np.ndarray
    camera: PinholeCamera
    target_size: np.ndarray
    infer: Inference


@dataclass(frozen=True, eq=False)
class SearchView:
    """What a ranking may look at.

    Attributes:
        occupancy: where the target can be.
        instances: modal masks of the objects seen.
        candidates: names of the objects that may be grasped, in the order of
            ``instances``.
        target: the instance that is the target; empty where none is.
        plan: plans grasps on candidates; only for rankings that ask for it.
        outlook: to imagine removals; only for rankings that ask for it.
        true_mask: (H, W) bool, the target's true amodal mask; for the oracle.
    """

    occupancy: OccupancyDistribution
    instances: InstanceMasks
    candidates: tuple[str, ...]
    target: str = ""
    plan: Planning | None = None
    outlook: Outlook | None = None
    true_mask: np.ndarray | None = None


class Ranking(Protocol):
    """Scores candidates; the highest is grasped first."""

    def __call__(
        self, view: SearchView, rng: np.random.Generator
    ) -> np.ndarray:
        """Scores the candidates.

        Args:
            view: what is seen.
            rng: a generator of this decision alone.

        Returns:
            (len(view.candidates), k) scores; the first column decides, each
            next one where the columns before it are equal.
        """


def xray(view: SearchView, rng: np.random.Generator) -> np.ndarray:
    """X-Ray: sum of mask × distribution (paper section V).

    The paper does not say what happens where all products are zero: as when
    the whole target is seen but its neighbours are in the way of the fingers.
    Here the object nearest to the support is next then, and where there is no
    support, the largest.

    Args:
        view: what is seen.
        rng: not used.

    Returns:
        (n, 3) scores: the sum; minus the distance to the support, pixels; the
        visible pixels.
    """
    masks = [view.instances.mask(name) for name in view.candidates]
    rho = view.occupancy.data
    support = view.occupancy.support()
    if support.any():
        away = cv2.distanceTransform(
            (~support).astype(np.uint8), cv2.DIST_L2, 5
        )
    else:
        away = np.zeros(rho.shape, np.float32)
    rows = [
        (
            float(np.where(mask & support, rho, 0).sum(dtype=float)),
            -float(away[mask].min()),
            float(np.count_nonzero(mask)),
        )
        for mask in masks
    ]
    return np.array(rows).reshape(len(rows), 3)


def largest(view: SearchView, rng: np.random.Generator) -> np.ndarray:
    """Largest: visible pixels (Danielczuk et al. 2019), (n, 1) scores."""
    areas = dict(zip(view.instances.names, view.instances.areas(), strict=True))
    return np.array([[float(areas[name])] for name in view.candidates]).reshape(
        -1, 1
    )


def random(view: SearchView, rng: np.random.Generator) -> np.ndarray:
    """Random: uniform (Danielczuk et al. 2019), (n, 1) scores in [0, 1)."""
    return rng.uniform(size=(len(view.candidates), 1))


RANKINGS: Mapping[str, Ranking] = {
    "xray": xray,
    "largest": largest,
    "random": random,
}
"""By the name that the scenario and the command line use."""


def candidates(instances: InstanceMasks, *, min_pixels: int) -> tuple[str, ...]:
    """Returns the objects seen well enough to be grasped (PROTOCOL.md)."""
    return tuple(
        name
        for name, area in zip(instances.names, instances.areas(), strict=True)
        if area >= min_pixels
    )


def order(
    view: SearchView,
    ranking: Ranking,
    rng: np.random.Generator,
    *,
    target: str = "",
) -> list[tuple[str, float]]:
    """Returns the candidates with their scores, the best first.

    Args:
        view: what is seen.
        ranking: scores them.
        rng: for the ranking.
        target: this candidate goes first whatever its score, if it is one.

    Raises:
        ValueError: distribution and masks differ in shape.
    """
    if view.occupancy.data.shape != view.instances.labels.shape:
        raise ValueError(
            f"the distribution is {view.occupancy.data.shape} but the "
            f"instance image {view.instances.labels.shape}: both must come "
            "from one image"
        )
    if not view.candidates:
        return []
    scores = ranking(view, rng)
    # lexsort: its last key decides first; stable, so equals keep their order.
    keys: Sequence[np.ndarray] = [-column for column in scores.T[::-1]]
    names = [view.candidates[i] for i in np.lexsort(keys)]
    by_name = dict(zip(view.candidates, scores[:, 0].tolist(), strict=True))
    if target in names:
        names.remove(target)
        names.insert(0, target)
    return [(name, by_name[name]) for name in names]
