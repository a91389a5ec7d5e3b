"""Which pixels of a depth image have a reading, and filling the others."""

import cv2
import numpy as np


def has_reading(depth: np.ndarray) -> np.ndarray:
    """Returns where a z-depth image has a reading, bool; 0, inf, NaN is none.

    Args:
        depth: of any shape, m.
    """
    return np.isfinite(depth) & (depth > 0)


def nearest_values(
    values: np.ndarray, known: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gives each pixel the value of the nearest one that is known.

    Args:
        values: (H, W).
        known: (H, W) bool, some True.

    Returns:
        (H, W) of the values' type; (H, W) float32, how far that pixel is,
        pixels.
    """
    away, label = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8),
        cv2.DIST_L2,
        cv2.DIST_MASK_5,
        labelType=cv2.DIST_LABEL_PIXEL,
    )
    value_of = np.zeros(int(label.max()) + 1, values.dtype)
    value_of[label[known]] = values[known]
    return value_of[label], away
