"""Predicted distributions beside their labels: the paper's Figure 4."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from xray_drake.drawing.colors import overlay
from xray_drake.drawing.sample_figure import SampleLike, depth_picture
from xray_drake.messages import OccupancyDistribution

_MODAL_LINE = "#ff00b4"
_AMODAL_LINE = "#ffffff"


@dataclass(frozen=True, eq=False)
class Example:
    """One sample and what was predicted of it.

    Attributes:
        sample: with its label.
        predictions: predictor to its answer.
        ious: predictor to the IoU of its prediction; NaN if undefined.
    """

    sample: SampleLike
    predictions: Mapping[str, OccupancyDistribution]
    ious: Mapping[str, float]


def choose_examples(
    ious: Sequence[float], count: int, *, worst: bool = False
) -> list[int]:
    """Chooses what to draw.

    Args:
        ious: of all images; NaN if undefined.
        count: how many at most.
        worst: those of the lowest IoU, the lowest first, and none whose IoU
            is undefined; otherwise the first ones.

    Returns:
        Indices of images.
    """
    if not worst:
        return list(range(min(count, len(ious))))
    values = np.asarray(ious, dtype=float)
    order = np.argsort(values, kind="stable")
    return [int(i) for i in order if not np.isnan(values[i])][:count]


def prediction_figure(examples: Sequence[Example]) -> Figure:
    """Draws examples, one per row.

    From left to right: depth, near is bright, with the outline of what is
    seen of the target (magenta); the label; the predictions. Distributions lie
    over the depth, dark violet to yellow, with the outline of the whole target
    (white). Only their support is drawn.

    Args:
        examples: at least one, all with predictions of the same predictors.

    Returns:
        A figure that belongs to no window; ``figure.savefig`` writes it.

    Raises:
        ValueError: there are no examples, or they differ in predictors.
    """
    if not examples:
        raise ValueError("a figure needs at least one example")
    names = list(examples[0].predictions)
    if any(list(example.predictions) != names for example in examples):
        raise ValueError("all rows of a figure need the same predictors")
    height, width = examples[0].sample.depth.shape
    columns = 2 + len(names)
    row = 4.0 * height / width + 0.3
    figure = Figure(
        figsize=(4.07 * columns, row * len(examples)),
        dpi=80,
        layout="constrained",
    )
    FigureCanvasAgg(figure)
    rows = figure.subplots(len(examples), columns, squeeze=False)
    for axes, example in zip(rows, examples, strict=True):
        sample = example.sample
        gray = depth_picture(sample.depth)
        _show(axes[0], gray, str(sample.key))
        _outline(axes[0], sample.target_modal, _MODAL_LINE)
        label = f"label, target {sample.visible_fraction:.0%} visible"
        shown = {label: OccupancyDistribution(sample.occupancy)} | {
            f"{name}, IoU {example.ious[name]:.3f}": example.predictions[name]
            for name in names
        }
        for axis, (title, answer) in zip(axes[1:], shown.items(), strict=True):
            _show(axis, overlay(gray, answer.supported()), title)
            _outline(axis, sample.target_amodal, _AMODAL_LINE)
    return figure


def _show(axis: Axes, image: np.ndarray, title: str) -> None:
    axis.imshow(image, interpolation="nearest")
    axis.set_axis_off()
    axis.set_title(title, fontsize=9, loc="left", parse_math=False)


def _outline(axis: Axes, mask: np.ndarray, color: str) -> None:
    if mask.any() and not mask.all():
        axis.contour(mask, levels=[0.5], colors=color, linewidths=1.0)
