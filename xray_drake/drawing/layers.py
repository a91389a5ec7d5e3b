"""Images laid over the heap as geometry in the world."""

import cv2
import numpy as np

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.readings import has_reading

_GAP = 0.004
"""How far a layer hovers over the surface that it lies on, m."""


def surface_depth(
    depth: np.ndarray,
    camera: PinholeCamera,
    *,
    reach: int = 3,
    gap: float = _GAP,
) -> np.ndarray:
    """Returns a depth image that lies on the heap without tearing.

    Args:
        depth: (H, W) z-depth, m; no reading becomes the floor.
        camera: of the image.
        reach: a pixel takes the nearest depth within this many pixels.
        gap: how far in front of the surface, m.

    Returns:
        (H, W) z-depth, m.
    """
    floor = camera.plane_depth(0.0)
    valid = has_reading(depth)
    filled = np.where(valid, np.minimum(depth, floor), floor)
    size = 2 * reach + 1
    nearest = cv2.erode(
        filled.astype(np.float32), np.ones((size, size), np.uint8)
    )
    return nearest - gap


def color_layer(
    colors: np.ndarray,
    depth: np.ndarray,
    camera: PinholeCamera,
    *,
    step: int = 2,
    labels: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns a picture as coloured triangles over the heap.

    A tile is drawn where its four corners are.

    Args:
        colors: (H, W, 3) RGB in [0, 1]; NaN is not drawn.
        depth: (H, W) z-depth that the layer lies on, m.
        camera: of all images.
        step: pixels per side of a tile.
        labels: (H, W); a tile whose corners differ in it is left out.

    Returns:
        (3, n) vertices in the world in m, (3, m) triangles that face the
        camera, (3, n) RGB; all with no columns where nothing is drawn.
    """
    corners = _corners(np.isfinite(colors[::step, ::step, 0]))
    filled = np.logical_and.reduce(corners)
    if labels is not None:
        first, *others = _corners(labels[::step, ::step])
        filled &= np.logical_and.reduce([first == other for other in others])
    index = np.arange(depth.size).reshape(depth.shape)[::step, ::step]
    a, c, b, d = (corner[filled] for corner in _corners(index))
    faces = np.concatenate([np.stack([a, c, b]), np.stack([b, c, d])], axis=1)
    used, faces = np.unique(faces, return_inverse=True)
    points = camera.unproject(depth).reshape(-1, 3)[used]
    painted = colors.reshape(-1, 3)[used]
    return points.T, faces.reshape(3, -1).astype(np.int32), painted.T


def _corners(image: np.ndarray) -> list[np.ndarray]:
    return [image[:-1, :-1], image[1:, :-1], image[:-1, 1:], image[1:, 1:]]


def mask_outline(
    mask: np.ndarray,
    depth: np.ndarray,
    camera: PinholeCamera,
    *,
    width: int = 1,
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the outline of a mask as a band of triangles over the heap.

    A band, since browsers draw all lines one pixel wide.

    Args:
        mask: (H, W) bool.
        depth: (H, W) z-depth that the outline lies on, m.
        camera: of both images.
        width: of the band inside the mask's edge, and outside it, pixels.

    Returns:
        (3, n) vertices in the world in m, (3, m) triangles; both with no
        columns where the mask is blank.
    """
    size = 2 * width + 1
    kernel = np.ones((size, size), np.uint8)
    inside = mask.astype(np.uint8)
    band = cv2.dilate(inside, kernel) > cv2.erode(inside, kernel)
    shown = np.where(band, 0.0, np.nan)[..., None].repeat(3, axis=2)
    vertices, faces, _ = color_layer(shown, depth, camera, step=1)
    return vertices, faces
