"""Convex pieces, given by their vertices."""

import numpy as np
from scipy.spatial import ConvexHull


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
