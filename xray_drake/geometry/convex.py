"""Convex pieces, given by their vertices."""

from itertools import product

import numpy as np
from scipy.spatial import ConvexHull

_DIGITS = 9
"""Planes of triangles that lie in one face differ less."""

CUBE_AXES = np.array(list(product((-1, 0, 1), repeat=3)))[14:]
CUBE_AXES = CUBE_AXES / np.linalg.norm(CUBE_AXES, axis=1, keepdims=True)
"""(13, 3) axes of a cube through faces, edges and corners; the first is z."""


def hull_planes(vertices: np.ndarray) -> np.ndarray:
    """Returns the planes of a convex hull's faces, each once.

    Args:
        vertices: (n, 3), m.

    Returns:
        (k, 4) rows a, b, c, d, with (a, b, c) of length 1; inside,
        a·x + b·y + c·z + d ≤ 0.

    Raises:
        scipy.spatial.QhullError: the vertices span no volume.
    """
    return np.unique(ConvexHull(vertices).equations.round(_DIGITS), axis=0)


def half_thickness(vertices: np.ndarray) -> float:
    """Returns half the least distance of two planes that hold a piece, m.

    The least is taken over the normals of the faces, which is exact where a
    face is opposite a vertex (the usual case) and an upper bound else.

    Args:
        vertices: (n, 3) vertices of a convex hull, m.

    Raises:
        scipy.spatial.QhullError: the vertices span no volume.
    """
    normals = ConvexHull(vertices).equations[:, :3]
    along = vertices @ normals.T
    return float(np.ptp(along, axis=0).min() / 2)
