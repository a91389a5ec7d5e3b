"""Images laid over the heap as geometry in the world."""

import cv2
import numpy as np

from xray_drake.drawing.colors import heat
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


def tiles(
    shown: np.ndarray,
    depth: np.ndarray,
    camera: PinholeCamera,
    *,
    step: int,
    labels: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the tiles of a depth image whose four corners are shown.

    Args:
        shown: (H, W) bool.
        depth: (H, W) z-depth, m.
        camera: of both images.
        step: pixels per side of a tile.
        labels: (H, W); a tile whose corners differ in it is left out.

    Returns:
        (3, n) vertices in the world in m, (3, m) triangles that face the
        camera, (n,) each vertex's pixel as an index into the flat image; all
        with no columns where nothing is shown.
    """
    corners = _corners(shown[::step, ::step])
    filled = np.logical_and.reduce(corners)
    if labels is not None:
        first, *others = _corners(labels[::step, ::step])
        filled &= np.logical_and.reduce([first == other for other in others])
    index = np.arange(shown.size).reshape(shown.shape)[::step, ::step]
    a, b = index[:-1, :-1][filled], index[:-1, 1:][filled]
    c, d = index[1:, :-1][filled], index[1:, 1:][filled]
    faces = np.concatenate([np.stack([a, c, b]), np.stack([b, c, d])], axis=1)
    used, faces = np.unique(faces, return_inverse=True)
    points = camera.unproject(depth).reshape(-1, 3)[used]
    return points.T, faces.reshape(3, -1).astype(np.int32), used


def _corners(image: np.ndarray) -> list[np.ndarray]:
    return [image[:-1, :-1], image[1:, :-1], image[:-1, 1:], image[1:, 1:]]


def mask_layer(
    labels: np.ndarray,
    colors: np.ndarray,
    depth: np.ndarray,
    camera: PinholeCamera,
    *,
    step: int = 2,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns instance masks as coloured triangles over the heap.

    Masks that touch are kept apart by a seam of one tile.

    Args:
        labels: (H, W) int; what is below 0 is not drawn.
        colors: (n, 3) RGB in [0, 1] of each label; NaN is not drawn.
        depth: (H, W) z-depth that the layer lies on, m.
        camera: of both images.
        step: pixels per side of a tile.

    Returns:
        (3, n) vertices in the world in m, (3, m) triangles, (3, n) RGB in
        [0, 1]; all with no columns where nothing is drawn.
    """
    drawn = np.append(np.isfinite(colors).all(axis=1), False)
    vertices, faces, pixels = tiles(
        drawn[labels], depth, camera, step=step, labels=labels
    )
    return vertices, faces, colors[labels.reshape(-1)[pixels]].T


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
    vertices, faces, pixels = tiles(values > 0, depth, camera, step=step)
    return vertices, faces, heat(values.reshape(-1)[pixels]).T


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
    vertices, faces, _ = tiles(band, depth, camera, step=1)
    return vertices, faces
