"""The labels that an image may have, as a histogram for each pixel."""

import numpy as np
from scipy.special import ndtr

from xray_drake.kernels import kernel
from xray_drake.occupancy.metrics import POSITIVE, TOLERANCE

LEVELS = 40
"""Values of a label are told apart in steps of a fortieth."""


@kernel
def label_histogram(
    rasters: np.ndarray,
    raster: np.ndarray,
    corner: np.ndarray,
    first: np.ndarray,
    weight: np.ndarray,
    shape: tuple[int, int],
) -> np.ndarray:
    """Sums up labels: how probable each value is in each pixel.

    A label is the sum of the masks of one group of poses, divided by its
    maximum.

    Args:
        rasters: (k, s, s) bool, silhouettes.
        raster: (n,) int64, which of them each pose shows, group by group.
        corner: (n, 2) int64, row and column of its first pixel.
        first: (g + 1,) int64, where each group begins, and the last ends.
        weight: (g,) how probable each group's label is; they sum up to 1.
        shape: h and w of the image; what of a pose is outside is cut off.

    Returns:
        (h, w, LEVELS + 1) float32 probabilities of 0, 1 / LEVELS, …, 1.
    """
    height, width = shape
    side = rasters.shape[1]
    result = np.zeros((height, width, LEVELS + 1), dtype=np.float32)
    result[:, :, 0] = 1.0
    total = np.zeros((height, width), dtype=np.int32)
    for group in range(len(weight)):
        total[:] = 0
        for pose in range(first[group], first[group + 1]):
            silhouette = rasters[raster[pose]]
            top, left = corner[pose]
            for i in range(max(0, -top), min(side, height - top)):
                for j in range(max(0, -left), min(side, width - left)):
                    if silhouette[i, j]:
                        total[top + i, left + j] += 1
        largest = total.max()
        for i in range(height):
            for j in range(width):
                if total[i, j]:
                    level = int(LEVELS * total[i, j] / largest + 0.5)
                    result[i, j, 0] -= weight[group]
                    result[i, j, level] += weight[group]
    return result


def best_answer(
    histogram: np.ndarray, *, cost: float, slack: float
) -> np.ndarray:
    """Answers for each pixel what the paper's metrics are expected to like.

    IoU is the number of pixels with a label above 0.1 and an answer within 0.2
    of it, over that of pixels where either is above 0.1. The answer makes the
    expected first number minus ``cost`` times the second one greatest, if all
    answers are a little off. (Where ``cost`` is the IoU reached, that makes the
    ratio of the two greatest.)

    Args:
        histogram: (h, w, LEVELS + 1), see :func:`label_histogram`.
        cost: of a pixel in the union.
        slack: standard deviation of answers that are off, above 0.

    Returns:
        (h, w) float32 in [0, 1].
    """
    values = np.arange(LEVELS + 1) / LEVELS
    difference = values[:, None] - values
    close = ndtr((TOLERANCE - difference) / slack) - ndtr(
        (-TOLERANCE - difference) / slack
    )
    positive = (values > POSITIVE)[:, None].astype(float)
    counted = ndtr((values - POSITIVE) / slack)
    union = positive + (1 - positive) * counted
    # Where nothing else decides, most pixels are right.
    gain = close * positive - cost * union + 1e-3 * close
    score = histogram @ gain.astype(np.float32)
    return values[score.argmax(axis=-1)].astype(np.float32)
