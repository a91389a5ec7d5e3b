"""Colour maps: distributions, depth and instances as pictures."""

import colorsys

import cv2
import numpy as np

_BACKGROUND = (225, 225, 225)
_TARGET = (205, 20, 20)
_NO_READING = (255, 215, 235)

_GOLDEN = 0.618034
"""Of a turn: neighbours in the list are far apart in hue."""

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


def depth_picture(depth: np.ndarray) -> np.ndarray:
    """Returns a depth image as grey, near is bright.

    Args:
        depth: (H, W) z-depth, m; 0 where there is no reading.

    Returns:
        (H, W, 3) uint8 RGB; pink where there is no reading.
    """
    valid = depth > 0
    if not valid.any():
        return np.full((*depth.shape, 3), _NO_READING, np.uint8)
    near, far = np.percentile(depth[valid], [0.5, 99.5])
    shade = 1 - np.clip((depth - near) / max(far - near, 1e-6), 0, 1)
    gray = np.rint(40 + 200 * shade).astype(np.uint8)
    return np.where(
        valid[..., None], gray[..., None], np.array(_NO_READING, np.uint8)
    )


def instance_colors(count: int) -> np.ndarray:
    """Returns (count, 3) uint8 RGB: background grey, target red, no other red.

    Args:
        count: of values in an instance image.
    """
    colors = np.empty((max(count, 2), 3), np.uint8)
    colors[0], colors[1] = _BACKGROUND, _TARGET
    for index in range(2, count):
        hue = 0.1 + 0.8 * (index * _GOLDEN % 1.0)
        value = 0.65 + 0.3 * (index % 2)
        colors[index] = np.rint(
            255 * np.array(colorsys.hsv_to_rgb(hue, 0.6, value))
        )
    return colors[:count]


def instance_picture(instances: np.ndarray) -> np.ndarray:
    """Returns (H, W, 3) uint8 RGB of an (H, W) image of instances."""
    return instance_colors(int(instances.max()) + 1)[instances]
