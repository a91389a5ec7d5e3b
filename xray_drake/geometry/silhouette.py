"""Silhouettes of meshes as images, by polygon fill."""

import cv2
import numpy as np

from xray_drake.geometry.camera import PinholeCamera

_SHIFT = 8
_SUBSAMPLES = 15


def facing_triangles(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Selects the projected triangles that turn clockwise in the image.

    The silhouette of a closed mesh is the union of the triangles that face
    the viewer; each of those that do not is behind some that do.

    Args:
        points: (n, 2) projected vertices, in a frame with x right and y down
            as the viewer sees it.
        faces: (m, 3) indices of outward-facing triangles.

    Returns:
        (k, 3, 2) corners of those that face the viewer.
    """
    corners = points[faces]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return corners[a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] < 0]


def fill_convex(canvas: np.ndarray, polygons: np.ndarray) -> None:
    """Sets to 1 what convex polygons cover.

    Args:
        canvas: (h, w) uint8, changed in place; pixel centres at integers.
        polygons: (k, n, 2) corners in pixels. OpenCV draws the outline too,
            so each polygon grows by up to half a pixel: draw on a canvas finer
            than what the result is used for.
    """
    fixed = np.rint(polygons * (1 << _SHIFT)).astype(np.int32)
    for polygon in fixed:
        cv2.fillConvexPoly(canvas, polygon, 1, cv2.LINE_8, _SHIFT)


def convex_mask(polygon: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Draws a convex polygon exactly: a pixel is in if its centre is.

    Args:
        polygon: (n, 2) corners in order, pixels; pixel centres at integers.
        shape: height and width of the image.

    Returns:
        (height, width) bool mask.
    """
    rows = np.arange(shape[0], dtype=float)
    ends = np.roll(polygon, -1, axis=0)
    rise = ends[:, 1] - polygon[:, 1]
    steep = rise != 0
    a, b, rise = polygon[steep], ends[steep], rise[steep]
    share = (rows[:, None] - a[:, 1]) / rise
    crossing = a[:, 0] + share * (b[:, 0] - a[:, 0])
    crosses = (share >= 0) & (share <= 1)
    left = np.where(crosses, crossing, np.inf).min(axis=1, initial=np.inf)
    right = np.where(crosses, crossing, -np.inf).max(axis=1, initial=-np.inf)
    columns = np.arange(shape[1], dtype=float)
    return (columns >= left[:, None]) & (columns <= right[:, None])


def project_mesh_mask(
    vertices_O: np.ndarray,
    faces: np.ndarray,
    X_WO: np.ndarray,
    camera: PinholeCamera,
) -> np.ndarray:
    """Draws the amodal silhouette of a mesh, as if nothing were before it.

    Holes that show the background through the mesh remain background.

    Args:
        vertices_O: (n, 3) vertices in the body frame O, m.
        faces: (m, 3) vertex indices of the outward-facing triangles of a
            closed mesh.
        X_WO: 4×4 pose of the body in the world.
        camera: the camera; all vertices must be in front of it.

    Returns:
        (H, W) bool, true where the ray through a pixel's centre meets the
        mesh, to a thirtieth of a pixel.

    Raises:
        ValueError: a vertex lies behind the camera.
    """
    p_W = vertices_O @ X_WO[:3, :3].T + X_WO[:3, 3]
    projected = camera.project(p_W)
    if projected[:, 2].min() <= 0:
        raise ValueError("cannot draw a mesh that reaches behind the camera")
    uv = projected[:, :2]
    mask = np.zeros(camera.shape, dtype=bool)
    low = np.maximum(np.floor(uv.min(axis=0)).astype(int), 0)
    high = np.minimum(
        np.ceil(uv.max(axis=0)).astype(int) + 1, camera.shape[::-1]
    )
    if (high <= low).any():
        return mask
    width, height = (high - low) * _SUBSAMPLES
    canvas = np.zeros((height, width), dtype=np.uint8)
    middle = _SUBSAMPLES // 2
    fine = (uv - low) * _SUBSAMPLES + middle
    fill_convex(canvas, facing_triangles(fine, np.asarray(faces)))
    mask[low[1] : high[1], low[0] : high[0]] = canvas[
        middle::_SUBSAMPLES, middle::_SUBSAMPLES
    ]
    return mask
