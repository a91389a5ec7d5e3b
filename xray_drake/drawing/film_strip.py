"""A search as a strip of pictures, one for each decision."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from xray_drake.drawing.colors import overlay

_OUTLINE = "#ff00b4"
_MOST_COLUMNS = 4
_WIDTH = 3.0
"""Of a frame, inches."""
_CAPTION = 0.45
"""Height of the two lines over a frame, inches."""


@dataclass(frozen=True, eq=False)
class Frame:
    """What is seen and decided at one moment.

    Attributes:
        color: (H, W, 3) uint8 RGB.
        occupancy: (H, W) in [0, 1]; where 0, the picture is left as it is.
        chosen: (H, W) bool mask of what is grasped next; blank for nothing.
        title, note: two lines over the picture.
    """

    color: np.ndarray
    occupancy: np.ndarray
    chosen: np.ndarray
    title: str
    note: str = ""


def film_strip_figure(frames: Sequence[Frame]) -> Figure:
    """Draws frames in the order of reading.

    Each is the colour image with the distribution over it, dark violet to
    yellow, and the outline of what is grasped next (magenta).

    Args:
        frames: at least one, all of one size.

    Returns:
        A figure that belongs to no window; ``figure.savefig`` writes it.

    Raises:
        ValueError: there are no frames.
    """
    if not frames:
        raise ValueError("a film strip needs at least one frame")
    height, width = frames[0].occupancy.shape
    columns = min(len(frames), _MOST_COLUMNS)
    rows = -(-len(frames) // columns)
    figure = Figure(
        figsize=(
            _WIDTH * columns,
            (_WIDTH * height / width + _CAPTION) * rows,
        ),
        dpi=80,
        layout="constrained",
    )
    FigureCanvasAgg(figure)
    panels = list(figure.subplots(rows, columns, squeeze=False).flat)
    for panel in panels:
        panel.set_axis_off()
    for panel, frame in zip(panels, frames, strict=False):
        panel.imshow(
            overlay(frame.color, frame.occupancy), interpolation="nearest"
        )
        if frame.chosen.any() and not frame.chosen.all():
            panel.contour(
                frame.chosen, levels=[0.5], colors=_OUTLINE, linewidths=1.5
            )
        panel.set_title(
            f"{frame.title}\n{frame.note}",
            fontsize=8,
            loc="left",
            parse_math=False,
        )
    return figure
