"""What a network learns from: an observation and its label."""

from dataclasses import dataclass

import numpy as np

from xray_drake.dataset.sample import Sample

_MIN_SHARE = 0.5
"""A block of pixels has a reading where at least this share of it has, and is
in a mask where more than this share of it is."""


@dataclass(frozen=True, eq=False)
class LabelledImages:
    """An observation and its label; all images (H, W).

    Attributes:
        depth: float32 z-depth, m; 0 where there is no reading.
        modal: bool, the target's visible pixels as they are observed.
        amodal: bool, all its pixels.
        occupancy: float32 in [0, 1], the label.
        focal_length: pixels; what turns slopes and parallax into pixels.
    """

    depth: np.ndarray
    modal: np.ndarray
    amodal: np.ndarray
    occupancy: np.ndarray
    focal_length: float

    @property
    def shape(self) -> tuple[int, int]:
        """``(height, width)``."""
        height, width = self.depth.shape
        return height, width


def labelled_images(sample: Sample) -> LabelledImages:
    """Returns what a network learns of a sample."""
    return LabelledImages(
        depth=sample.depth,
        modal=sample.target_modal,
        amodal=sample.target_amodal,
        occupancy=sample.occupancy,
        focal_length=float(sample.intrinsics[0, 0]),
    )


def downscale(images: LabelledImages, factor: int) -> LabelledImages:
    """Makes images smaller by a whole factor, each block one pixel.

    Depth is the mean of the block's readings (never of a reading and a missing
    one), or none where less than half of the block has one; at edges that is a
    depth between the two. A mask has the pixels of which it covers more than
    half, so slivers vanish. The distribution is the block's mean: its maximum
    may drop below 1.

    Args:
        images: to be made smaller.
        factor: 1, 2, …; divides height and width.

    Raises:
        ValueError: it does not.
    """
    if factor == 1:
        return images
    height, width = images.shape
    if factor < 1 or height % factor or width % factor:
        raise ValueError(
            f"images of {height}×{width} cannot be scaled down by {factor}"
        )

    def mean(image: np.ndarray) -> np.ndarray:
        """(h, w) float32: the mean of each block."""
        total = np.zeros((height // factor, width // factor), np.float32)
        for row in range(factor):
            for column in range(factor):
                total += image[row::factor, column::factor]
        return total / np.float32(factor**2)

    share = mean(images.depth > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(share >= _MIN_SHARE, mean(images.depth) / share, 0.0)
    return LabelledImages(
        depth=depth.astype(np.float32),
        modal=mean(images.modal) > _MIN_SHARE,
        amodal=mean(images.amodal) > _MIN_SHARE,
        occupancy=mean(images.occupancy),
        focal_length=images.focal_length / factor,
    )
