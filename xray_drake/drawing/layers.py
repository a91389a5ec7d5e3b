"""Images laid over the heap as geometry in the world."""

import cv2
import numpy as np

from xray_drake.drawing.colors import heat
from xray_drake.geometry.camera import PinholeCamera

_GAP = 0.004
"""How far a layer hovers over the surface that it lies on, m."""


def surface_depth(
    depth: np.ndarray, camera: PinholeCamera, *, reach: int = 3
) -> np.ndarray:
    """Returns a depth image that lies on the heap without tearing.

    Args:
        depth: (H, W) z-depth, m; no reading becomes the floor.
        camera: of the image.
        reach: a pixel takes the nearest depth within this many pixels.

    Returns:
        (H, W) z-depth, m, :data:`_GAP` in front of the surface.
    """
    floor = camera.plane_depth(0.0)
    valid = np.isfinite(depth) & (depth > 0)
    filled = np.where(valid, np.minimum(depth, floor), floor)
    size = 2 * reach + 1
    nearest = cv2.erode(
        filled.astype(np.float32), np.ones((size, size), np.uint8)
    )
    return nearest - _GAP


def heat_layer(
    values: np.ndarray,
    depth: np.ndarray,
    camera: PinholeCamera,
    *,
    step: int = 2,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns a distribution as coloured triangles over the heap.

    Args:
        values: (H, W) in [0, 1]; only what is above 0 is drawn.
        depth: (H, W) z-depth that the layer lies on, m.
        camera: of both images.
        step: pixels per side of a tile.

    Returns:
        (3, n) vertices in the world in m, (3, m) triangles, (3, n) RGB in
        [0, 1]; all with no columns where nothing is above 0.
    """
    points = camera.unproject(depth)[::step, ::step]
    shown = values[::step, ::step]
    filled = (
        (shown[:-1, :-1] > 0)
        & (shown[1:, :-1] > 0)
        & (shown[:-1, 1:] > 0)
        & (shown[1:, 1:] > 0)
    )
    index = np.arange(shown.size).reshape(shown.shape)
    a, b = index[:-1, :-1][filled], index[:-1, 1:][filled]
    c, d = index[1:, :-1][filled], index[1:, 1:][filled]
    faces = np.concatenate([np.stack([a, c, b]), np.stack([b, c, d])], axis=1)
    used, faces = np.unique(faces, return_inverse=True)
    faces = faces.reshape(3, -1)
    return (
        points.reshape(-1, 3)[used].T,
        faces.astype(np.int32),
        heat(shown.reshape(-1)[used]).T,
    )


def mask_outline(
    mask: np.ndarray, depth: np.ndarray, camera: PinholeCamera
) -> np.ndarray:
    """Returns the outline of a mask as line segments over the heap.

    Args:
        mask: (H, W) bool.
        depth: (H, W) z-depth that the outline lies on, m.
        camera: of both images.

    Returns:
        (2, 3, n) starts and ends of n segments in the world, m.
    """
    contours, _ = cv2.findContours(
        mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    points = camera.unproject(depth)
    starts, ends = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for contour in contours:
        line = points[contour[:, 0, 1], contour[:, 0, 0]]
        starts.append(line)
        ends.append(np.roll(line, -1, axis=0))
    return np.stack([np.concatenate(starts).T, np.concatenate(ends).T])
