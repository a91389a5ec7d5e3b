"""How good a segmentation is, given the truth."""

from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from tests.masks import iou


class SegmentationScore(NamedTuple):
    """Objects and segments, matched one to one for the greatest sum of IoUs.

    Attributes:
        objects: that are there, of 50 pixels or more.
        segments: that were found.
        recall: share of the objects that are matched at an IoU above 0.5.
        mean_iou: of the objects that have a segment.
    """

    objects: int
    segments: int
    recall: float
    mean_iou: float


def score_segmentation(
    truth: np.ndarray, found: np.ndarray
) -> SegmentationScore:
    """Compares two (H, W) images of integers; negative is background."""
    objects = [truth == i for i in np.unique(truth[truth >= 0])]
    objects = [mask for mask in objects if np.count_nonzero(mask) >= 50]
    segments = [found == i for i in np.unique(found[found >= 0])]
    ious = np.array([[iou(a, b) for b in segments] for a in objects])
    matched = ious[linear_sum_assignment(ious, maximize=True)]
    return SegmentationScore(
        len(objects),
        len(segments),
        float(np.count_nonzero(matched > 0.5) / len(objects)),
        float(matched[matched > 0].mean()),
    )
