"""What a network learns from: an observation and its label."""

from dataclasses import dataclass

import numpy as np

from xray_drake.dataset.sample import Sample


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
