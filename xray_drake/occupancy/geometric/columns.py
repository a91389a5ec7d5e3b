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

from xray_drake.geometry.convex import hull_planes
from xray_drake.geometry.readings import nearest_values

_LEVEL_SPACING = 0.008
"""Heights are sorted into levels at most this far apart, m."""

_SMALLEST_SHARE = 0.08
"""Groups of a smaller share of the silhouette join their nearest."""

_LEAN = 0.4
"""Steepest slope from the vertical under which a target is seen."""


@dataclass(frozen=True)
class ColumnGroup:
    """Columns of a target that share their heights.

    Attributes:
        low: lowest height over the floor at which they matter, m.
        high: highest height at which they do, m.
        top: height of their upper ends, m.
    """

    low: float
    high: float
    top: float


@dataclass(frozen=True)
class Columns:
    """A target's silhouette from above, sorted into groups of columns.

    Attributes:
        groups: the groups.
        top: median height of what is seen from above, m.
        labels: (h, w) int16 image: the group of each pixel; beyond the
            silhouette, that of the nearest pixel within.
        pitch: of the image, m.
        origin: (2,) column and row of the body's origin.
    """

    groups: list[ColumnGroup]
    top: float
    labels: np.ndarray
    pitch: float
    origin: np.ndarray


def measure_columns(
    mesh: trimesh.Trimesh,
    silhouette: np.ndarray,
    pitch: float,
    origin: np.ndarray,
) -> Columns:
    """Measures the columns of a mesh that lies on the floor.

    Args:
        mesh: closed, z from the floor, m.
        silhouette: (h, w) uint8 image of it from above, rows along y.
        pitch: of that image, m.
        origin: (2,) column and row of x = y = 0.
    """
    rows, columns = np.nonzero(silhouette)
    # A hair off the raster, lest rays run along edges of the mesh.
    offset = origin - np.array([0.017, 0.031])
    xy = (np.stack([columns, rows], axis=1) - offset) * pitch
    thickness = float(mesh.bounds[1, 2])
    if mesh.is_convex:
        low, high, found = _convex_heights(mesh, xy)
    else:
        high, found_high = _ray_heights(mesh, xy, thickness, up=False)
        low, found_low = _ray_heights(mesh, xy, thickness, up=True)
        found = found_high & found_low
    rows, columns = rows[found], columns[found]
    low, high = low[found], high[found]

    nearest, distance = _nearest_edge(silhouette, rows, columns)
    lowest, highest = _outline_heights(low, high, nearest, distance * pitch)
    groups, labels = _group_columns(lowest, highest, high, thickness)
    image = np.full(silhouette.shape, -1, dtype=np.int16)
    image[rows, columns] = labels
    image, _ = nearest_values(image, image >= 0)
    return Columns(groups, float(np.median(high)), image, pitch, origin)


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


def _convex_heights(
    mesh: trimesh.Trimesh, xy: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns (n,) lower and upper ends of columns, and which there are."""
    lowest = np.full(len(xy), -np.inf)
    highest = np.full(len(xy), np.inf)
    found = np.ones(len(xy), dtype=bool)
    for a, b, c, d in hull_planes(mesh.vertices).tolist():
        rest = xy @ [a, b] + d
        if c > 0:
            np.minimum(highest, -rest / c, out=highest)
        elif c < 0:
            np.maximum(lowest, -rest / c, out=lowest)
        else:
            found &= rest <= 0
    return lowest, highest, found & (lowest <= highest)


def _nearest_edge(
    canvas: np.ndarray, rows: np.ndarray, columns: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Finds the pixel of the silhouette's edge nearest to each of its pixels.

    Args:
        canvas: (h, w) uint8 silhouette.
        rows: (n,) rows of the pixels asked about.
        columns: (n,) their columns.

    Returns:
        (n,) index, among those, of the nearest that is on the edge, and the
        distance to it in pixels.
    """
    index = np.full(canvas.shape, -1)
    index[rows, columns] = np.arange(len(rows))
    inner = cv2.erode(canvas, np.ones((3, 3), np.uint8))
    nearest, distance = nearest_values(index, (inner == 0) & (index >= 0))
    return nearest[rows, columns], distance[rows, columns]


def _outline_heights(
    low: np.ndarray,
    high: np.ndarray,
    nearest: np.ndarray,
    distance: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Narrows columns to the heights that matter for the outline.

    Seen from aside, a column in the middle of a tube leans over its neighbours
    but not over the tube's outline: only the heights there matter. Columns
    whose ends lean farther than the outline keep them.

    Args:
        low: (n,) lower ends, m.
        high: (n,) upper ends, m.
        nearest: (n,) index of the nearest column of the outline.
        distance: (n,) to that one, m.

    Returns:
        (n,) lowest and (n,) highest heights that matter, m.
    """
    covered_high = (high - high[nearest]) * _LEAN < distance
    covered_low = (low[nearest] - low) * _LEAN < distance
    new_high = np.where(covered_high, np.minimum(high, high[nearest]), high)
    new_low = np.where(covered_low, np.maximum(low, low[nearest]), low)
    return np.minimum(new_low, new_high), new_high


def _group_columns(
    low: np.ndarray, high: np.ndarray, top: np.ndarray, thickness: float
) -> tuple[list[ColumnGroup], np.ndarray]:
    """Sorts columns by their two heights; returns groups and (n,) labels."""
    intervals = max(1, int(np.ceil(thickness / _LEVEL_SPACING)))
    levels = np.rint(np.stack([low, high]) / thickness * intervals).astype(int)
    # Sorting pairs as single numbers is several times as fast.
    codes, labels, counts = np.unique(
        levels[0] * (intervals + 2) + levels[1],
        return_inverse=True,
        return_counts=True,
    )
    pairs = np.stack(np.divmod(codes, intervals + 2))
    large = np.flatnonzero(counts >= _SMALLEST_SHARE * len(low))
    if not len(large):
        large = np.array([counts.argmax()])
    distance = np.abs(pairs[:, :, None] - pairs[:, None, large]).sum(axis=0)
    labels = distance.argmin(axis=1)[labels]
    groups = [
        ColumnGroup(
            low=float(np.median(low[labels == k])),
            high=float(np.median(high[labels == k])),
            top=float(np.median(top[labels == k])),
        )
        for k in range(len(large))
    ]
    return groups, labels
