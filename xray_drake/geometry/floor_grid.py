"""The bin floor as a lattice that images are warped to and from."""

from dataclasses import dataclass

import cv2
import numpy as np

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.readings import has_reading


@dataclass(frozen=True)
class Floor:
    """The rectangle of the plane z = 0 inside the bin.

    Attributes:
        x: lower and upper bound, m.
        y: lower and upper bound, m.
    """

    x: tuple[float, float]
    y: tuple[float, float]

    def contains(self, xy: np.ndarray) -> np.ndarray:
        """Returns (...) bool, whether points (..., 2 or more) are in it, m."""
        low, high = np.array([self.x, self.y]).T
        xy = np.asarray(xy)[..., :2]
        return ((xy > low) & (xy < high)).all(axis=-1)

    def half_planes(self, tolerance: float) -> np.ndarray:
        """Returns its sides, moved out by ``tolerance`` (m).

        Returns:
            (4, 3) rows a, b, c; a point is inside where a·x + b·y ≤ c.
        """
        return np.array(
            [
                [1.0, 0.0, self.x[1] + tolerance],
                [-1.0, 0.0, tolerance - self.x[0]],
                [0.0, 1.0, self.y[1] + tolerance],
                [0.0, -1.0, tolerance - self.y[0]],
            ]
        )

    def corners(self) -> np.ndarray:
        """Returns the (4, 2) corners, m."""
        return np.array([[x, y] for x in self.x for y in self.y])


@dataclass(frozen=True)
class Window:
    """Rows and columns of a lattice of square cells on the plane.

    Cell (row, column) has its centre at x = cell·(column + column0),
    y = cell·(row + row0). Different windows share one lattice.

    Attributes:
        cell: pitch, m.
        row0: lattice row of the first row.
        column0: lattice column of the first column.
        rows: number of rows (along y).
        columns: number of columns (along x).
    """

    cell: float
    row0: int
    column0: int
    rows: int
    columns: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.rows, self.columns

    @property
    def x(self) -> np.ndarray:
        """The (columns,) x of the cells' centres, m."""
        return self.cell * (np.arange(self.columns) + self.column0)

    @property
    def y(self) -> np.ndarray:
        """The (rows,) y of the cells' centres, m."""
        return self.cell * (np.arange(self.rows) + self.row0)

    def half_planes(self) -> np.ndarray:
        """Returns its (4, 3) sides as ``Floor.half_planes`` does."""
        half = self.cell / 2
        floor = Floor(
            (self.x[0] - half, self.x[-1] + half),
            (self.y[0] - half, self.y[-1] + half),
        )
        return floor.half_planes(0.0)

    def _to_pixels(self, camera: PinholeCamera, height: float) -> np.ndarray:
        to_plane = np.array(
            [
                [self.cell, 0.0, self.cell * self.column0],
                [0.0, self.cell, self.cell * self.row0],
                [0.0, 0.0, 1.0],
            ]
        )
        return camera.plane_homography(height) @ to_plane

    def sample(
        self,
        image: np.ndarray,
        camera: PinholeCamera,
        height: float,
        *,
        outside: float,
        smooth: bool = False,
    ) -> np.ndarray:
        """Reads an image where the cells of a plane appear in it.

        Args:
            image: (H, W) uint8 or float32.
            camera: the camera of the image.
            height: z of the plane, m.
            outside: value where the image does not reach.
            smooth: interpolate, rather than take the nearest pixel.

        Returns:
            (rows, columns) array of the image's type.
        """
        interpolation = cv2.INTER_LINEAR if smooth else cv2.INTER_NEAREST
        return cv2.warpPerspective(
            image,
            self._to_pixels(camera, height),
            (self.columns, self.rows),
            flags=interpolation | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=outside,
        )

    def show(
        self, values: np.ndarray, camera: PinholeCamera, height: float
    ) -> np.ndarray:
        """Draws a lattice of values, lying on a plane, into the image.

        Args:
            values: (rows, columns) float32.
            camera: the camera that looks at them.
            height: z of the plane, m.

        Returns:
            (H, W) float32: the value of the nearest cell, 0 beyond the window.
        """
        return cv2.warpPerspective(
            values,
            self._to_pixels(camera, height),
            (camera.width, camera.height),
            flags=cv2.INTER_NEAREST,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=0,
        )


