"""What training minimises, and how it is watched."""

import torch
from torch import Tensor
from torch.nn import functional
from torchmetrics import Metric

from xray_drake.occupancy.metrics import POSITIVE, TOLERANCE, PixelCounts

_BETA = 0.1
"""Smaller errors count by their square: PROTOCOL.md asks for less than 0.2."""

_NEAR = 0.75 * TOLERANCE
"""An error is about a miss from here on."""

_AREA = 64.0
"""Pixels added to a label's area, so that small ones do not rule."""

_POSTERIOR_WEIGHT = 10.0
"""A target fills about one pixel in a hundred."""


def robust_loss(
    logits: Tensor,
    label: Tensor,
    *,
    entropy_weight: float = 2.0,
    miss_weight: float = 0.0,
) -> Tensor:
    """Returns the loss of the occupancy distribution.

    Smooth L1, since the metrics ask whether a pixel is within 0.2, once
    relative to the labels' area in the whole batch and once image by image
    (a target that is partly seen has a small one, but it decides the next
    grasp); and cross entropy, which moves what is wrong and sure of it.

    Args:
        logits: (B, h, w).
        label: (B, h, w) in [0, 1].
        entropy_weight: of the cross entropy's mean over the pixels.
        miss_weight: of a pixel that is far off.
    """
    output = torch.sigmoid(logits)
    error = functional.smooth_l1_loss(
        output, label, beta=_BETA, reduction="none"
    ).sum(dim=(1, 2))
    if miss_weight:
        near = torch.exp(-0.5 * ((output - label) / _NEAR) ** 2)
        error = error + miss_weight * (1 - near).sum(dim=(1, 2))
    area = (label > POSITIVE).sum(dim=(1, 2)).to(error.dtype)
    pooled = error.sum() / (area.sum() + _AREA)
    each = (error / (area + _AREA)).mean()
    entropy = functional.binary_cross_entropy_with_logits(logits, label)
    return pooled + each + entropy_weight * entropy


def posterior_loss(logits: Tensor, amodal: Tensor, real: Tensor) -> Tensor:
    """Returns the log score of where targets really were.

    A proper scoring rule: the least expected loss has each pixel's true
    probability.

    Args:
        logits: (B, h, w).
        amodal: (B, h, w) in [0, 1], the true amodal mask.
        real: (B,) bool; other items do not count.
    """
    if not real.any():
        return logits.sum() * 0.0
    score = functional.binary_cross_entropy_with_logits(
        logits[real], amodal[real]
    )
    return _POSTERIOR_WEIGHT * score


def pixel_counts(output: Tensor, label: Tensor) -> Tensor:
    """Returns (5,), the fields of ``PixelCounts`` in their order."""
    positive = label > POSITIVE
    close = (output - label).abs() < TOLERANCE
    return torch.stack(
        [
            (positive & close).sum(),
            (~positive & close).sum(),
            positive.sum(),
            (~positive).sum(),
            (positive | (output > POSITIVE)).sum(),
        ]
    ).double()


class OccupancyMetrics(Metric):
    """PROTOCOL.md's metrics, of the pixels of all images on all devices."""

    full_state_update = False
    counts: Tensor
    mass: Tensor

    def __init__(self) -> None:
        super().__init__()
        for name, size in (("counts", 5), ("mass", 2)):
            zeros = torch.zeros(size, dtype=torch.float64)
            self.add_state(name, zeros, dist_reduce_fx="sum")

    def update(
        self,
        output: Tensor,
        label: Tensor,
        shares: Tensor | None = None,
        beyond: Tensor | None = None,
    ) -> None:
        """Counts a batch.

        Args:
            output: (B, h, w) in [0, 1], the answers.
            label: (B, h, w) in [0, 1].
            shares: (n,) of the posterior's mass that lie on the target.
            beyond: (2,) pixels outside of the images whose label is positive,
                and is not; the answer there is 0.
        """
        self.counts += pixel_counts(output, label)
        if beyond is not None:
            positive, negative = beyond.double()
            zero = torch.zeros_like(positive)
            self.counts += torch.stack(
                [zero, negative, positive, negative, positive]
            )
        if shares is not None:
            total = shares.double().sum()
            self.mass += torch.stack([total, total.new_tensor(len(shares))])

    def compute(self) -> dict[str, float]:
        """Returns balanced accuracy, IoU, and where known the mass."""
        pooled = PixelCounts(*(int(count) for count in self.counts.tolist()))
        found = {
            "balanced_accuracy": pooled.balanced_accuracy,
            "iou": pooled.iou,
        }
        total, number = self.mass.tolist()
        return found | ({"mass_on_target": total / number} if number else {})
