"""A body that stands, drawn where its axis is seen at a pixel; compiled."""

from typing import NamedTuple

import numpy as np

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.silhouette import draw_nearest
from xray_drake.kernels import kernel


class View(NamedTuple):
    """A camera as the compiled loops take it.

    Attributes:
        ray: 3×3, from pixels (u, v, 1) to world rays of unit z-depth.
        center: (3,) of the camera in the world, m.
        intrinsics: 3×3 camera matrix.
        rotation: 3×3 orientation of the camera in the world.
    """

    ray: np.ndarray
    center: np.ndarray
    intrinsics: np.ndarray
    rotation: np.ndarray

    @staticmethod
    def of(camera: PinholeCamera) -> "View":
        """Returns the view of a camera."""
        return View(
            np.ascontiguousarray(camera.pixel_to_ray),
            np.array(camera.X_WC[:3, 3]),
            # Copies: to numba, an array that may not be written is another
            # type.
            np.array(camera.intrinsics),
            np.array(camera.X_WC[:3, :3]),
        )


class Drawing(NamedTuple):
    """What a body is drawn by, wherever it is in the image.

    Attributes:
        vertices: (n, 3), turned; x and y from the axis, z from the floor, m.
        faces: (m, 3) indices of outward-facing triangles.
        reach: half width of what it is drawn on, pixels.
        middle: height at which the axis is seen at a pixel's centre, m.
        camera: as the loops take it.
    """

    vertices: np.ndarray
    faces: np.ndarray
    reach: int
    middle: float
    camera: View


@kernel
def axis_at(u: float, v: float, drawing: Drawing) -> tuple[float, float]:
    """Returns x and y of the axis that is seen at a pixel."""
    ray, center = drawing.camera.ray, drawing.camera.center
    slope = ray[2, 0] * u + ray[2, 1] * v + ray[2, 2]
    depth = (drawing.middle - center[2]) / slope
    x = center[0] + depth * (ray[0, 0] * u + ray[0, 1] * v + ray[0, 2])
    y = center[1] + depth * (ray[1, 0] * u + ray[1, 1] * v + ray[1, 2])
    return x, y


@kernel
def draw_body(
    drawing: Drawing, pixel: np.ndarray, canvas: np.ndarray
) -> np.ndarray:
    """Draws a body as the camera sees it where its axis is at a pixel.

    Args:
        drawing: of the body.
        pixel: (2,) u, v of the axis.
        canvas: (2·reach + 1)² float32; overwritten with the height of what is
            seen of the body, m, or −1 beside it. ``pixel`` is in its middle.

    Returns:
        (4,) least u, greatest u, least v, greatest v, from ``pixel``.
    """
    vertices, reach = drawing.vertices, drawing.reach
    ray, center, intrinsics, rotation = drawing.camera
    x, y = axis_at(pixel[0], pixel[1], drawing)
    count = len(vertices)
    points = np.empty((count, 2))
    nearness = np.empty(count)
    box = np.array([np.inf, -np.inf, np.inf, -np.inf])
    for i in range(count):
        px = vertices[i, 0] + x - center[0]
        py = vertices[i, 1] + y - center[1]
        pz = vertices[i, 2] - center[2]
        cx = px * rotation[0, 0] + py * rotation[1, 0] + pz * rotation[2, 0]
        cy = px * rotation[0, 1] + py * rotation[1, 1] + pz * rotation[2, 1]
        cz = px * rotation[0, 2] + py * rotation[1, 2] + pz * rotation[2, 2]
        u = intrinsics[0, 0] * cx / cz + intrinsics[0, 2] - pixel[0]
        v = intrinsics[1, 1] * cy / cz + intrinsics[1, 2] - pixel[1]
        box[0], box[1] = min(box[0], u), max(box[1], u)
        box[2], box[3] = min(box[2], v), max(box[3], v)
        points[i, 0], points[i, 1] = u + reach, v + reach
        nearness[i] = 1.0 / cz
    canvas[:] = -1.0
    draw_nearest(points, nearness, drawing.faces, canvas)
    rows, columns = box_spans(box, reach)
    for row in range(rows[0], rows[1]):
        for column in range(columns[0], columns[1]):
            if canvas[row, column] > 0.0:
                u = pixel[0] + column - reach
                v = pixel[1] + row - reach
                slope = ray[2, 0] * u + ray[2, 1] * v + ray[2, 2]
                height = center[2] + slope / canvas[row, column]
                canvas[row, column] = max(height, 0.0)
    return box


@kernel
def draw_in_block(
    drawing: Drawing, corner: np.ndarray, side: int
) -> tuple[np.ndarray, np.ndarray]:
    """Draws a body for the middle of a block: canvas and box, as above."""
    pixel = np.empty(2)
    pixel[0] = corner[1] + side // 2
    pixel[1] = corner[0] + side // 2
    width = 2 * drawing.reach + 1
    canvas = np.empty((width, width), dtype=np.float32)
    return canvas, draw_body(drawing, pixel, canvas)


@kernel
def box_spans(
    box: np.ndarray, reach: int
) -> tuple[tuple[int, int], tuple[int, int]]:
    """Returns the rows and columns of a canvas that a body's box covers."""
    most = 2 * reach + 1
    return (
        (
            max(int(np.floor(box[2])) + reach, 0),
            min(int(np.ceil(box[3])) + reach + 1, most),
        ),
        (
            max(int(np.floor(box[0])) + reach, 0),
            min(int(np.ceil(box[1])) + reach + 1, most),
        ),
    )
