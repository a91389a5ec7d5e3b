import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from xray_drake.occupancy.metrics import (
    CalibrationCounts,
    PixelCounts,
    calibration_counts,
    mass_on_mask,
    pixel_counts,
    share_in_support,
)

SHAPE = (5, 7)
IMAGES = arrays(np.float32, SHAPE, elements=st.floats(0, 1, width=32))
MASKS = arrays(np.bool_, SHAPE)


def by_hand(truth: np.ndarray, prediction: np.ndarray) -> PixelCounts:
    """Counts pixel after pixel, in the words of PROTOCOL.md."""
    tp = tn = positives = negatives = union = 0
    for g, p in zip(
        truth.ravel().tolist(), prediction.ravel().tolist(), strict=True
    ):
        if g > 0.1:
            positives += 1
            tp += abs(p - g) < 0.2
        else:
            negatives += 1
            tn += abs(p - g) < 0.2
        union += g > 0.1 or p > 0.1
    return PixelCounts(tp, tn, positives, negatives, union)


@pytest.mark.parametrize(
    ("g", "p", "counts"),
    [
        (1.0, 0.9, PixelCounts(tp=1, positives=1, union=1)),
        (0.5, 0.75, PixelCounts(positives=1, union=1)),
        # 0.1 is not positive, 0.2 off is not right.
        (0.1, 0.1, PixelCounts(tn=1, negatives=1)),
        (0.11, 0.1, PixelCounts(tp=1, positives=1, union=1)),
        (0.0, 0.2, PixelCounts(negatives=1, union=1)),
        # Right, but in the union.
        (0.0, 0.19, PixelCounts(tn=1, negatives=1, union=1)),
    ],
)
def test_thresholds_are_the_papers(
    g: float, p: float, counts: PixelCounts
) -> None:
    assert pixel_counts(np.array([[g]]), np.array([[p]])) == counts


def test_scores_by_hand() -> None:
    counts = PixelCounts(tp=1, tn=2, positives=3, negatives=3, union=5)
    assert counts.balanced_accuracy == pytest.approx((1 / 3 + 2 / 3) / 2)
    assert counts.iou == pytest.approx(1 / 5)
    prediction = np.array([[1.0, 0.5, 0.02], [0.48, 0.0, 0.0]])
    mask = np.array([[True, False, True], [False, True, False]])
    assert mass_on_mask(prediction, mask) == pytest.approx(1.02 / 2.0)
    # Only the shape of the distribution counts.
    assert mass_on_mask(0.1 * prediction, mask) == pytest.approx(1.02 / 2.0)
    assert share_in_support(prediction > 0, mask) == pytest.approx(2 / 3)
    assert share_in_support(prediction > 0.02, mask) == pytest.approx(1 / 3)


@given(truth=IMAGES, prediction=IMAGES)
def test_counts_agree_with_a_loop(
    truth: np.ndarray, prediction: np.ndarray
) -> None:
    assert pixel_counts(truth, prediction) == by_hand(truth, prediction)


@given(a=IMAGES, b=IMAGES, c=IMAGES, d=IMAGES)
def test_counts_of_a_set_are_those_of_its_images(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray
) -> None:
    both = pixel_counts(np.stack([a, c]), np.stack([b, d]))
    assert pixel_counts(a, b) + pixel_counts(c, d) == both


NOTHING, ALL = np.zeros(SHAPE), np.ones(SHAPE)


@pytest.mark.parametrize(
    "score",
    [
        PixelCounts().iou,
        pixel_counts(NOTHING, NOTHING).iou,
        pixel_counts(NOTHING, ALL).balanced_accuracy,
        pixel_counts(ALL, ALL).balanced_accuracy,
        mass_on_mask(NOTHING, ALL > 0),
        share_in_support(NOTHING, NOTHING > 0),
        CalibrationCounts().expected_calibration_error,
        CalibrationCounts().brier_score,
    ],
)
def test_what_is_undefined_is_nan(score: float) -> None:
    assert math.isnan(score)


def test_calibration_by_hand() -> None:
    prediction = np.array([[0.0, 0.2, 0.6, 1.0]])
    mask = np.array([[False, True, False, True]])
    counts = calibration_counts(prediction, mask, bins=2)
    # |0.1 − 0.5| and |0.8 − 0.5|, half the pixels each.
    assert counts.expected_calibration_error == pytest.approx(0.35)
    assert counts.brier_score == pytest.approx((0 + 0.64 + 0.36 + 0) / 4)


@given(prediction=IMAGES, mask=MASKS, bins=st.integers(1, 12))
def test_calibration_agrees_with_a_loop(
    prediction: np.ndarray, mask: np.ndarray, bins: int
) -> None:
    pixels, observed, predicted = [0] * bins, [0] * bins, [0.0] * bins
    error = 0.0
    for p, there in zip(
        prediction.ravel().tolist(), mask.ravel().tolist(), strict=True
    ):
        i = min(int(p * bins), bins - 1)
        pixels[i] += 1
        observed[i] += there
        predicted[i] += p
        error += (p - there) ** 2
    counts = calibration_counts(prediction, mask, bins=bins)
    assert counts.pixels.tolist() == pixels
    assert counts.observed.tolist() == observed
    assert counts.predicted.tolist() == pytest.approx(predicted)
    assert counts.squared_error == pytest.approx(error)
    assert 0 <= counts.expected_calibration_error <= 1


@given(a=IMAGES, b=IMAGES, mask=MASKS, other=MASKS)
def test_calibration_counts_add_up(
    a: np.ndarray, b: np.ndarray, mask: np.ndarray, other: np.ndarray
) -> None:
    total = calibration_counts(a, mask) + CalibrationCounts()
    total += calibration_counts(b, other)
    both = calibration_counts(np.stack([a, b]), np.stack([mask, other]))
    assert total.pixels.tolist() == both.pixels.tolist()
    assert total.observed.tolist() == both.observed.tolist()
    np.testing.assert_allclose(total.predicted, both.predicted)
    assert total.brier_score == pytest.approx(both.brier_score)


def test_images_that_do_not_fit_are_an_error() -> None:
    image, mask = np.zeros((3, 4)), np.zeros((4, 3), bool)
    for measure in (
        pixel_counts,
        mass_on_mask,
        share_in_support,
        calibration_counts,
    ):
        with pytest.raises(ValueError, match=r"\(3, 4\) and of \(4, 3\)"):
            measure(image, mask)  # type: ignore[operator]
    with pytest.raises(ValueError, match="at least one bin"):
        calibration_counts(image, image > 0, bins=0)
