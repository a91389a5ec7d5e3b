"""Agreement of masks, for tests."""

import numpy as np


def iou(a: np.ndarray, b: np.ndarray) -> float:
    """Returns the intersection over union of two masks, one not empty."""
    return np.count_nonzero(a & b) / np.count_nonzero(a | b)
