"""What a mesh file says, whatever its format."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import manifold3d
import numpy as np
import trimesh

_CONCAVE = 1e-6
"""A corner that turns back by more than this share of the area is concave."""


@dataclass(frozen=True, eq=False)
class FileMesh:
    """The triangles and the look of a file, in the file's unit.

    Attributes:
        vertices: (n, 3) float64.
        triangles: (m, 3) indices of vertices; polygons are triangulated.
        groups: (m,) to which object, group or node each triangle belongs.
        visual: the same surface with texture coordinates and an image, where
            the file has them.
        color: (3,) red, green, blue in [0, 1], the mean over the surface; (0,)
            where the file names none.
        notes: one short sentence on each thing that could not be used.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    groups: np.ndarray
    visual: trimesh.Trimesh | None = None
    color: np.ndarray = field(default_factory=lambda: np.zeros(0))
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Triangulation:
    """Triangles of polygons.

    Attributes:
        corners: (m, 3) positions in the polygons' list of corners.
        owners: (m,) the polygon of each triangle.
    """

    corners: np.ndarray
    owners: np.ndarray


def triangulate(
    points: np.ndarray, sizes: Sequence[int] | np.ndarray
) -> Triangulation:
    """Triangulates polygons in space, concave ones too.

    No corner is left out, also where three lie on a line, so that neighbours
    stay joined. Polygons of fewer than three corners have no triangles.

    Args:
        points: (k, 3) corners of all polygons, one polygon after the other.
        sizes: corners of each polygon; their sum is k.
    """
    counts = np.asarray(sizes, dtype=np.int64)
    starts = np.cumsum(counts) - counts
    corners = [np.zeros((0, 3), np.int64)]
    owners = [np.zeros(0, np.int64)]
    for size in np.unique(counts[counts >= 3]):
        polygons = np.flatnonzero(counts == size)
        indices = starts[polygons][:, None] + np.arange(size)
        shapes = points[indices]
        with np.errstate(invalid="ignore", over="ignore"):
            normals, concave = _orientation(shapes)
        k = np.arange(1, size - 1)
        fan = np.stack([np.zeros_like(k), k, k + 1], axis=1)
        corners.append(indices[~concave][:, fan].reshape(-1, 3))
        owners.append(np.repeat(polygons[~concave], size - 2))
        for index in np.flatnonzero(concave):
            triangles = _ear_clipped(shapes[index], normals[index])
            corners.append(indices[index][triangles])
            owners.append(np.full(len(triangles), polygons[index]))
    order = np.argsort(np.concatenate(owners), kind="stable")
    return Triangulation(
        np.concatenate(corners)[order], np.concatenate(owners)[order]
    )


def mean_over_surface(
    vertices: np.ndarray, triangles: np.ndarray, colors: np.ndarray | None
) -> np.ndarray:
    """Returns the (3,) mean of (m, 3) colours of triangles by area.

    (0,) where there are none.
    """
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    with np.errstate(invalid="ignore", over="ignore"):
        areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    if colors is None or not np.isfinite(areas).all() or areas.sum() == 0:
        return np.zeros(0)
    return np.average(colors, axis=0, weights=areas)


def in_one(parts: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    """Puts textured surfaces together, their images into one."""
    if len(parts) == 1:
        return parts[0]
    whole = trimesh.util.concatenate(parts)
    assert isinstance(whole, trimesh.Trimesh)
    return whole


def unit_colors(colors: np.ndarray) -> np.ndarray:
    """Returns colours in [0, 1]; what exceeds 1 counts in 255ths."""
    finite = np.nan_to_num(np.asarray(colors, dtype=float))
    scale = 255 if finite.max(initial=0) > 1 else 1
    return np.clip(finite / scale, 0, 1)


def _orientation(shapes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns (g, 3) normals of (g, n, 3) polygons, and which are concave."""
    around = shapes - shapes[:, :1]
    ahead = np.roll(around, -1, axis=1)
    normals = np.cross(around, ahead).sum(axis=1)
    if shapes.shape[1] == 3:
        return normals, np.zeros(len(shapes), dtype=bool)
    edges = ahead - around
    turns = np.cross(edges, np.roll(edges, -1, axis=1))
    along = np.einsum("gni,gi->gn", turns, normals)
    limit = -_CONCAVE * np.einsum("gi,gi->g", normals, normals)
    return normals, (along < limit[:, None]).any(axis=1)


def _ear_clipped(polygon: np.ndarray, normal: np.ndarray) -> np.ndarray:
    helper = np.eye(3)[int(np.argmin(np.abs(normal)))]
    x = np.cross(helper, normal)
    x /= np.linalg.norm(x)
    y = np.cross(normal, x) / np.linalg.norm(normal)
    flat = np.ascontiguousarray((polygon - polygon[0]) @ np.stack([x, y]).T)
    return np.asarray(manifold3d.triangulate([flat]), dtype=np.int64)
