"""How far a gripper stays from a cloud of points, for many poses at once."""

import numpy as np

_CHUNK = 64


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
    result = np.empty(n)
    for start in range(0, n, _CHUNK):
        part = slice(start, start + _CHUNK)
        p_B = p_W @ R[part] - t[part, None].astype(np.float32)
        outside = np.full(p_B.shape[:2], np.inf, np.float32)
        for i in range(k):
            d = np.abs(p_B - center[part, None, i].astype(np.float32))
            h = half[part, None, i].astype(np.float32)
            if round_[i]:
                radial = np.hypot(d[..., 1], d[..., 2]) - h[..., 1]
                gap = np.maximum(d[..., 0] - h[..., 0], radial)
            else:
                gap = (d - h).max(axis=-1)
            np.minimum(outside, gap, out=outside)
        result[part] = outside.min(axis=1)
    return result
