"""Many convex silhouettes at once, as the pixels they span in each row."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Spans:
    """The pixels of n convex masks, row by row.

    Attributes:
        rows: (n, r) image row of each span.
        starts: (n, r) its first column.
        ends: (n, r) one past its last column; ``starts`` where it is empty.
        shape: height and width of the image; all spans are inside.
    """

    rows: np.ndarray
    starts: np.ndarray
    ends: np.ndarray
    shape: tuple[int, int]

    def areas(self) -> np.ndarray:
        """Returns the (n,) numbers of pixels."""
        return (self.ends - self.starts).sum(axis=1)

    def sums(self, image: np.ndarray) -> np.ndarray:
        """Returns the (n,) sums of an (H, W) bool image over each mask."""
        running = np.zeros((self.shape[0], self.shape[1] + 1), dtype=np.int32)
        np.cumsum(image, axis=1, out=running[:, 1:])
        return (
            running[self.rows, self.ends] - running[self.rows, self.starts]
        ).sum(axis=1)

    def total(self, chosen: np.ndarray) -> np.ndarray:
        """Returns (H, W) float32: how many ``chosen`` masks cover a pixel.

        Args:
            chosen: (n,) bool.
        """
        height, width = self.shape
        row = self.rows[chosen].ravel() * (width + 1)
        size = height * (width + 1)
        change = np.bincount(row + self.starts[chosen].ravel(), minlength=size)
        change -= np.bincount(row + self.ends[chosen].ravel(), minlength=size)
        covered = np.cumsum(change.reshape(height, width + 1), axis=1)
        return covered[:, :-1].astype(np.float32)


def convex_spans(outlines: np.ndarray, shape: tuple[int, int]) -> Spans:
    """Draws convex polygons exactly: a pixel is in if its centre is.

    Args:
        outlines: (n, e, 2) corners in order, pixels; pixel centres at
            integers.
        shape: height and width of the image; what is outside is cut off.
    """
    height, width = shape
    first = np.ceil(outlines[..., 1].min(axis=1)).astype(int)
    last = np.floor(outlines[..., 1].max(axis=1)).astype(int)
    count = max(int((last - first).max(initial=0)) + 1, 1)
    rows = first[:, None] + np.arange(count)

    # A row of a convex polygon ends where it first meets a side's line.
    left = np.full(rows.shape, -np.inf)
    right = np.full(rows.shape, np.inf)
    following = np.roll(outlines, -1, axis=1)
    steps = following - outlines
    x, y = outlines[..., 0], outlines[..., 1]
    turn = np.sign((x * following[..., 1] - y * following[..., 0]).sum(axis=1))
    rising = steps[..., 1] * turn[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = steps[..., 0] / steps[..., 1]
        offsets = x - slopes * y
    level = steps[..., 1] == 0
    slopes[level], offsets[level] = 0.0, 0.0
    for k in range(outlines.shape[1]):
        line = offsets[:, k, None] + slopes[:, k, None] * rows
        on_right = rising[:, k] > 0
        on_left = rising[:, k] < 0
        np.minimum(right, line, out=right, where=on_right[:, None])
        np.maximum(left, line, out=left, where=on_left[:, None])
    inside = (left <= right) & (rows <= last[:, None])
    inside &= (rows >= 0) & (rows < height)
    left, right = np.where(inside, left, 0.0), np.where(inside, right, -1.0)
    starts = np.ceil(left).clip(0, width).astype(int)
    ends = (np.floor(right) + 1).clip(0, width).astype(int)
    return Spans(
        rows.clip(0, height - 1), starts, np.maximum(ends, starts), shape
    )
