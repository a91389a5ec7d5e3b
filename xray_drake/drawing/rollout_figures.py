"""What many rollouts took, as figures."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter

from xray_drake.drawing.figures import plain_figure

_MOST_COLUMNS = 4
_MARKERS = "osD^vP*Xh"


def actions_figure(
    actions: Mapping[str, Sequence[int]],
    rollouts: Mapping[str, int],
    *,
    horizon: int,
) -> Figure:
    """Draws histograms of the number of actions, as the paper's Figure 6.

    A panel each policy; a dashed line stands at the median.

    Args:
        actions: policy to the numbers of actions of its successes.
        rollouts: policy to how many rollouts it had.
        horizon: actions at most.

    Returns:
        A figure that belongs to no window; ``figure.savefig`` writes it.

    Raises:
        ValueError: there are no policies.
    """
    if not actions:
        raise ValueError("a figure needs at least one policy")
    columns = min(len(actions), _MOST_COLUMNS)
    rows = -(-len(actions) // columns)
    figure = plain_figure(3.2 * columns, 2.6 * rows)
    grid = figure.subplots(
        rows, columns, sharex=True, sharey=True, squeeze=False
    )
    panels = list(grid.flat)
    for panel in panels[len(actions) :]:
        panel.set_axis_off()
    bins = np.arange(0.5, horizon + 1)
    for (name, numbers), color, panel in zip(
        actions.items(), _colors(len(actions)), panels, strict=False
    ):
        panel.hist(
            numbers, bins=bins, color=color, edgecolor="white", linewidth=0.6
        )
        note = f"{len(numbers)} of {rollouts[name]}"
        if numbers:
            median = float(np.median(numbers))
            panel.axvline(median, color="black", linestyle="--", linewidth=1)
            note += f", median {median:g}"
        panel.set_title(
            f"{name}\n{note}", fontsize=9, loc="left", parse_math=False
        )
        panel.xaxis.set_major_locator(MaxNLocator(integer=True))
        panel.yaxis.set_major_locator(MaxNLocator(integer=True))
        panel.tick_params(labelbottom=True)
        _plain(panel)
    figure.supxlabel("actions until the target was out", fontsize=10)
    figure.supylabel("rollouts", fontsize=10)
    return figure


def success_figure(rates: Mapping[str, Sequence[float]]) -> Figure:
    """Draws the share of successes within k actions against k.

    Args:
        rates: policy to its shares within 1, 2, … actions.

    Returns:
        A figure as of :func:`actions_figure`.

    Raises:
        ValueError: there are no policies.
    """
    if not rates:
        raise ValueError("a figure needs at least one policy")
    figure = plain_figure(7.0, 4.4)
    axis = figure.subplots()
    colors = dict(zip(rates, _colors(len(rates)), strict=True))
    # The best on top of the legend, as the lines are at the right.
    for name in sorted(rates, key=lambda name: -rates[name][-1]):
        values = rates[name]
        axis.plot(
            np.arange(1, len(values) + 1),
            values,
            color=colors[name],
            marker=_MARKERS[list(rates).index(name) % len(_MARKERS)],
            markersize=5,
            label=name,
        )
    axis.set_ylim(0, 1)
    axis.yaxis.set_major_formatter(PercentFormatter(1.0))
    axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    axis.set_xlabel("actions")
    axis.set_ylabel("target out within so many actions")
    axis.grid(alpha=0.3)
    _plain(axis)
    axis.legend(
        loc="center left",
        bbox_to_anchor=(1.01, 0.5),
        frameon=False,
    )
    return figure


def _colors(count: int) -> np.ndarray:
    """Returns (count, 4) RGBA, told apart as long as there are ten."""
    return colormaps["tab10"](np.arange(count) % 10)


def _plain(axis: Axes) -> None:
    axis.spines[["top", "right"]].set_visible(False)
