"""Heights of a mesh's surface as seen from one side, compiled.

Numba keeps what it compiles beside this file, or in the user's cache where
that is read-only, so that only the first process pays.
"""

import numpy as np

from xray_drake.kernels import kernel


@kernel()
def draw_nearest(
    points: np.ndarray,
    nearness: np.ndarray,
    faces: np.ndarray,
    canvas: np.ndarray,
) -> None:
    """Draws a closed mesh's nearest surface: a pixel is in if its centre is.

    Args:
        points: (n, 2) projected vertices, pixels; x right and y down as the
            viewer sees it, pixel centres at integers.
        nearness: (n,) what is interpolated over each triangle and is larger
            the nearer the viewer: the height from above, or the reciprocal of
            the depth in perspective.
        faces: (m, 3) indices of outward-facing triangles.
        canvas: (h, w) float32, raised in place.
    """
    height, width = canvas.shape
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay = points[a, 0], points[a, 1]
        bx, by = points[b, 0] - ax, points[b, 1] - ay
        cx, cy = points[c, 0] - ax, points[c, 1] - ay
        area = bx * cy - by * cx
        if area >= 0.0:  # Turned away; behind a triangle that is not.
            continue
        nb, nc = nearness[b] - nearness[a], nearness[c] - nearness[a]
        across = (nb * cy - nc * by) / area
        down = (nc * bx - nb * cx) / area
        top = max(int(np.ceil(ay + min(0.0, by, cy))), 0)
        bottom = min(int(np.floor(ay + max(0.0, by, cy))), height - 1)
        for v in range(top, bottom + 1):
            y = v - ay
            low, high = np.inf, -np.inf
            # Where the row crosses each of the three sides.
            for side in range(3):
                if side == 0:
                    px, py, qx, qy = 0.0, 0.0, bx, by
                elif side == 1:
                    px, py, qx, qy = bx, by, cx, cy
                else:
                    px, py, qx, qy = cx, cy, 0.0, 0.0
                if py == qy:
                    if py == y:
                        low = min(low, px, qx)
                        high = max(high, px, qx)
                elif min(py, qy) <= y <= max(py, qy):
                    x = px + (qx - px) * (y - py) / (qy - py)
                    low = min(low, x)
                    high = max(high, x)
            first = max(int(np.ceil(ax + low)), 0) if high >= low else 0
            last = min(int(np.floor(ax + high)), width - 1)
            if high < low:
                last = -1
            value = nearness[a] + across * (first - ax) + down * y
            for u in range(first, last + 1):
                if value > canvas[v, u]:
                    canvas[v, u] = value
                value += across


def height_map(
    vertices: np.ndarray, faces: np.ndarray, pitch: float, reach: int
) -> np.ndarray:
    """Returns the heights of a mesh as seen from straight above.

    Args:
        vertices: (n, 3), m; z from the floor.
        faces: (m, 3) indices of outward-facing triangles.
        pitch: of the map, m.
        reach: half its width in cells; x = y = 0 is in its middle cell.

    Returns:
        (2·reach + 1)² float32, m; 0 beside the mesh. Rows along −y.
    """
    side = 2 * reach + 1
    canvas = np.zeros((side, side), dtype=np.float32)
    points = np.column_stack([vertices[:, 0], -vertices[:, 1]]) / pitch + reach
    draw_nearest(
        np.ascontiguousarray(points),
        np.ascontiguousarray(vertices[:, 2]),
        np.ascontiguousarray(faces, dtype=np.int64),
        canvas,
    )
    return canvas
