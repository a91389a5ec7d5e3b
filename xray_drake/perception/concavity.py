"""Where a surface seen in depth is concave, or is broken off."""

import numpy as np

_DIRECTIONS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Rows and columns: four straight lines through a pixel."""


def concavity(
    depth: np.ndarray, focal_length: float, arm: int, *, across: bool = True
) -> np.ndarray:
    """Returns how far each pixel lies behind the chord over it.

    A chord joins the points that are seen ``arm`` pixels to either side; of
    the four chords over a pixel the one that it lies farthest behind counts.
    In planes, at convex edges and on the near side of a depth edge that is 0;
    in concave edges and on the far side of a depth edge it is not. Straight
    lines are straight in inverse depth, too, so planes of any tilt give 0.

    Args:
        depth: (H, W) float32 z-depth, m, above 0.
        focal_length: pixels.
        arm: pixels, at least 1.
        across: measure at right angles to the chord; else along the camera's
            axis, which lets steps in depth stand out from concave edges.

    Returns:
        (H, W) float32, m, not negative; 0 where a chord leaves the image.
    """
    height, width = depth.shape
    inverse = 1 / depth
    farthest = np.zeros_like(depth)
    for row, column in _DIRECTIONS:
        length = np.hypot(row, column)
        steps = max(1, round(arm / length))
        row, column = steps * row, steps * column
        r, c = abs(row), abs(column)
        if height <= 2 * r or width <= 2 * c:
            continue
        inside = slice(r, height - r), slice(c, width - c)
        before = inverse[
            r - row : height - r - row, c - column : width - c - column
        ]
        after = inverse[
            r + row : height - r + row, c + column : width - c + column
        ]
        z = depth[inside]
        behind = ((before + after) / 2 - inverse[inside]) * z * z
        if across:
            # Depth gained along the chord for each metre across the view.
            scale = np.float32(focal_length / (2 * steps * length))
            slope = (before - after) * z * scale
            behind /= np.sqrt(1 + slope * slope)
        np.maximum(farthest[inside], behind, out=farthest[inside])
    return farthest
