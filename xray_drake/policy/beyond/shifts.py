"""What has moved between two looks at a heap, and how far."""

from dataclasses import dataclass, field

import cv2
import numpy as np

from xray_drake.geometry.readings import has_reading
from xray_drake.messages import (
    InstanceMasks,
    Message,
    TargetMask,
    freeze_arrays,
)
from xray_drake.perception.ground_truth import target_instance

_SHARE = 0.9
"""Of the pixels of a thing that stays where it was and changes its depth, this
share changes by at most what counts: at edges, depth changes by more."""


@dataclass(frozen=True, eq=False)
class Look(Message):
    """What was seen at one time.

    Attributes:
        depth: (H, W) float32 z-depth, m; 0, inf and NaN are no reading.
        target: (H, W) bool, the target's modal mask.
        instances: modal masks of all objects seen.
    """

    depth: np.ndarray = field(
        default_factory=lambda: np.zeros((0, 0), np.float32)
    )
    target: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), bool))
    instances: InstanceMasks = field(default_factory=InstanceMasks)

    def __post_init__(self) -> None:
        freeze_arrays(self, depth=np.float32, target=bool)

    @property
    def target_name(self) -> str:
        """The instance that is the target; empty where it is not seen."""
        return target_instance(self.instances, TargetMask(self.target))


@dataclass(frozen=True, eq=False)
class Shift:
    """A thing that has moved.

    Attributes:
        name: of the instance.
        where: (H, W) bool: where it was seen, before and after.
        distance: how far it has moved at most, pixels.
    """

    name: str
    where: np.ndarray
    distance: float


def renamed(
    before: InstanceMasks, after: InstanceMasks, *, gone: str = ""
) -> InstanceMasks:
    """Gives instances the names of those that were seen in their place.

    For segmenters whose names mean nothing in the next image. Two instances are
    one if each has most of the other's pixels, so what has moved by more than
    half its size, has been cut otherwise, or has been uncovered, gets a name
    that nothing had.

    Args:
        before: of the earlier image.
        after: of the later one.
        gone: the earlier instance that was taken away; nothing is that.
    """
    both = (before.labels >= 0) & (after.labels >= 0)
    size = len(before.names), len(after.names)
    overlap = np.zeros(size, int)
    np.add.at(overlap, (before.labels[both], after.labels[both]), 1)
    same = (2 * overlap > before.areas()[:, None]) & (
        2 * overlap > after.areas()[None, :]
    )
    names = [f"new {name}" for name in after.names]
    for i, j in np.argwhere(same):
        if before.names[i] != gone:
            names[j] = before.names[i]
    return InstanceMasks(after.labels, tuple(names))


def shifts_seen(
    before: Look,
    after: Look,
    scale: float,
    *,
    lifted: str = "",
    noise: float,
    least_pixels: int,
) -> list[Shift]:
    """Finds what has moved between two looks from one place, and how far.

    Where a surface went farther, what was seen there before has gone; where one
    came nearer, what is seen there now has come. What is uncovered, or covered
    by something else, has not moved for that. The way of a thing is the
    distance of the farthest place that it left from where it is now, or of the
    farthest that it came to from where it was: a convex silhouette that slides
    over the floor has slid so far. Where it stayed in place and its depth
    changed, its way is that change.

    Args:
        before: the earlier look.
        after: the later look; instances have the same names in both. What has
            no namesake has moved by its size.
        scale: pixels per metre.
        lifted: the instance that was taken away in between. That it has gone
            is no shift.
        noise: a depth that changes less has not changed, m.
        least_pixels: an instance with fewer pixels that changed has not moved.

    Returns:
        One shift for each instance that moved.
    """
    change = _change(before.depth, after.depth)
    gone = _counts(before.instances, change > noise)
    come = _counts(after.instances, change < -noise)
    shifts = []
    for name in sorted({*gone, *come} - {lifted}):
        if max(gone.get(name, 0), come.get(name, 0)) < least_pixels:
            continue
        was, is_ = (
            look.instances.mask(name)
            if name in look.instances.names
            else np.zeros(change.shape, dtype=bool)
            for look in (before, after)
        )
        left = was & ~is_ & (change > noise)
        taken = is_ & ~was & (change < -noise)
        way = max(_farthest(left, is_), _farthest(taken, was))
        stayed = was & is_ & (np.abs(change) > noise)
        if stayed.any():
            depths = np.abs(change[stayed])
            way = max(way, scale * float(np.quantile(depths, _SHARE)))
        shifts.append(Shift(name, was | is_, way))
    return shifts


def _change(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Returns how much farther each pixel is; 0 where one has no reading."""
    with np.errstate(invalid="ignore"):
        change = after - before
    read = [has_reading(depth) for depth in (before, after)]
    return np.where(read[0] & read[1], change, 0)


def _counts(instances: InstanceMasks, moved: np.ndarray) -> dict[str, int]:
    """Returns how many pixels of each instance moved, where any did."""
    labels = instances.labels[moved]
    counts = np.bincount(labels[labels >= 0], minlength=len(instances.names))
    return {instances.names[i]: int(counts[i]) for i in np.flatnonzero(counts)}


def _farthest(places: np.ndarray, mask: np.ndarray) -> float:
    """Returns how far the farthest of some places is from a mask, pixels."""
    if not places.any():
        return 0.0
    if not mask.any():
        rows, columns = np.nonzero(places)
        return float(np.hypot(1 + np.ptp(rows), 1 + np.ptp(columns)))
    return float(distance_to(mask)[places].max())


def distance_to(mask: np.ndarray) -> np.ndarray:
    """Returns the (H, W) distance to a mask that is not blank, pixels."""
    return cv2.distanceTransform(
        (~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE
    )
