"""Colour maps."""

import cv2
import numpy as np

_HEAT = (
    cv2.applyColorMap(
        np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_VIRIDIS
    )[:, 0, ::-1]
    / 255.0
)
"""(256, 3) RGB. Viridis: no value looks like the red targets."""


def heat(values: np.ndarray) -> np.ndarray:
    """Returns the colours of values in [0, 1], dark violet to yellow.

    Args:
        values: any shape.

    Returns:
        (..., 3) float RGB in [0, 1].
    """
    scaled = np.clip(np.asarray(values) * 255, 0, 255).astype(np.uint8)
    return _HEAT[scaled]


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
