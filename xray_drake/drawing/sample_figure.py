"""Samples of a dataset as a figure."""

import colorsys
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from xray_drake.drawing.colors import overlay

_BACKGROUND = (225, 225, 225)
_TARGET = (205, 20, 20)
_NO_READING = (255, 215, 235)
_MODAL_LINE = "#ff00b4"
_AMODAL_LINE = "#ffffff"

_GOLDEN = 0.618034
"""Of a turn: neighbours in the list are far apart in hue."""


class SampleLike(Protocol):
    """What a figure needs of a sample; see ``xray_drake.dataset.sample``."""

    @property
    def depth(self) -> np.ndarray:
        """(H, W) z-depth, m; 0 where there is no reading."""

    @property
    def target_modal(self) -> np.ndarray:
        """(H, W) bool mask of what is seen of the target."""

    @property
    def target_amodal(self) -> np.ndarray:
        """(H, W) bool mask of the whole target."""

    @property
    def instances(self) -> np.ndarray:
        """(H, W) instances: 0 background, 1 target, then the others."""

    @property
    def occupancy(self) -> np.ndarray:
        """(H, W) label in [0, 1]."""

    @property
    def color(self) -> np.ndarray | None:
        """(H, W, 3) uint8 RGB, if there is one."""

    @property
    def visible_fraction(self) -> float:
        """Visible share of the target's amodal mask."""

    @property
    def key(self) -> object:
        """What ``str`` makes a title of."""


def sample_figure(samples: Sequence[SampleLike]) -> Figure:
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
    if not samples:
        raise ValueError("a figure needs at least one sample")
    height, width = samples[0].depth.shape
    row = 4.0 * height / width + 0.3
    figure = Figure(
        figsize=(12.2, row * len(samples)), dpi=80, layout="constrained"
    )
    FigureCanvasAgg(figure)
    rows = figure.subplots(len(samples), 3, squeeze=False)
    for axes, sample in zip(rows, samples, strict=True):
        gray = depth_picture(sample.depth)
        picture = (
            instance_picture(sample.instances)
            if sample.color is None
            else sample.color
        )
        for axis, image in zip(
            axes,
            (picture, gray, overlay(gray, sample.occupancy)),
            strict=True,
        ):
            axis.imshow(image, interpolation="nearest")
            axis.set_axis_off()
        _outline(axes[0], sample.target_amodal, _AMODAL_LINE)
        _outline(axes[0], sample.target_modal, _MODAL_LINE)
        _outline(axes[2], sample.target_amodal, _AMODAL_LINE)
        axes[0].set_title(str(sample.key), fontsize=9, loc="left")
        valid = sample.depth[sample.depth > 0]
        reach = (
            f"{valid.min():.3f} to {valid.max():.3f} m" if valid.size else ""
        )
        axes[1].set_title(f"depth {reach}", fontsize=9, loc="left")
        axes[2].set_title(
            f"{sample.visible_fraction:.0%} visible, support "
            f"{np.count_nonzero(sample.occupancy)} pixels",
            fontsize=9,
            loc="left",
        )
    return figure


def depth_picture(depth: np.ndarray) -> np.ndarray:
    """Returns a depth image as grey, near is bright.

    Args:
        depth: (H, W) z-depth, m; 0 where there is no reading.

    Returns:
        (H, W, 3) uint8 RGB; pink where there is no reading.
    """
    valid = depth > 0
    if not valid.any():
        return np.full((*depth.shape, 3), _NO_READING, np.uint8)
    near, far = np.percentile(depth[valid], [0.5, 99.5])
    shade = 1 - np.clip((depth - near) / max(far - near, 1e-6), 0, 1)
    gray = np.rint(40 + 200 * shade).astype(np.uint8)
    return np.where(
        valid[..., None], gray[..., None], np.array(_NO_READING, np.uint8)
    )


def instance_colors(count: int) -> np.ndarray:
    """Returns (count, 3) uint8 RGB: background grey, target red, no other red.

    Args:
        count: of values in an instance image.
    """
    colors = np.empty((max(count, 2), 3), np.uint8)
    colors[0], colors[1] = _BACKGROUND, _TARGET
    for index in range(2, count):
        hue = 0.1 + 0.8 * (index * _GOLDEN % 1.0)
        value = 0.65 + 0.3 * (index % 2)
        colors[index] = np.rint(
            255 * np.array(colorsys.hsv_to_rgb(hue, 0.6, value))
        )
    return colors[:count]


def instance_picture(instances: np.ndarray) -> np.ndarray:
    """Returns (H, W, 3) uint8 RGB of an (H, W) image of instances."""
    return instance_colors(int(instances.max()) + 1)[instances]


def _outline(axis: Axes, mask: np.ndarray, color: str) -> None:
    if mask.any() and not mask.all():
        axis.contour(mask, levels=[0.5], colors=color, linewidths=1.0)
