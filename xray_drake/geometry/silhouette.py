"""Draws meshes and convex polygons as images, by their pixels' centres.

A pixel is in where its centre is: of meshes (:func:`project_mesh_mask`,
:func:`height_map`), and of convex polygons (:func:`convex_spans`).
:func:`fill_convex` alone draws the outline, too. Numba keeps what it compiles
beside this file, or in the user's cache where that is read-only, so that only
the first process pays.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.kernels import kernel

_SHIFT = 8


@kernel
def draw_nearest(
    points: np.ndarray,
    nearness: np.ndarray,
    faces: np.ndarray,
    canvas: np.ndarray,
) -> None:
    """Draws a closed mesh's nearest surface: a pixel is in if its centre is.

    Args:
        points: (n, 2) projected vertices, pixels; x right and y down as the
            viewer sees it, pixel centres at integers.
        nearness: (n,) what is interpolated over each triangle and is larger
            the nearer the viewer: the height from above, or the reciprocal of
            the depth in perspective.
        faces: (m, 3) indices of outward-facing triangles.
        canvas: (h, w) float32, raised in place.
    """
    height, width = canvas.shape
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay = points[a, 0], points[a, 1]
        bx, by = points[b, 0] - ax, points[b, 1] - ay
        cx, cy = points[c, 0] - ax, points[c, 1] - ay
        area = bx * cy - by * cx
        if area >= 0.0:  # Turned away; behind a triangle that is not.
            continue
        nb, nc = nearness[b] - nearness[a], nearness[c] - nearness[a]
        across = (nb * cy - nc * by) / area
        down = (nc * bx - nb * cx) / area
        top = max(int(np.ceil(ay + min(0.0, by, cy))), 0)
        bottom = min(int(np.floor(ay + max(0.0, by, cy))), height - 1)
        for v in range(top, bottom + 1):
            y = v - ay
            low, high = np.inf, -np.inf
            # Where the row crosses each of the three sides.
            for side in range(3):
                if side == 0:
                    px, py, qx, qy = 0.0, 0.0, bx, by
                elif side == 1:
                    px, py, qx, qy = bx, by, cx, cy
                else:
                    px, py, qx, qy = cx, cy, 0.0, 0.0
                if py == qy:
                    if py == y:
                        low = min(low, px, qx)
                        high = max(high, px, qx)
                elif min(py, qy) <= y <= max(py, qy):
                    x = px + (qx - px) * (y - py) / (qy - py)
                    low = min(low, x)
                    high = max(high, x)
            first = max(int(np.ceil(ax + low)), 0) if high >= low else 0
            last = min(int(np.floor(ax + high)), width - 1)
            if high < low:
                last = -1
            value = nearness[a] + across * (first - ax) + down * y
            for u in range(first, last + 1):
                if value > canvas[v, u]:
                    canvas[v, u] = value
                value += across


def height_map(
    vertices: np.ndarray, faces: np.ndarray, pitch: float, reach: int
) -> np.ndarray:
    """Returns the heights of a mesh as seen from straight above.

    Args:
        vertices: (n, 3), m; z from the floor.
        faces: (m, 3) indices of outward-facing triangles.
        pitch: of the map, m.
        reach: half its width in cells; x = y = 0 is in its middle cell.

    Returns:
        (2·reach + 1)² float32, m; 0 beside the mesh. Rows along −y.
    """
    side = 2 * reach + 1
    canvas = np.zeros((side, side), dtype=np.float32)
    points = np.column_stack([vertices[:, 0], -vertices[:, 1]]) / pitch + reach
    draw_nearest(
        np.ascontiguousarray(points),
        np.ascontiguousarray(vertices[:, 2]),
        np.ascontiguousarray(faces, dtype=np.int64),
        canvas,
    )
    return canvas


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
        mesh.

    Raises:
        ValueError: a vertex lies behind the camera.
    """
    p_W = vertices_O @ X_WO[:3, :3].T + X_WO[:3, 3]
    projected = camera.project(p_W)
    if projected[:, 2].min() <= 0:
        raise ValueError("cannot draw a mesh that reaches behind the camera")
    canvas = np.zeros(camera.shape, dtype=np.float32)
    draw_nearest(
        np.ascontiguousarray(projected[:, :2]),
        1 / projected[:, 2],
        np.ascontiguousarray(faces, dtype=np.int64),
        canvas,
    )
    return canvas > 0


