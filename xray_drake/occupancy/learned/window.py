"""The part of an image in which a target that is seen can be.

Each pose that explains what is seen of a target covers it. So none reaches
farther from the visible pixels than the target is long, and a network need not
look at, nor answer for, the rest of the image.
"""

from typing import NamedTuple

import numpy as np

from xray_drake.occupancy.learned.inputs import QUARTER, lengths_in_image

_STEP = 32
"""Sides are multiples of it, as the network needs."""

_MARGIN = 8.0 / 512.0
"""Of the image's width: targets lean, and stand higher than the floor."""


class Window(NamedTuple):
    """A rectangle of an image, in pixels.

    Attributes:
        top: its first row, a multiple of 4.
        left: its first column, a multiple of 4.
        height: a multiple of 32.
        width: a multiple of 32.
    """

    top: int
    left: int
    height: int
    width: int

    @property
    def rows(self) -> slice:
        """Of the image."""
        return slice(self.top, self.top + self.height)

    @property
    def columns(self) -> slice:
        """Of the image."""
        return slice(self.left, self.left + self.width)

    def of(self, images: np.ndarray) -> np.ndarray:
        """Cuts it out of (..., H, W) images; a view."""
        return images[..., self.rows, self.columns]

    def of_coarse(self, images: np.ndarray) -> np.ndarray:
        """Cuts it out of (..., H/4, W/4) images; a view."""
        return Window(*(side // QUARTER for side in self)).of(images)


def target_window(mask: np.ndarray, size: np.ndarray) -> Window:
    """Finds where a target that is seen can be.

    Args:
        mask: (H, W) bool, its visible pixels, at least one; H and W are
            multiples of 32.
        size: (5,), see :func:`~.inputs.size_features`.

    Returns:
        A square about the middle of what is seen, moved into the image; or, if
        it would be larger than the image, all of that.

    Raises:
        ValueError: nothing is seen.
    """
    height, width = mask.shape
    rows = np.flatnonzero(mask.any(axis=1))
    columns = np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        raise ValueError(
            "the mask is blank: a target that is not seen can be anywhere"
        )
    low = np.array([rows[0], columns[0]])
    high = np.array([rows[-1], columns[-1]]) + 1
    long, short = lengths_in_image(size, width).tolist()
    narrow, wide = np.sort(high - low).tolist()
    # Along the longer side of what is seen, and across.
    along = _reach(long, short, wide)
    across = min(_reach(long, short, narrow), along + narrow / 2)
    reach = max(along, across, wide / 2) + _MARGIN * width
    side = _STEP * int(np.ceil(2 * reach / _STEP))
    sides = np.minimum((side, side), (height, width))
    corner = QUARTER * np.rint(((low + high) / 2 - sides / 2) / QUARTER)
    top, left = np.clip(corner, 0, (height, width) - sides).astype(int)
    return Window(int(top), int(left), int(sides[0]), int(sides[1]))


def _reach(long: float, short: float, seen: float) -> float:
    """How far a rectangle reaches from the middle of two points in it.

    A corner is farthest if the points lie about the opposite one, on a side;
    where they are too far apart for that, on two sides.

    Args:
        long: its longer side.
        short: its shorter one.
        seen: the least distance of the points.
    """
    if seen <= short:
        return float(np.hypot(long, short - seen / 2))
    # The points lie on both long sides, ...
    apart = min(long, float(np.sqrt(seen**2 - short**2)))
    reach = np.hypot(long - apart / 2, short / 2)
    if seen <= long:
        # ... or on one, ...
        return float(max(reach, np.hypot(long - seen / 2, short)))
    # ... or on both short ones.
    apart = min(short, float(np.sqrt(seen**2 - long**2)))
    return float(max(reach, np.hypot(long / 2, short - apart / 2)))
