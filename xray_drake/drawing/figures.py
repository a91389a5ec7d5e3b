"""Figures: pictures side by side, with titles and outlines."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from matplotlib.figure import Figure

SEEN, WHOLE = "#ff00b4", "#ffffff"
"""Colours of outlines: of what is seen or chosen, of the whole target."""

_LINE = 0.22
"""Height of a line of a title, inches."""


@dataclass(frozen=True, eq=False)
class Panel:
    """A picture of a figure.

    Attributes:
        image: (H, W, 3) uint8 RGB.
        title: over it, in one line or more.
        outlines: colour to the (H, W) bool mask that is outlined so; a mask
            that is blank or full has no outline.
    """

    image: np.ndarray
    title: str = ""
    outlines: dict[str, np.ndarray] = field(default_factory=dict)


def panel_figure(
    panels: Sequence[Panel], columns: int, *, width: float = 4.07
) -> Figure:
    """Draws pictures of one size in the order of reading.

    Args:
        panels: at least one.
        columns: pictures in a row.
        width: of a picture, inches.

    Returns:
        A figure that belongs to no window; ``figure.savefig`` writes it.

    Raises:
        ValueError: there are no pictures.
    """
    if not panels:
        raise ValueError("a figure needs at least one picture")
    lines = 1 + max(panel.title.count("\n") for panel in panels)
    height = width * np.divide(*panels[0].image.shape[:2]) + lines * _LINE
    rows = -(-len(panels) // columns)
    figure = plain_figure(width * columns, float(height) * rows, dpi=80)
    axes = list(figure.subplots(rows, columns, squeeze=False).flat)
    for axis in axes:
        axis.set_axis_off()
    for axis, panel in zip(axes, panels, strict=False):
        axis.imshow(panel.image, interpolation="nearest")
        axis.set_title(
            panel.title,
            fontsize=8,
            loc="left",
            parse_math=False,
        )
        for color, mask in panel.outlines.items():
            if mask.any() and not mask.all():
                axis.contour(mask, levels=[0.5], colors=color, linewidths=1.2)
    return figure


def plain_figure(width: float, height: float, *, dpi: int = 110) -> Figure:
    """Returns an empty figure that belongs to no window.

    Args:
        width: inches.
        height: inches.
        dpi: pixels per inch.
    """
    return Figure(figsize=(width, height), dpi=dpi, layout="constrained")