def image_half_planes(camera: PinholeCamera) -> np.ndarray:
    """Returns what part of the plane z = 0 the image shows.

    Args:
        camera: a camera above the plane.

    Returns:
        (4, 3) rows a, b, c; a point in front of the camera is in the image
        where a·x + b·y ≤ c.
    """
    sides = np.array(
        [
            [1.0, 0.0, 0.5],
            [-1.0, 0.0, camera.width - 0.5],
            [0.0, 1.0, 0.5],
            [0.0, -1.0, camera.height - 0.5],
        ]
    )
    planes = sides @ camera.plane_homography(0.0)
    planes /= np.linalg.norm(planes[:, :2], axis=1, keepdims=True)
    return np.column_stack([-planes[:, :2], planes[:, 2]])


def observed_heights(
    depth: np.ndarray, camera: PinholeCamera, offset: float
) -> np.ndarray:
    """Returns how high over the floor each pixel's surface is.

    Args:
        depth: (H, W) float32 z-depth, m; 0, inf and NaN are no reading.
        camera: the camera of the image.
        offset: added to each depth first, m.

    Returns:
        (H, W) float32 z in the world, m; −inf where there is no reading.
    """
    R, K = camera.X_WC[:3, :3], camera.intrinsics
    across = (np.arange(camera.width) - K[0, 2]) / K[0, 0] * R[2, 0]
    down = (np.arange(camera.height) - K[1, 2]) / K[1, 1] * R[2, 1]
    slope = np.add.outer(down + R[2, 2], across).astype(np.float32)
    heights = slope * (depth + np.float32(offset))
    heights += np.float32(camera.X_WC[2, 3])
    heights[~has_reading(depth)] = -np.inf
    return heights


def pose_bounds(
    points: np.ndarray, camera_center: np.ndarray, half_planes: np.ndarray
) -> np.ndarray:
    """Bounds where a body can stand so that its shadow keeps inside.

    The shadow of a point p at height z, cast from the camera's centre C onto
    the floor, is C + (p − C)·C_z / (C_z − z): the pixels of a body are
    those of its shadow.

    Args:
        points: (n, 3) vertices of the body; x and y from its origin, z over
            the floor, m.
        camera_center: (3,) in the world, m, above all points.
        half_planes: (k, 3) rows a, b, c of a·x + b·y ≤ c.

    Returns:
        (k, 3) rows a, b, c′: the same for the body's origin.
    """
    normals, limits = half_planes[:, :2], half_planes[:, 2]
    scale = camera_center[2] / (camera_center[2] - points[:, 2])
    reach = normals @ points[:, :2].T
    center = (normals @ camera_center[:2])[:, None]
    bounds = (limits[:, None] - center * (1 - scale)) / scale - reach
    return np.column_stack([normals, bounds.min(axis=1)])


def inside(window: Window, half_planes: np.ndarray) -> np.ndarray | None:
    """Returns the (rows, columns) bool mask of cells within half-planes.

    None stands for all of them: most half-planes cut nothing off.
    """
    x, y = window.x, window.y
    a, b, limits = half_planes.T
    limits = limits + 1e-9
    farthest = np.maximum(a * x[0], a * x[-1]) + np.maximum(b * y[0], b * y[-1])
    mask = None
    for k in np.flatnonzero(farthest > limits):
        cut = np.add.outer(b[k] * y, a[k] * x) <= limits[k]
        mask = cut if mask is None else mask & cut
    return mask
