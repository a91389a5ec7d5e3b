"""Fewer convex pieces, of fewer vertices each."""

import manifold3d
import numpy as np
from scipy.spatial import ConvexHull

MOST_GROWTH = 1.2
"""A simplified piece grows about its centroid by at most this factor."""

EXACT_ENOUGH = 0.95
"""Of a hull's volume: a choice of vertices that keeps it is not improved."""

_SLIVER = 1e-6
"""Share of its volume that a piece must lose without any of its vertices."""

_MOST_PASSES = 2
_TRIALS = 4


def hull_volume(points: np.ndarray) -> float:
    """Returns the volume of the convex hull of (n, 3) points; 0 if flat."""
    made = manifold3d.Manifold.hull_points(np.asarray(points, np.float64))
    return float(made.volume())


def hull_vertices(points: np.ndarray) -> np.ndarray:
    """Returns those of (n, 3) points that are vertices of their hull.

    Raises:
        scipy.spatial.QhullError: they lie in a plane.
    """
    return points[ConvexHull(points).vertices]


def without_slivers(points: np.ndarray) -> np.ndarray:
    """Leaves out hull vertices that lie on a side between others, nearly.

    A face that they make has no area to speak of, and Drake cannot make a
    compliant body of a piece that has one.

    Args:
        points: (n, 3) vertices of a hull, m.

    Returns:
        (m, 3) of them, at least 4; the hull of the others has less volume by
        :data:`_SLIVER` or more without any of them.
    """
    whole = hull_volume(points)
    while len(points) > 4:
        without = [
            hull_volume(np.delete(points, index, axis=0))
            for index in range(len(points))
        ]
        least = int(np.argmax(without))
        if without[least] < (1 - _SLIVER) * whole:
            break
        points = np.delete(points, least, axis=0)
    return points


def merged_pieces(pieces: list[np.ndarray], count: int) -> list[np.ndarray]:
    """Joins convex pieces until few are left.

    Each time, the pair is replaced by its common hull that encloses the least
    volume beyond that of the two.

    Args:
        pieces: (n, 3) vertices each.
        count: how many may be left, at least 1.

    Returns:
        At most ``count`` pieces, (m, 3) hull vertices each; each of the given
        pieces lies in one of them.
    """
    left = {index: piece for index, piece in enumerate(pieces)}
    volumes = {index: hull_volume(piece) for index, piece in left.items()}
    added: dict[tuple[int, int], float] = {}
    fresh = list(left)
    while len(left) > count:
        for j in fresh:
            for i in left:
                if i != j and (j, i) not in added:
                    joint = hull_volume(np.concatenate([left[i], left[j]]))
                    added[i, j] = joint - volumes[i] - volumes[j]
        i, j = min(added, key=added.__getitem__)
        new = max(left) + 1
        left[new] = hull_vertices(np.concatenate([left.pop(i), left.pop(j)]))
        volumes[new] = hull_volume(left[new])
        added = {
            pair: value
            for pair, value in added.items()
            if not {i, j} & set(pair)
        }
        fresh = [new]
    return list(left.values())


def simplified_hull(points: np.ndarray, count: int) -> np.ndarray:
    """Chooses points whose convex hull comes close to that of all.

    Four points far apart begin; each next one is the farthest outside the hull
    of those chosen. (Farthest from the chosen *points* would be the simpler
    rule, but keeps less of the volume.) Then points change places with others
    while that wins volume.

    Args:
        points: (n, 3), not in a plane.
        count: how many to choose, at least 4.

    Returns:
        (m, 3) of ``points``, m ≤ ``count``, all vertices of their hull.
    """
    chosen = _far_apart(points, 4)
    while len(chosen) < count:
        planes = ConvexHull(chosen, qhull_options="QJ").equations
        outside = (points @ planes[:, :3].T + planes[:, 3]).max(axis=1)
        index = int(np.argmax(outside))
        if outside[index] < 1e-6:
            break
        chosen = np.vstack([chosen, points[index]])
    if len(chosen) > 4 and hull_volume(chosen) < EXACT_ENOUGH * hull_volume(
        points
    ):
        chosen = _exchanged(points, chosen)
    return hull_vertices(chosen)


def _exchanged(points: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Swaps chosen points for ones that enclose more with the others."""
    volume = hull_volume(chosen)
    for _ in range(_MOST_PASSES):
        before = volume
        for index in range(len(chosen)):
            others = np.delete(chosen, index, axis=0)
            planes = ConvexHull(others, qhull_options="QJ").equations
            outside = (points @ planes[:, :3].T + planes[:, 3]).max(axis=1)
            trials = [
                np.vstack([others, points[k]])
                for k in np.argsort(-outside, kind="stable")[:_TRIALS]
            ]
            volumes = [hull_volume(trial) for trial in trials]
            best = int(np.argmax(volumes))
            if volumes[best] > volume:
                chosen, volume = trials[best], volumes[best]
        if volume < 1.005 * before:
            break
    return chosen


def grown_to(vertices: np.ndarray, volume: float) -> np.ndarray:
    """Scales a convex piece about its centroid towards a volume.

    Args:
        vertices: (n, 3) of the piece.
        volume: m³, at least that of the piece.

    Returns:
        (n, 3) vertices; the factor is at most ``MOST_GROWTH``, so no vertex
        moves by more than 20 % of its distance from the centroid.
    """
    hull = ConvexHull(vertices)
    a, b, c = np.moveaxis(vertices[hull.simplices], 1, 0)
    apex = vertices.mean(axis=0)
    weights = np.abs(
        np.einsum("ij,ij->i", a - apex, np.cross(b - apex, c - apex))
    )
    centers = (a + b + c + apex) / 4
    centroid = weights @ centers / weights.sum()
    factor = min((volume / hull.volume) ** (1 / 3), MOST_GROWTH)
    return centroid + max(factor, 1.0) * (vertices - centroid)


def _far_apart(points: np.ndarray, count: int) -> np.ndarray:
    """Chooses the farthest from the mean, then the farthest from those."""
    first = np.linalg.norm(points - points.mean(axis=0), axis=1)
    chosen = [int(np.argmax(first))]
    distance = np.full(len(points), np.inf)
    while len(chosen) < count:
        step = np.linalg.norm(points - points[chosen[-1]], axis=1)
        distance = np.minimum(distance, step)
        chosen.append(int(np.argmax(distance)))
    return points[chosen]
