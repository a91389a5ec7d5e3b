"""The paper's three rankings: which object to grasp first."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.messages import (
    GraspPlan,
    InstanceMasks,
    OccupancyDistribution,
    RankedCandidate,
)

_LEAST_HIDDEN = 1.0
"""An object with less of the distribution under it hides nothing, pixels."""


class Planning(Protocol):
    """Plans grasps in the heap that is looked at."""

    def __call__(
        self, name: str, *, without: Collection[str] = ()
    ) -> GraspPlan:
        """Returns the best grasp on an object, or why there is none.

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

    def foresight(self, ranking: str) -> tuple[Outlook, Planning]:
        """Returns what a ranking needs that imagines removals.

        Args:
            ranking: who asks, for the message.

        Raises:
            ValueError: the view has no outlook or cannot plan.
        """
        if self.outlook is None or self.plan is None:
            raise ValueError(f"{ranking} needs an outlook and a planner")
        return self.outlook, self.plan


@dataclass(frozen=True, eq=False)
class Scores:
    """What a ranking says of n candidates.

    Attributes:
        values: (n, k) float; the highest is grasped first. The first column is
            the score, in a unit of the ranking's own; each next one decides
            where the columns before it are equal but for rounding.
        hides: (n,) bool: the candidate hides the target as far as the ranking
            can tell, or keeps the gripper from it, or is the target itself. A
            weak grasp on such an object is preferred to a good one on an
            object that does not.
    """

    values: np.ndarray
    hides: np.ndarray


class Ranking(Protocol):
    """Scores candidates; the highest is grasped first."""

    def __call__(self, view: SearchView, rng: np.random.Generator) -> Scores:
        """Scores the candidates.

        Args:
            view: what is seen.
            rng: a generator of this decision alone.
        """


def xray(view: SearchView, rng: np.random.Generator) -> Scores:
    """X-Ray: sum of mask × distribution (paper section V).

    The paper does not say what happens where all products are zero: as when
    the whole target is seen but its neighbours are in the way of the fingers.
    Here the object nearest to the support is next then, and where there is no
    support, the largest.

    Args:
        view: what is seen.
        rng: not used.

    Returns:
        (n, 3) values: the sum; minus the distance to the support, pixels; the
        visible pixels. An object whose sum is a pixel or more hides something.
    """
    masks = [view.instances.mask(name) for name in view.candidates]
    rho, support = view.occupancy.supported(), view.occupancy.support()
    if support.any():
        away = cv2.distanceTransform(
            (~support).astype(np.uint8), cv2.DIST_L2, 5
        )
    else:
        away = np.zeros(rho.shape, np.float32)
    rows = [
        (
            float(np.where(mask, rho, 0).sum(dtype=float)),
            -float(away[mask].min()),
            float(np.count_nonzero(mask)),
        )
        for mask in masks
    ]
    values = np.array(rows).reshape(len(rows), 3)
    target = np.array([name == view.target for name in view.candidates], bool)
    return Scores(values, (values[:, 0] >= _LEAST_HIDDEN) | target)


def largest(view: SearchView, rng: np.random.Generator) -> Scores:
    """Largest: visible pixels (Danielczuk et al. 2019), (n, 1) values.

    It does not look at the distribution: each object may hide the target.
    """
    areas = dict(zip(view.instances.names, view.instances.areas(), strict=True))
    values = [float(areas[name]) for name in view.candidates]
    return _regardless(np.array(values))


def random(view: SearchView, rng: np.random.Generator) -> Scores:
    """Random: uniform (Danielczuk et al. 2019), (n, 1) values in [0, 1).

    It does not look at the distribution: each object may hide the target.
    """
    return _regardless(rng.uniform(size=len(view.candidates)))


def _regardless(values: np.ndarray) -> Scores:
    """Returns (n,) values as of a ranking that asks not what hides what."""
    return Scores(values.reshape(-1, 1), np.ones(len(values), bool))


def candidates(instances: InstanceMasks, *, min_pixels: int) -> tuple[str, ...]:
    """Returns the objects seen well enough to be grasped (PROTOCOL.md)."""
    return tuple(
        name
        for name, area in zip(instances.names, instances.areas(), strict=True)
        if area >= min_pixels
    )


def highest_first(scores: np.ndarray) -> np.ndarray:
    """Orders by scores; what is equal in all of them keeps its order.

    Scores are compared to five digits: which of two is higher by rounding alone
    would depend on the processor.

    Args:
        scores: (n, k); the first column decides, each next one where the
            columns before it are equal.

    Returns:
        (n,) indices.
    """
    mantissa, exponent = np.frexp(scores)
    rounded = np.ldexp(np.round(mantissa, 5), exponent)
    return np.lexsort(-rounded.T[::-1])


def order(
    view: SearchView,
    ranking: Ranking,
    rng: np.random.Generator,
    *,
    target: str = "",
) -> list[RankedCandidate]:
    """Returns the candidates with what the ranking says, the best first.

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
    ranked = [
        RankedCandidate(
            view.candidates[i],
            float(scores.values[i, 0]),
            bool(scores.hides[i]),
        )
        for i in highest_first(scores.values)
    ]
    # Stable, so the others keep their order.
    return sorted(ranked, key=lambda candidate: candidate.name != target)
