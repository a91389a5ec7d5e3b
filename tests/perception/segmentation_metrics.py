"""How good a segmentation is, given the truth."""

from dataclasses import astuple, dataclass
from operator import add

import numpy as np
from scipy.optimize import linear_sum_assignment


@dataclass(frozen=True)
class SegmentationScore:
    """Counts of one image or, added up, of many.

    Attributes:
        objects: that are there.
        segments: that were found.
        matched: objects that were given a segment of their own, one to one,
            such that the sum of all IoUs is greatest.
        iou_sum: of the matched ones.
        recalled: objects matched at an IoU of more than 0.5.
        object_pixels: of all objects.
        best_pixels: of those, the ones in that segment which holds most of
            their object.
        foreign_pixels: of those segments, counted for each object, pixels
            which are not of that object.
    """

    objects: int = 0
    segments: int = 0
    matched: int = 0
    iou_sum: float = 0.0
    recalled: int = 0
    object_pixels: int = 0
    best_pixels: int = 0
    foreign_pixels: int = 0

    def __add__(self, other: "SegmentationScore") -> "SegmentationScore":
        return SegmentationScore(*map(add, astuple(self), astuple(other)))

    @property
    def mean_iou(self) -> float:
        """Of the matched objects; NaN where there are none."""
        return _share(self.iou_sum, self.matched)

    @property
    def recall(self) -> float:
        """Share of the objects that are matched at an IoU of more than 0.5."""
        return _share(self.recalled, self.objects)

    @property
    def precision(self) -> float:
        """Share of the segments that are matched so."""
        return _share(self.recalled, self.segments)

    @property
    def over_segmentation(self) -> float:
        """Share of the objects' pixels outside their best segments.

        0 where no object is parted or missed, towards 1 where they fall to
        pieces.
        """
        return 1 - _share(self.best_pixels, self.object_pixels)

    @property
    def under_segmentation(self) -> float:
        """Foreign pixels in the objects' best segments, in objects' pixels.

        0 where no segment reaches beyond its object; above 1 where many
        objects are one segment.
        """
        return _share(self.foreign_pixels, self.object_pixels)


def score_segmentation(
    truth: np.ndarray, found: np.ndarray, *, min_area: int = 50
) -> SegmentationScore:
    """Compares a segmentation with the truth.

    Args:
        truth: (H, W) integers, one per object, negative for the background.
        found: (H, W) integers, one per segment, negative for the background.
        min_area: objects of fewer pixels do not count as objects.

    Raises:
        ValueError: the images differ in shape.
    """
    if truth.shape != found.shape:
        raise ValueError(
            f"the truth is {truth.shape} but the segmentation {found.shape}"
        )
    shared, areas, segment_areas = _overlap(truth, found)
    shared, areas = shared[areas >= min_area], areas[areas >= min_area]
    count, segments = shared.shape
    if count == 0 or segments == 0:
        return SegmentationScore(
            objects=count, segments=segments, object_pixels=int(areas.sum())
        )
    iou = shared / (areas[:, None] + segment_areas[None] - shared)
    pairs = linear_sum_assignment(iou, maximize=True)
    matched = iou[pairs][iou[pairs] > 0]
    best = shared.argmax(axis=1)
    best_pixels = shared.max(axis=1)
    held = best_pixels > 0
    return SegmentationScore(
        objects=count,
        segments=segments,
        matched=len(matched),
        iou_sum=float(matched.sum()),
        recalled=int(np.count_nonzero(matched > 0.5)),
        object_pixels=int(areas.sum()),
        best_pixels=int(best_pixels.sum()),
        foreign_pixels=int((segment_areas[best] - best_pixels)[held].sum()),
    )


def _overlap(
    truth: np.ndarray, found: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns pixels shared by each object and segment, and of each alone."""
    t_values, t = np.unique(np.maximum(truth, -1), return_inverse=True)
    f_values, f = np.unique(np.maximum(found, -1), return_inverse=True)
    shape = len(t_values), len(f_values)
    table = np.bincount(
        t.ravel() * shape[1] + f.ravel(), minlength=shape[0] * shape[1]
    ).reshape(shape)
    objects, segments = t_values >= 0, f_values >= 0
    return (
        table[np.ix_(objects, segments)],
        table[objects].sum(axis=1),
        table[:, segments].sum(axis=0),
    )


def _share(part: float, whole: float) -> float:
    return part / whole if whole else float("nan")
