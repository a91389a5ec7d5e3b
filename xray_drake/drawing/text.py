"""Text as triangles, for viewers that know no text."""

import manifold3d
import numpy as np

_SIZE = 30.0
"""Of the letters when their curves become polygons: a unit is fine enough."""

_SHARE = 0.8
"""Size of the letters as a share of a line's height."""


def text_mesh(
    lines: tuple[str, ...], height: float
) -> tuple[np.ndarray, np.ndarray]:
    """Returns text as triangles in the plane z = 0, to be read from above.

    Args:
        lines: one below the other.
        height: of a line, m.

    Returns:
        (3, n) vertices, m, x along the line, y up, the lower left corner of
        the text at the origin; (3, m) triangles; both with no columns where
        there is no ink.
    """
    # Takes long to import, and who draws a heap may need no text.
    from matplotlib.textpath import TextPath

    polygons = []
    for row, line in enumerate(reversed(lines)):
        baseline = (row + 1 - _SHARE) * _SIZE / _SHARE
        if line.strip():
            text = line.replace("$", r"\$")
            polygons += TextPath((0, baseline), text, size=_SIZE).to_polygons()
    # What lies in an even number of them is a hole.
    ink = manifold3d.CrossSection(polygons, manifold3d.FillRule.EvenOdd)
    outlines = ink.to_polygons()
    if not outlines:
        return np.zeros((3, 0)), np.zeros((3, 0), np.int32)
    corners = np.concatenate(outlines) * (height * _SHARE / _SIZE)
    vertices = np.pad(corners, ((0, 0), (0, 1))).T
    return vertices, manifold3d.triangulate(outlines).T.astype(np.int32)
