import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.perception.segmentation_metrics import (
    SegmentationScore,
    score_segmentation,
)

LABELS = arrays(np.int64, (6, 8), elements=st.integers(-1, 4))


def image(*spans: tuple[int, int, int], width: int = 100) -> np.ndarray:
    """One row: label, first and last column."""
    labels = np.full((1, width), -1)
    for label, first, last in spans:
        labels[0, first:last] = label
    return labels


def score(truth: np.ndarray, found: np.ndarray) -> SegmentationScore:
    return score_segmentation(truth, found, min_area=1)


@given(labels=LABELS, names=st.permutations(range(5)))
def test_the_truth_is_perfect_whatever_it_is_called(
    labels: np.ndarray, names: list[int]
) -> None:
    renamed = np.where(labels >= 0, np.array(names)[labels], -1)
    result = score(labels, renamed)
    count = len(np.unique(labels[labels >= 0]))
    assert (result.objects, result.segments) == (count, count)
    assert result.matched == result.recalled == count
    if count:
        assert result.mean_iou == result.recall == result.precision == 1
        assert result.over_segmentation == result.under_segmentation == 0


@given(truth=LABELS, found=LABELS)
def test_whatever_is_found(truth: np.ndarray, found: np.ndarray) -> None:
    result = score(truth, found)
    assert 0 <= result.recalled <= result.matched
    assert result.matched <= min(result.objects, result.segments)
    assert 0 <= result.iou_sum <= result.matched
    assert 0 <= result.best_pixels <= result.object_pixels
    assert result.object_pixels == np.count_nonzero(truth >= 0)
    # The background is no object: no segment is the better for covering it.
    covering = np.where((truth < 0) & (found < 0), 99, found)
    assert score(truth, covering).recalled == result.recalled


def test_an_object_in_parts() -> None:
    result = score(
        image((0, 0, 40)), image((0, 0, 30), (1, 30, 40), (2, 80, 90))
    )
    assert (result.objects, result.segments, result.matched) == (1, 3, 1)
    assert result.mean_iou == pytest.approx(0.75)
    assert result.recall == 1
    assert result.precision == pytest.approx(1 / 3)
    assert result.over_segmentation == pytest.approx(0.25)
    assert result.under_segmentation == 0


def test_two_objects_in_one() -> None:
    result = score(image((0, 0, 60), (1, 60, 80)), image((0, 0, 100)))
    assert result.mean_iou == pytest.approx(0.6)
    assert result.recall == 0.5
    assert result.over_segmentation == 0
    # 40 pixels that are not the first object's and 80 not the second's.
    assert result.under_segmentation == pytest.approx(120 / 80)


def test_matching_is_one_to_one() -> None:
    # Both objects like segment 0 best, but only one can have it.
    truth = image((0, 0, 20), (1, 20, 40))
    found = image((0, 5, 33), (1, 33, 40))
    result = score(truth, found)
    assert result.matched == 2
    assert result.iou_sum == pytest.approx(15 / 33 + 7 / 20)
    assert result.recalled == 0


def test_half_is_not_recalled() -> None:
    result = score(image((0, 0, 20)), image((0, 0, 10)))
    assert (result.mean_iou, result.recall) == (0.5, 0)


def test_small_objects_do_not_count() -> None:
    truth = image((0, 0, 50), (1, 60, 109), width=120)
    result = score_segmentation(truth, truth)
    assert (result.objects, result.segments) == (1, 2)
    assert result.object_pixels == 50


def test_nothing_there_or_nothing_found() -> None:
    nothing = score(image(), image((0, 0, 10)))
    assert np.isnan(nothing.recall)
    assert np.isnan(nothing.mean_iou)
    missed = score(image((0, 0, 10)), image())
    assert missed.recall == 0
    assert missed.over_segmentation == 1
    assert missed.under_segmentation == 0
    # As missed as by a segment elsewhere.
    elsewhere = score(image((0, 0, 10)), image((0, 50, 90)))
    assert dataclasses.replace(elsewhere, segments=0) == missed


@given(pairs=st.lists(st.tuples(LABELS, LABELS), min_size=1, max_size=4))
def test_scores_add_up(pairs: list[tuple[np.ndarray, np.ndarray]]) -> None:
    total = sum((score(t, f) for t, f in pairs), SegmentationScore())
    side_by_side = score(
        np.hstack(
            [np.where(t < 0, -1, t + 9 * i) for i, (t, _) in enumerate(pairs)]
        ),
        np.hstack(
            [np.where(f < 0, -1, f + 9 * i) for i, (_, f) in enumerate(pairs)]
        ),
    )
    assert total.iou_sum == pytest.approx(side_by_side.iou_sum)
    assert dataclasses.replace(total, iou_sum=0, matched=0, recalled=0) == (
        dataclasses.replace(side_by_side, iou_sum=0, matched=0, recalled=0)
    )


def test_images_of_two_sizes() -> None:
    with pytest.raises(ValueError, match=r"\(1, 100\) but .* \(1, 90\)"):
        score(image(), image(width=90))
