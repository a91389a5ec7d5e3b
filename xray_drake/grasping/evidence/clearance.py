"""How far a gripper stays from a cloud of points, for many poses at once."""

import numpy as np

_CHUNK = 32
"""Poses computed at once, few enough to stay in the processor's cache."""


def clearance(
    points_W: np.ndarray,
    X_WB: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    round_: np.ndarray,
) -> np.ndarray:
    """Returns how much boxes could grow before a point is inside one.

    A box grows in all directions alike. Negative where a point is inside: how
    much the box would have to shrink. That no point is inside is necessary
    for being free of collision, not sufficient; it is much cheaper to find.

    Args:
        points_W: (m, 3) points on surfaces, in the world, m.
        X_WB: (n, 4, 4) poses of the frame B of the boxes.
        lower: (n, k, 3) or (k, 3) lower corners in B, m.
        upper: the same of upper corners.
        round_: (k,) whether the box stands for the cylinder along x in it.

    Returns:
        (n,) array, m; inf where there are no points.
    """
    n = len(X_WB)
    if len(points_W) == 0 or n == 0:
        return np.full(n, np.inf)
    k = lower.shape[-2]
    center = np.broadcast_to(0.5 * (lower + upper), (n, k, 3))
    half = np.broadcast_to(0.5 * (upper - lower), (n, k, 3))
    p_W = points_W.astype(np.float32)
    R = X_WB[:, :3, :3].astype(np.float32)
    t = np.einsum("ni,nij->nj", X_WB[:, :3, 3], X_WB[:, :3, :3])
    center = (center + t[:, None]).astype(np.float32)
    half = half.astype(np.float32)
    result = np.empty(n)
    for start in range(0, n, _CHUNK):
        part = slice(start, start + _CHUNK)
        along = [R[part, :, axis] @ p_W.T for axis in range(3)]
        nearest = np.full(along[0].shape, np.inf, np.float32)
        for i in range(k):
            x, y, z = (
                np.abs(along[axis] - center[part, i, axis, None])
                for axis in range(3)
            )
            x -= half[part, i, 0, None]
            if round_[i]:
                side = np.hypot(y, z) - half[part, i, 1, None]
            else:
                y -= half[part, i, 1, None]
                z -= half[part, i, 2, None]
                side = np.maximum(y, z, out=y)
            np.minimum(nearest, np.maximum(x, side, out=x), out=nearest)
        result[part] = nearest.min(axis=1)
    return result
