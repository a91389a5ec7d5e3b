"""The target as it lies flat on the floor, and its silhouettes."""

import cv2
import numpy as np
import trimesh
from scipy.spatial import ConvexHull

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.silhouette import (
    convex_mask,
    facing_triangles,
    fill_convex,
)
from xray_drake.occupancy.geometric.columns import measure_columns

_SUBSAMPLES = 7
"""Odd, so that one sub-pixel lies at the centre of each cell."""


class FlatTarget:
    """A target lying on the floor with its body z axis up.

    Attributes:
        vertices: (n, 3) vertices of what its silhouette depends on, m; origin
            at the body's, z from the floor.
        thickness: height of its highest point, m.
        radius: largest horizontal distance of a vertex from the origin, m.
        groups: its column groups.
        convex: its silhouette is convex, by 99 % of the area.
        top: median height of what is seen from above, m.
    """

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        """Measures a closed mesh given in the body frame, m."""
        self.vertices = np.array(mesh.vertices, dtype=float)
        self.vertices[:, 2] -= self.vertices[:, 2].min()
        self.thickness = float(self.vertices[:, 2].max())
        self.radius = float(np.hypot(*self.vertices[:, :2].T).max())
        self._faces = np.array(mesh.faces)
        pitch = self.radius / 200
        # One row and column more than the vertices reach, on each side.
        origin = np.array([202.0, 202.0])
        canvas = np.zeros((405, 405), dtype=np.uint8)
        flat = self.vertices[:, :2] / pitch + origin
        fill_convex(canvas, facing_triangles(flat, self._faces[:, ::-1]))
        hull = np.zeros_like(canvas)
        fill_convex(hull, _outline(flat)[None])
        self.convex = bool(canvas.sum() >= 0.99 * hull.sum())
        self._columns = measure_columns(
            trimesh.Trimesh(self.vertices, self._faces, process=False),
            canvas,
            pitch,
            origin,
        )
        self.groups = self._columns.groups
        self.top = self._columns.top
        if self.convex:
            self.vertices = self.vertices[ConvexHull(self.vertices).vertices]

    def rotated(self, angle: float) -> np.ndarray:
        """Returns the (n, 3) vertices turned by ``angle`` (rad) about z."""
        c, s = np.cos(angle), np.sin(angle)
        turned = self.vertices.copy()
        turned[:, :2] = self.vertices[:, :2] @ np.array([[c, s], [-s, c]])
        return turned

    def project(
        self, angle: float, pixels: np.ndarray, camera: PinholeCamera
    ) -> np.ndarray:
        """Projects the target where its axis is seen at given pixels.

        Args:
            angle: orientation about world z, rad.
            pixels: (n, 2) u, v of the axis at half the target's height.
            camera: the camera.

        Returns:
            (n, k, 2) u, v of the vertices.
        """
        to_plane = np.linalg.inv(camera.plane_homography(self.thickness / 2))
        ray = pixels @ to_plane[:, :2].T + to_plane[:, 2]
        origins = np.pad(ray[:, :2] / ray[:, 2:], ((0, 0), (0, 1)))
        return camera.project(self.rotated(angle) + origins[:, None])[..., :2]

    def mask(self, points: np.ndarray, reach: int) -> np.ndarray:
        """Draws the silhouette of the target's vertices seen at ``points``.

        Args:
            points: (n, 2) where each vertex is seen, in cells (pixels); x
                right and y down as the viewer sees it.
            reach: half width of the raster in cells; the origin is the centre
                of its middle cell.

        Returns:
            (2·reach + 1)² float32 array: 1 where the centre of a cell is
            covered, else 0. Rows along y, columns along x.
        """
        if self.convex:
            size = 2 * reach + 1
            outline = _outline(points) + reach
            return convex_mask(outline, (size, size)).astype(np.float32)
        return _centers(self._canvas(points, reach, seen_from_above=False))

    def group_rasters(
        self, angle: float, cell: float, reach: int
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Draws each column group from straight above.

        Args:
            angle: orientation of the target about z, rad.
            cell: pitch of the raster, m.
            reach: half width of the raster in cells; the origin is the centre
                of its middle cell.

        Returns:
            For each group two (2·reach + 1)² float32 arrays: the covered share
            of each cell, and 1 where the cell's centre is covered, else 0.
            Rows along y, columns along x.
        """
        points = self.rotated(angle)[:, :2] / cell
        canvas = self._canvas(points, reach, seen_from_above=True)
        if len(self.groups) == 1:
            return [(_coverage(canvas), _centers(canvas))]
        c, s = np.cos(angle), np.sin(angle)
        fine = cell / _SUBSAMPLES
        scale = fine / self._columns.pitch
        middle = (canvas.shape[0] - 1) / 2
        # From a sub-pixel of the canvas to a pixel of the label image.
        turn = scale * np.array([[c, s], [-s, c]])
        shift = self._columns.origin - turn @ np.full(2, middle)
        labels = cv2.warpAffine(
            self._columns.labels,
            np.column_stack([turn, shift]),
            canvas.shape,
            flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        )
        parts = [
            canvas * (labels == k).astype(np.uint8)
            for k in range(len(self.groups))
        ]
        return [(_coverage(part), _centers(part)) for part in parts]

    def distinct_angles(self, rotations: int) -> np.ndarray:
        """Returns those of equally spaced angles whose silhouettes differ.

        Args:
            rotations: number of angles over the full turn.

        Returns:
            (k,) angles in rad, k a divisor of ``rotations``.
        """
        scale = 64 / self.radius
        reference = self.mask(self.vertices[:, :2] * [scale, -scale], 66) > 0
        best = 1
        for order in range(2, 13):
            if rotations % order:
                continue
            turned = self.rotated(2 * np.pi / order)[:, :2]
            other = self.mask(turned * [scale, -scale], 66) > 0
            different = np.count_nonzero(reference ^ other)
            if different <= 0.02 * np.count_nonzero(reference):
                best = order
        return np.arange(rotations // best) * (2 * np.pi / rotations)

    def _canvas(
        self, points: np.ndarray, reach: int, *, seen_from_above: bool
    ) -> np.ndarray:
        """Draws the silhouette on a raster finer by ``_SUBSAMPLES``.

        Args:
            points: (n, 2) vertices in cells.
            reach: half width in cells.
            seen_from_above: rows run along y up, so that the raster shows a
                mirror image.
        """
        size = (2 * reach + 1) * _SUBSAMPLES
        fine = points * _SUBSAMPLES + (size - 1) / 2
        if self.convex:
            return convex_mask(_outline(fine), (size, size)).astype(np.uint8)
        canvas = np.zeros((size, size), dtype=np.uint8)
        faces = self._faces[:, ::-1] if seen_from_above else self._faces
        fill_convex(canvas, facing_triangles(fine, faces))
        return canvas


def _outline(points: np.ndarray) -> np.ndarray:
    return cv2.convexHull(points.astype(np.float32))[:, 0].astype(float)


def _coverage(canvas: np.ndarray) -> np.ndarray:
    side = canvas.shape[0] // _SUBSAMPLES
    return cv2.resize(
        canvas.astype(np.float32), (side, side), interpolation=cv2.INTER_AREA
    )


def _centers(canvas: np.ndarray) -> np.ndarray:
    middle = _SUBSAMPLES // 2
    return canvas[middle::_SUBSAMPLES, middle::_SUBSAMPLES].astype(np.float32)
