"""Samples of a dataset as figures, alone or beside what was predicted."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from xray_drake.dataset.sample import Sample
from xray_drake.drawing.colors import depth_picture, instance_picture, overlay
from xray_drake.drawing.figures import SEEN, WHOLE, Panel, panel_figure
from xray_drake.messages import OccupancyDistribution


def sample_figure(samples: Sequence[Sample]) -> Figure:
    """Draws samples, one per row.

    From left to right: colour (or instances) with the target's outlines, seen
    (magenta) and whole (white); depth, near is bright; distribution over it.

    Args:
        samples: at least one.

    Returns:
        A figure that belongs to no window; ``figure.savefig`` writes it.

    Raises:
        ValueError: there are no samples.
    """
    panels = []
    for sample in samples:
        color, gray = sample.color, depth_picture(sample.depth)
        if color is None:
            color = instance_picture(sample.instances)
        whole = {WHOLE: sample.target_amodal}
        read = sample.depth[sample.depth > 0]
        reach = f"{read.min():.3f} to {read.max():.3f} m" if read.size else ""
        support = np.count_nonzero(sample.occupancy)
        panels += [
            Panel(color, str(sample.key), whole | {SEEN: sample.target_modal}),
            Panel(gray, f"depth {reach}"),
            Panel(
                overlay(gray, sample.occupancy),
                f"{sample.visible_fraction:.0%} visible, support {support} "
                "pixels",
                whole,
            ),
        ]
    return panel_figure(panels, 3)


@dataclass(frozen=True, eq=False)
class Example:
    """One sample and what was predicted of it.

    Attributes:
        sample: with its label.
        predictions: predictor to its answer.
        ious: predictor to the IoU of its prediction; NaN if undefined.
    """

    sample: Sample
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
    """Draws predictions beside their labels, as the paper's Figure 4.

    A row each. From left to right: depth, near is bright, with the outline of
    what is seen of the target (magenta); the label; the predictions.
    Distributions lie over the depth, dark violet to yellow, with the outline
    of the whole target (white). Only their support is drawn.

    Args:
        examples: at least one, all with predictions of the same predictors.

    Returns:
        A figure that belongs to no window; ``figure.savefig`` writes it.

    Raises:
        ValueError: there are no examples, or they differ in predictors.
    """
    panels = []
    names = list(examples[0].predictions) if examples else []
    for example in examples:
        if list(example.predictions) != names:
            raise ValueError("all rows of a figure need the same predictors")
        sample = example.sample
        gray = depth_picture(sample.depth)
        panels.append(Panel(gray, str(sample.key), {SEEN: sample.target_modal}))
        label = f"label, target {sample.visible_fraction:.0%} visible"
        shown = {label: OccupancyDistribution(sample.occupancy)} | {
            f"{name}, IoU {example.ious[name]:.3f}": example.predictions[name]
            for name in names
        }
        panels += [
            Panel(
                overlay(gray, answer.supported()),
                title,
                {WHOLE: sample.target_amodal},
            )
            for title, answer in shown.items()
        ]
    return panel_figure(panels, 2 + len(names))
