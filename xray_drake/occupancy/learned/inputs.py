"""What the compact network sees: geometry instead of raw depth.

A pixel hides a flat target if the surface seen there is higher than the target
is thick; that, the target's visible pixels and the floor's outline are all that
the label depends on. So the network gets the height above the floor plane, from
the camera's pose, and need not learn perspective.
"""

from typing import NamedTuple

import cv2
import numpy as np

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.floor_grid import Floor, observed_heights

FINE = ("cover", "modal")
"""Channels of :class:`GeometryInput` at the camera's resolution."""

COARSE = ("height", "reading", "floor")
"""Channels of :class:`GeometryInput` at a quarter of it."""

QUARTER = 4
"""Pixels of the camera along a side of a coarse one."""

SIZE_FEATURES = ("length", "width", "thickness", "hidden", "visible")
"""Of :func:`size_features`."""


_COVER_WIDTH = 0.002
"""m above and below the target's top, over which "cover" goes from 0 to 1."""

_LOWEST, _HIGHEST = -0.02, 0.20
"""m, of the heights that are told apart."""

_TYPICAL_PIXELS = 40.0
"""Length of a target in an image 512 wide."""

_TYPICAL_THICKNESS = 0.01


class GeometryInput(NamedTuple):
    """What the compact network sees of an image; all values in [0, 1].

    Attributes:
        fine: (2, H, W) float32. "cover": 1 where the surface is higher than
            the target's top, 0 where lower or without a reading. "modal": the
            mask of what is seen of the target.
        coarse: (3, H/4, W/4) float32, the means over 4 × 4 pixels of the
            height and of whether there is a reading; and whether the ray
            through their middle meets the plane z = 0 within the bin.
    """

    fine: np.ndarray
    coarse: np.ndarray


def geometry_input(
    depth: np.ndarray,
    mask: np.ndarray,
    camera: PinholeCamera,
    thickness: float,
    floor: Floor,
) -> GeometryInput:
    """Returns the compact network's images.

    Args:
        depth: (H, W) z-depth, m; 0, inf and NaN are no reading.
        mask: (H, W) bool, the target's visible pixels; blank where hidden.
        camera: of both; H and W are multiples of 4.
        thickness: of the target, m.
        floor: inside of the bin's.
    """
    depth = np.asarray(depth, dtype=np.float32)
    heights = observed_heights(depth, camera, offset=0.0)
    reading = heights > -np.inf
    heights[~reading] = -1.0
    fine = np.empty((len(FINE), *camera.shape), np.float32)
    cover = fine[0]
    np.subtract(heights, np.float32(thickness), out=cover)
    cover *= np.float32(0.5 / _COVER_WIDTH)
    cover += np.float32(0.5)
    np.clip(cover, 0, 1, out=cover)
    fine[1] = mask
    coarse = np.empty(
        (len(COARSE), camera.height // QUARTER, camera.width // QUARTER),
        np.float32,
    )
    heights -= np.float32(_LOWEST)
    heights *= np.float32(1 / (_HIGHEST - _LOWEST))
    _shrunk(np.clip(heights, 0, 1, out=heights), coarse[0])
    _shrunk(reading.astype(np.float32), coarse[1])
    coarse[2] = _on_floor(camera, floor)
    return GeometryInput(fine, coarse)


def size_features(
    size: np.ndarray, mask: np.ndarray, camera: PinholeCamera
) -> np.ndarray:
    """Returns what the compact network is told of the target.

    Args:
        size: (3,) length, width, thickness of its bounding box, m.
        mask: (H, W) bool, its visible pixels.
        camera: of the mask.

    Returns:
        (5,) float32: logarithms of length and width in the image, thickness,
        1 if nothing of it is seen, and about the share that is seen.
    """
    down = camera.pixel_to_ray[2]
    K = camera.intrinsics
    center = down[0] * K[0, 2] + down[1] * K[1, 2] + down[2]
    distance = camera.X_WC[2, 3] / max(-center, 1e-6)
    long, short = max(size[0], size[1]), min(size[0], size[1])
    pixels = K[0, 0] / distance * np.array([long, short])
    seen = np.count_nonzero(mask)
    return np.array(
        [
            *np.log(np.maximum(pixels, 1e-3) / _scale(camera.width)),
            size[2] / _TYPICAL_THICKNESS,
            float(seen == 0),
            min(1.0, seen / pixels.prod()),
        ],
        dtype=np.float32,
    )


def lengths_in_image(size: np.ndarray, width: int) -> np.ndarray:
    """Returns a target's length and width in the image, pixels.

    Args:
        size: (5,), of :func:`size_features`.
        width: of the image.
    """
    return np.exp(size[:2]) * _scale(width)


def _scale(width: int) -> float:
    """Pixels that a target is typically long in an image of a width."""
    return _TYPICAL_PIXELS * width / 512


def _on_floor(camera: PinholeCamera, floor: Floor) -> np.ndarray:
    """(H/4, W/4) float32: 1 where a ray meets z = 0 within the bin."""
    middle = (QUARTER - 1) / 2
    u = QUARTER * np.arange(camera.width // QUARTER) + middle
    v = QUARTER * np.arange(camera.height // QUARTER) + middle
    slopes = camera.pixel_to_ray
    x, y, z = (
        a * u[None, :] + b * v[:, None] + c for a, b, c in slopes.tolist()
    )
    C = camera.X_WC[:3, 3]
    # At z = 0 a ray has gone −C_z/z; times −z, all is linear and positive.
    down = -z
    x, y = C[0] * down + C[2] * x, C[1] * down + C[2] * y
    inside = down > 0
    for a, b, c in floor.half_planes(0.0).tolist():
        inside &= a * x + b * y <= c * down
    return inside.astype(np.float32)


def _shrunk(image: np.ndarray, out: np.ndarray) -> None:
    height, width = out.shape
    cv2.resize(image, (width, height), dst=out, interpolation=cv2.INTER_AREA)
