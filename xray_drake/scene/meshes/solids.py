"""Closed meshes as Manifold's solids, for exact volumes of what differs."""

from collections.abc import Iterable

import manifold3d
import numpy as np
import trimesh
from scipy.spatial import ConvexHull

SMALLEST_PIECE = 1e-12
"""m³. Smaller pieces, of a tenth of a millimetre, are left out."""


def solid(mesh: trimesh.Trimesh) -> manifold3d.Manifold:
    """Returns a mesh as a solid.

    Raises:
        ValueError: it is not closed.
    """
    made = manifold3d.Manifold(
        manifold3d.Mesh64(
            np.array(mesh.vertices, dtype=np.float64, order="C"),
            np.array(mesh.faces, dtype=np.uint64, order="C"),
        )
    )
    if made.status() != manifold3d.Error.NoError or made.is_empty():
        raise ValueError("it is not closed")
    return made


def surface(made: manifold3d.Manifold) -> trimesh.Trimesh:
    """Returns the mesh of a solid."""
    mesh = made.to_mesh64()
    return trimesh.Trimesh(
        np.asarray(mesh.vert_properties[:, :3], dtype=float),
        np.asarray(mesh.tri_verts, dtype=np.int64),
        process=False,
    )


def joined(solids: Iterable[manifold3d.Manifold]) -> manifold3d.Manifold:
    """Returns the union of solids."""
    return manifold3d.Manifold.batch_boolean(
        list(solids), manifold3d.OpType.Add
    )


def union(pieces: Iterable[np.ndarray]) -> manifold3d.Manifold:
    """Returns the union of convex pieces, (n, 3) vertices each."""
    return joined(
        manifold3d.Manifold.hull_points(np.asarray(piece, np.float64))
        for piece in pieces
    )


def parts(made: manifold3d.Manifold) -> list[np.ndarray]:
    """Returns the (n, 3) hull vertices, m, of each part that has a volume."""
    hulls = []
    for part in made.decompose():
        if part.hull().volume() > SMALLEST_PIECE:
            points = np.asarray(part.to_mesh().vert_properties[:, :3], float)
            hulls.append(
                points[ConvexHull(points, qhull_options="QJ").vertices]
            )
    return hulls
