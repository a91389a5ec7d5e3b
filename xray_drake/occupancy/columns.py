"""A flat target as upright columns between two heights.

Under perspective, what a target hides on the floor depends on the heights of
its parts. Its silhouette from above is therefore split into a few groups of
columns, each with one lower and one upper height: a box is one group, a tube
on its side is a middle strip and two thin flanks halfway up.
"""

from dataclasses import dataclass

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

_LEVEL_SPACING = 0.008
"""Heights are sorted into levels at most this far apart, m."""

_SMALLEST_SHARE = 0.1
"""Groups of a smaller share of the silhouette join their nearest."""

_SUBSAMPLES = 7
"""Odd, so that one sub-pixel lies at the centre of each cell."""


@dataclass(frozen=True)
class ColumnGroup:
    """Columns of a target that share their heights.

    Attributes:
        low: height of their lower ends over the floor, m.
        high: height of their upper ends over the floor, m.
    """

    low: float
    high: float


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
        self._hull = _outline(self.vertices[:, :2])
        self._measure_columns()
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
        scale = fine / self._label_pitch
        middle = (canvas.shape[0] - 1) / 2
        # From a sub-pixel of the canvas to a pixel of the label image.
        turn = scale * np.array([[c, s], [-s, c]])
        shift = self._label_origin - turn @ np.full(2, middle)
        labels = cv2.warpAffine(
            self._labels,
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

    def _measure_columns(self) -> None:
        flat = self.vertices[:, :2]
        pitch = self.radius / 200
        origin = np.array([203.0, 203.0])
        canvas = np.zeros((407, 407), dtype=np.uint8)
        fill_convex(
            canvas,
            facing_triangles(flat / pitch + origin, self._faces[:, ::-1]),
        )
        hull = np.zeros_like(canvas)
        fill_convex(hull, (self._hull / pitch + origin)[None])
        self.convex = canvas.sum() >= 0.99 * hull.sum()

        rows, columns = np.nonzero(canvas)
        xy = (np.stack([columns, rows], axis=1) - origin) * pitch
        mesh = trimesh.Trimesh(self.vertices, self._faces, process=False)
        # A hair off the raster, lest rays run along edges of the mesh.
        xy = xy + pitch * np.array([0.017, 0.031])
        high, found_high = _ray_heights(mesh, xy, self.thickness, up=False)
        low, found_low = _ray_heights(mesh, xy, self.thickness, up=True)
        found = found_high & found_low
        rows, columns = rows[found], columns[found]
        low, high = low[found], high[found]

        self.groups, labels = _group_columns(low, high, self.thickness)
        self.top = float(np.median(high))
        image = np.full(canvas.shape, -1, dtype=np.int16)
        image[rows, columns] = labels
        self._labels = _fill_to_nearest(image)
        self._label_pitch = pitch
        self._label_origin = origin


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


def _ray_heights(
    mesh: trimesh.Trimesh, xy: np.ndarray, thickness: float, *, up: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Returns (n,) heights first met from one side, and where any was met."""
    start = -thickness if up else 2 * thickness
    origins = np.column_stack([xy, np.full(len(xy), start)])
    directions = np.tile([0.0, 0.0, 1.0 if up else -1.0], (len(xy), 1))
    hits, rays, _ = mesh.ray.intersects_location(
        origins, directions, multiple_hits=False
    )
    heights = np.zeros(len(xy))
    found = np.zeros(len(xy), dtype=bool)
    heights[rays] = hits[:, 2]
    found[rays] = True
    return heights, found


def _group_columns(
    low: np.ndarray, high: np.ndarray, thickness: float
) -> tuple[list[ColumnGroup], np.ndarray]:
    """Sorts columns by their two heights; returns groups and (n,) labels."""
    intervals = max(1, int(np.ceil(thickness / _LEVEL_SPACING)))
    levels = np.rint(np.stack([low, high]) / thickness * intervals).astype(int)
    pairs, labels, counts = np.unique(
        levels, axis=1, return_inverse=True, return_counts=True
    )
    labels = labels.reshape(-1)
    large = np.flatnonzero(counts >= _SMALLEST_SHARE * len(low))
    if not len(large):
        large = np.array([counts.argmax()])
    distance = np.abs(pairs[:, :, None] - pairs[:, None, large]).sum(axis=0)
    labels = distance.argmin(axis=1)[labels]
    groups = [
        ColumnGroup(
            low=float(np.quantile(low[labels == k], 0.75)),
            high=float(np.quantile(high[labels == k], 0.25)),
        )
        for k in range(len(large))
    ]
    return groups, labels


def _fill_to_nearest(labels: np.ndarray) -> np.ndarray:
    """Gives each unlabelled (−1) pixel the label of a nearest labelled one."""
    _, nearest = cv2.distanceTransformWithLabels(
        (labels < 0).astype(np.uint8),
        cv2.DIST_L2,
        5,
        labelType=cv2.DIST_LABEL_PIXEL,
    )
    lookup = np.zeros(nearest.max() + 1, dtype=np.int16)
    known = labels >= 0
    lookup[nearest[known]] = labels[known]
    return lookup[nearest]
