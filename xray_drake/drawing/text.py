"""Text as triangles, for viewers that know no text."""

from functools import cache

import numpy as np
from PIL import Image, ImageDraw, ImageFont

_FONT = "DejaVu Sans"
"""Comes with matplotlib."""

_PIXELS = 36
"""Height of a line in the picture that the triangles are made of."""


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
    ink = text_picture(lines)
    boxes = _boxes(ink)
    scale = height / _PIXELS
    left, top, right, bottom = boxes.T * scale
    top, bottom = ink.shape[0] * scale - top, ink.shape[0] * scale - bottom
    corners = np.array(
        [[left, bottom], [right, bottom], [right, top], [left, top]]
    )  # corner, axis, box
    flat = corners.transpose(2, 0, 1).reshape(-1, 2)
    vertices = np.column_stack([flat, np.zeros(len(flat))]).T
    first = 4 * np.arange(len(boxes), dtype=np.int32)
    faces = np.concatenate(
        [
            np.stack([first, first + 1, first + 2]),
            np.stack([first, first + 2, first + 3]),
        ],
        axis=1,
    )
    return vertices, faces.astype(np.int32)


def text_picture(lines: tuple[str, ...]) -> np.ndarray:
    """Returns (H, W) bool, True where there is ink, 36 rows a line."""
    font = _font()
    width = max((int(font.getlength(line)) for line in lines), default=0) + 2
    image = Image.new("L", (width, _PIXELS * max(len(lines), 1)))
    draw = ImageDraw.Draw(image)
    for row, line in enumerate(lines):
        draw.text((1, row * _PIXELS), line, fill=255, font=font)
    return np.asarray(image) > 127


@cache
def _font() -> ImageFont.FreeTypeFont:
    # Takes long to import, and who draws a heap may need no text.
    from matplotlib.font_manager import findfont

    return ImageFont.truetype(findfont(_FONT), int(_PIXELS * 0.8))


def _boxes(ink: np.ndarray) -> np.ndarray:
    """Covers ink by boxes: (n, 4) left, top, right, bottom, pixels."""
    done: list[tuple[int, int, int, int]] = []
    open_: dict[tuple[int, int], int] = {}
    padded = np.pad(ink, ((0, 1), (1, 1))).astype(np.int8)
    for row, change in enumerate(np.diff(padded, axis=1)):
        starts, ends = np.flatnonzero(change > 0), np.flatnonzero(change < 0)
        runs = set(zip(starts.tolist(), ends.tolist(), strict=True))
        for run in [run for run in open_ if run not in runs]:
            done.append((run[0], open_.pop(run), run[1], row))
        for run in runs:
            open_.setdefault(run, row)
    return np.array(sorted(done), float).reshape(-1, 4)