@dataclass(frozen=True)
class Spans:
    """The pixels of n convex masks, row by row.

    Attributes:
        rows: (n, r) image row of each span.
        starts: (n, r) its first column.
        ends: (n, r) one past its last column; ``starts`` where it is empty.
        shape: height and width of the image; all spans are inside.
    """

    rows: np.ndarray
    starts: np.ndarray
    ends: np.ndarray
    shape: tuple[int, int]

    def areas(self) -> np.ndarray:
        """Returns the (n,) numbers of pixels."""
        return (self.ends - self.starts).sum(axis=1)

    def sums(self, image: np.ndarray) -> np.ndarray:
        """Returns the (n,) sums of an (H, W) bool image over each mask."""
        running = np.zeros((self.shape[0], self.shape[1] + 1), dtype=np.int32)
        np.cumsum(image, axis=1, out=running[:, 1:])
        return (
            running[self.rows, self.ends] - running[self.rows, self.starts]
        ).sum(axis=1)

    def total(self, chosen: np.ndarray) -> np.ndarray:
        """Returns (H, W) float32: how many ``chosen`` masks cover a pixel.

        Args:
            chosen: (n,) bool.
        """
        height, width = self.shape
        row = self.rows[chosen].ravel() * (width + 1)
        size = height * (width + 1)
        change = np.bincount(row + self.starts[chosen].ravel(), minlength=size)
        change -= np.bincount(row + self.ends[chosen].ravel(), minlength=size)
        covered = np.cumsum(change.reshape(height, width + 1), axis=1)
        return covered[:, :-1].astype(np.float32)


def convex_spans(outlines: np.ndarray, shape: tuple[int, int]) -> Spans:
    """Draws convex polygons exactly: a pixel is in if its centre is.

    Args:
        outlines: (n, e, 2) corners in order, pixels; pixel centres at
            integers.
        shape: height and width of the image; what is outside is cut off.
    """
    outlines = np.ascontiguousarray(outlines, dtype=float)
    first = np.ceil(outlines[..., 1].min(axis=1)).astype(int)
    last = np.floor(outlines[..., 1].max(axis=1)).astype(int)
    count = max(int((last - first).max(initial=0)) + 1, 1)
    rows = first[:, None] + np.arange(count)
    starts, ends = np.zeros((2, *rows.shape), dtype=int)
    _find_ends(outlines, rows, last, np.array(shape), starts, ends)
    return Spans(rows.clip(0, shape[0] - 1), starts, ends, shape)


def convex_mask(outline: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Returns one of the masks of :func:`convex_spans` as an image.

    Args:
        outline: (e, 2) corners in order, pixels.
        shape: height and width of the image.

    Returns:
        (height, width) bool.
    """
    spans = convex_spans(outline[None], shape)
    mask = np.zeros(shape, dtype=bool)
    for row, start, end in zip(
        spans.rows[0], spans.starts[0], spans.ends[0], strict=True
    ):
        mask[row, start:end] = True
    return mask


@kernel
def _find_ends(
    outlines: np.ndarray,
    rows: np.ndarray,
    last: np.ndarray,
    shape: np.ndarray,
    starts: np.ndarray,
    ends: np.ndarray,
) -> None:
    """Finds where rows enter and leave polygons.

    Args:
        outlines: (n, e, 2), as of ``convex_spans``.
        rows: (n, r) rows of each.
        last: (n,) the last row that meets each.
        shape: (2,) height and width of the image.
        starts: (n, r) zeros, overwritten where something is inside.
        ends: (n, r), too.
    """
    count = outlines.shape[1]
    for i in range(len(outlines)):
        x, y = outlines[i, :, 0], outlines[i, :, 1]
        turn = 0.0
        for k in range(count):
            after = (k + 1) % count
            turn += x[k] * y[after] - y[k] * x[after]
        for j in range(rows.shape[1]):
            row = rows[i, j]
            if row < 0 or row >= shape[0] or row > last[i]:
                continue
            # A row of a convex polygon ends where it first meets a side's line.
            left, right = -np.inf, np.inf
            for k in range(count):
                after = (k + 1) % count
                rise = y[after] - y[k]
                if rise == 0.0:
                    continue
                slope = (x[after] - x[k]) / rise
                line = x[k] - slope * y[k] + slope * row
                if rise * turn > 0.0:
                    right = min(right, line)
                elif rise * turn < 0.0:
                    left = max(left, line)
            if left <= right:
                start = max(np.ceil(left), 0.0)
                end = min(np.floor(right) + 1.0, float(shape[1]))
                if start < end:
                    starts[i, j], ends[i, j] = int(start), int(end)


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
