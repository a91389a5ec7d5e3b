"""How good a predicted distribution is: the paper's metrics, and ours.

Section IV.C of the paper as PROTOCOL.md ("Metrics") writes it out, with g the
truth and p the prediction, both (H, W) in [0, 1]. Of one image there are
counts; counts add up to those of a set.
"""

from dataclasses import astuple, dataclass, field
from operator import add

import numpy as np

POSITIVE = 0.1
"""Pixels above it are positive, in the truth and in the prediction."""

TOLERANCE = 0.2
"""A pixel is right where prediction and truth differ by less."""

BINS = 10
"""Of predicted values, all of one width, that calibration is counted in."""


@dataclass(frozen=True)
class PixelCounts:
    """Pixels of an image, or of a set of images, by what became of them.

    Attributes:
        tp: g > 0.1 and |p − g| < 0.2.
        tn: g ≤ 0.1 and |p − g| < 0.2.
        positives: g > 0.1.
        negatives: g ≤ 0.1.
        union: g > 0.1 or p > 0.1.
    """

    tp: int = 0
    tn: int = 0
    positives: int = 0
    negatives: int = 0
    union: int = 0

    def __add__(self, other: "PixelCounts") -> "PixelCounts":
        return PixelCounts(*map(add, astuple(self), astuple(other)))

    @property
    def balanced_accuracy(self) -> float:
        """½ (tp / positives + tn / negatives); NaN where either has none."""
        if not self.positives or not self.negatives:
            return float("nan")
        return (self.tp / self.positives + self.tn / self.negatives) / 2

    @property
    def iou(self) -> float:
        """Tp / union; NaN where neither truth nor prediction has positives."""
        return self.tp / self.union if self.union else float("nan")


@dataclass(frozen=True, eq=False)
class CalibrationCounts:
    """Predicted values beside how often the target really was there.

    Of all pixels, those that are surely empty too: they are most of an image
    and make both scores small, so that only scores of the same images compare.

    Attributes:
        pixels: (k,) int64, per bin of predicted values; bins have one width,
            hold their lower edge, and the last one holds 1 as well.
        predicted: (k,) float64, sum of the predictions in it.
        observed: (k,) int64, its pixels that were the target's.
        squared_error: sum of (p − 1)² on the target and of p² elsewhere.
    """

    pixels: np.ndarray = field(default_factory=lambda: np.zeros(BINS, int))
    predicted: np.ndarray = field(default_factory=lambda: np.zeros(BINS))
    observed: np.ndarray = field(default_factory=lambda: np.zeros(BINS, int))
    squared_error: float = 0.0

    def __add__(self, other: "CalibrationCounts") -> "CalibrationCounts":
        """Adds counts in the same bins."""
        return CalibrationCounts(*map(add, astuple(self), astuple(other)))

    @property
    def expected_calibration_error(self) -> float:
        """Mean over pixels of |prediction − frequency| of their bin.

        NaN without any pixel.
        """
        total = int(self.pixels.sum())
        if not total:
            return float("nan")
        return float(np.abs(self.predicted - self.observed).sum()) / total

    @property
    def brier_score(self) -> float:
        """Mean over pixels of (p − was it the target's)²; NaN without any."""
        total = int(self.pixels.sum())
        return self.squared_error / total if total else float("nan")


def pixel_counts(truth: np.ndarray, prediction: np.ndarray) -> PixelCounts:
    """Counts the pixels of one image.

    Args:
        truth: (H, W) in [0, 1], the label g.
        prediction: (H, W) in [0, 1], p.

    Raises:
        ValueError: the shapes differ.
    """
    g, p = _alike(truth, prediction, np.float64)
    right = np.abs(p - g) < TOLERANCE
    positive = g > POSITIVE
    positives = int(np.count_nonzero(positive))
    tp = int(np.count_nonzero(right & positive))
    return PixelCounts(
        tp=tp,
        tn=int(np.count_nonzero(right)) - tp,
        positives=positives,
        negatives=positive.size - positives,
        union=int(np.count_nonzero(positive | (p > POSITIVE))),
    )


def mass_on_mask(prediction: np.ndarray, mask: np.ndarray) -> float:
    """Returns the share of the prediction's sum that lies on a mask.

    On the true amodal mask: the probability that a pixel drawn from the
    prediction shows where the target is.

    Args:
        prediction: (H, W), not negative.
        mask: (H, W) bool.

    Returns:
        In [0, 1]; NaN if the prediction is 0 everywhere.

    Raises:
        ValueError: the shapes differ.
    """
    p, inside = _alike(prediction, mask, bool)
    total = p.sum()
    return float(p[inside].sum() / total) if total > 0 else float("nan")


def share_in_support(support: np.ndarray, mask: np.ndarray) -> float:
    """Returns the share of a mask's pixels that are support.

    Args:
        support: (H, W) bool, the prediction's.
        mask: (H, W) bool; the true amodal mask.

    Returns:
        In [0, 1]; NaN for a blank mask.

    Raises:
        ValueError: the shapes differ.
    """
    held, inside = _alike(support, mask, bool)
    if not inside.any():
        return float("nan")
    return float(np.mean(held[inside] > 0))


def calibration_counts(
    prediction: np.ndarray, mask: np.ndarray, *, bins: int = BINS
) -> CalibrationCounts:
    """Counts how often the target was where it was predicted.

    Takes the prediction for the probability that a pixel is the target's. A
    network trained on amodal masks predicts that; a distribution divided by
    its maximum, as the paper's label, does not, and shows how far it is from
    it.

    Args:
        prediction: (H, W) in [0, 1].
        mask: (H, W) bool, the target's true amodal mask.
        bins: number of bins of predicted values.

    Raises:
        ValueError: the shapes differ, or there is no bin.
    """
    if bins < 1:
        raise ValueError(f"need at least one bin, not {bins}")
    p, inside = _alike(prediction, mask, bool)
    where = np.clip((p * bins).astype(np.int64), 0, bins - 1).ravel()
    return CalibrationCounts(
        pixels=np.bincount(where, minlength=bins),
        predicted=np.bincount(where, weights=p.ravel(), minlength=bins),
        observed=np.bincount(where[inside.ravel()], minlength=bins),
        squared_error=float(np.square(p - inside).sum()),
    )


def _alike(
    first: np.ndarray, second: np.ndarray, dtype: type
) -> tuple[np.ndarray, np.ndarray]:
    """Returns float64 and ``dtype`` images of one shape.

    Raises:
        ValueError: they are of two.
    """
    a: np.ndarray = np.asarray(first, np.float64)
    b: np.ndarray = np.asarray(second, dtype)
    if a.shape != b.shape:
        raise ValueError(f"images of {a.shape} and of {b.shape} do not compare")
    return a, b
