"""Colour maps."""

import cv2
import numpy as np


def heat(values: np.ndarray) -> np.ndarray:
    """Returns the colours of values in [0, 1], dark blue to red.

    Args:
        values: any shape.

    Returns:
        (..., 3) float RGB in [0, 1].
    """
    scaled = np.clip(np.asarray(values) * 255, 0, 255).astype(np.uint8)
    bgr = cv2.applyColorMap(scaled.reshape(-1, 1), cv2.COLORMAP_TURBO)
    return bgr.reshape(*scaled.shape, 3)[..., ::-1] / 255.0


def overlay(
    image: np.ndarray, values: np.ndarray, *, strength: float = 0.65
) -> np.ndarray:
    """Lays a distribution over a picture.

    Args:
        image: (H, W, 3) uint8 RGB.
        values: (H, W) in [0, 1]; where 0, the picture is left as it is.
        strength: opacity of the colours.

    Returns:
        (H, W, 3) uint8 RGB.
    """
    alpha = strength * (values > 0)[..., None]
    blended = (1 - alpha) * image + alpha * 255 * heat(values)
    return np.rint(blended).astype(np.uint8)
