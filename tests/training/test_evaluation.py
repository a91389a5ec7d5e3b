import dataclasses
import json
import math
import time
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from tests.dataset.whole import bare_sample
from xray_drake.dataset.augmentation import DepthNoise
from xray_drake.dataset.check import FULLY_VISIBLE
from xray_drake.dataset.sample import Sample
from xray_drake.messages import OccupancyDistribution
from xray_drake.occupancy.metrics import PixelCounts, pixel_counts
from xray_drake.training.disturbance import Disturbance
from xray_drake.training.evaluation import (
    Estimate,
    Evaluation,
    Visibility,
    evaluate,
    markdown_table,
    visibility,
)

SHAPE = (12, 16)


def make_sample(
    heap_seed: int = 0,
    *,
    view: int = 0,
    visible: float = 0.5,
    target_name: str = "box_2to1",
) -> Sample:
    """A target of 4 × 5 pixels whose label is 1 there and 0.5 beside it."""
    amodal, modal = np.zeros((2, *SHAPE), bool)
    amodal[4:8, 5:10] = True
    rows, columns = np.nonzero(amodal)
    seen = round(visible * rows.size)
    modal[rows[:seen], columns[:seen]] = True
    occupancy = amodal.astype(float)
    occupancy[4:8, 10:12] = 0.5
    return dataclasses.replace(
        bare_sample(amodal, focal_length=17.0, heap_seed=heap_seed),
        depth=np.full(SHAPE, 0.8),
        target_modal=modal,
        instances=modal,
        occupancy=occupancy,
        target_size=np.array([0.06, 0.03, 0.005]),
        target_name=target_name,
        view=view,
        num_dropped=3,
    )


def truth(sample: Sample) -> OccupancyDistribution:
    return OccupancyDistribution(sample.occupancy)


def nothing(sample: Sample) -> OccupancyDistribution:
    return OccupancyDistribution(np.zeros(sample.shape))


def good_or_bad(sample: Sample) -> OccupancyDistribution:
    """Right about heaps of an even seed; says nothing of the others."""
    return truth(sample) if sample.heap_seed % 2 == 0 else nothing(sample)


def run(samples: Sequence[Sample], predictor: object = truth) -> Evaluation:
    results = evaluate(samples, {"it": predictor})  # type: ignore[dict-item]
    assert list(results) == ["it"]
    return results["it"]


@pytest.mark.parametrize(
    ("fraction", "expected"),
    [
        (0.0, Visibility.HIDDEN),
        (0.001, Visibility.PARTLY_VISIBLE),
        (FULLY_VISIBLE, Visibility.PARTLY_VISIBLE),
        (FULLY_VISIBLE + 1e-6, Visibility.FULLY_VISIBLE),
        (1.0, Visibility.FULLY_VISIBLE),
    ],
)
def test_classes_are_those_of_the_datasets_statistics(
    fraction: float, expected: Visibility
) -> None:
    assert visibility(fraction) is expected


def test_the_truth_scores_full_marks() -> None:
    result = run([make_sample(0), make_sample(1, visible=0.0)])
    overall = result.overall
    assert (overall.images, overall.heaps) == (2, 2)
    for name in (
        "balanced_accuracy",
        "iou",
        "mean_balanced_accuracy",
        "mean_iou",
        "containment",
    ):
        assert getattr(overall, name) == Estimate(1, 1, 1), name
    # 20 pixels of 1 on the target, 8 of 0.5 beside it.
    assert overall.target_mass.value == pytest.approx(20 / 24)
    assert overall.brier_score.value == pytest.approx(8 * 0.25 / 192)


def test_pooled_counts_and_means_by_hand() -> None:
    # The second image has a label of one pixel, and it is found; the first
    # has 28, of which none is.
    occupancy = np.zeros(SHAPE)
    occupancy[5, 6] = 1.0
    small = dataclasses.replace(make_sample(0), occupancy=occupancy)
    overall = run([make_sample(1), small], good_or_bad).overall
    assert overall.counts == PixelCounts(
        tp=1, tn=164 + 191, positives=29, negatives=164 + 191, union=29
    )
    assert overall.iou.value == pytest.approx(1 / 29)
    assert overall.mean_iou.value == pytest.approx(0.5)
    assert overall.balanced_accuracy.value == pytest.approx((1 / 29 + 1) / 2)
    assert overall.mean_balanced_accuracy.value == pytest.approx(0.75)
    # Nowhere is as wrong as elsewhere: it has no mass on the target.
    assert overall.target_mass.value == pytest.approx(0.5)
    # One of 20 pixels of the second target is in the support.
    assert overall.containment.value == 0.0


def test_parts_are_of_their_own_images() -> None:
    samples = [
        make_sample(0, visible=0.0, target_name="lid"),
        make_sample(1, visible=0.0, target_name="box_1to1"),
        make_sample(2, visible=0.5, target_name="lid"),
        make_sample(4, visible=1.0, target_name="spoon"),
    ]
    result = run(samples, good_or_bad)
    by = result.by_visibility
    assert [by[v].images for v in Visibility] == [2, 1, 1]
    assert [by[v].mean_iou.value for v in Visibility] == [0.5, 1, 1]
    # In the package's order, what it does not know last.
    assert list(result.by_target) == ["box_1to1", "lid", "spoon"]
    assert [s.iou.value for s in result.by_target.values()] == [0, 1, 1]
    assert [s.images for s in result.by_target.values()] == [1, 2, 1]
    total = sum((s.counts for s in by.values()), PixelCounts())
    assert total == result.overall.counts
    assert [r.key for r in result.records] == [s.key for s in samples]
    bad = pixel_counts(samples[1].occupancy, np.zeros(SHAPE))
    assert result.records[1].counts == bad


def test_views_of_a_heap_are_drawn_together() -> None:
    def width(samples: Sequence[Sample]) -> float:
        iou = run(samples, good_or_bad).overall.mean_iou
        assert iou.value == 0.5
        return iou.high - iou.low

    # Each heap is all right or all wrong: eight views say no more than one.
    once = width([make_sample(i) for i in range(20)])
    views = width([make_sample(i, view=v) for i in range(20) for v in range(8)])
    apart = width([make_sample(i) for i in range(160)])
    assert views == pytest.approx(once)
    assert apart < 0.5 * views
    # Of 20 coins: ±1.96 · 0.5/√20.
    assert once == pytest.approx(2 * 1.96 * 0.5 / 20**0.5, rel=0.15)


def test_an_interval_covers_the_truth_as_often_as_it_says() -> None:
    rng = np.random.default_rng(0)
    trials, heaps = 60, 40
    covered = 0
    for _ in range(trials):
        seeds = 2 * np.arange(heaps) + (rng.random(heaps) < 0.3)
        samples = [make_sample(int(seed)) for seed in seeds]
        estimate = evaluate(samples, {"it": good_or_bad}, resamples=300)[
            "it"
        ].overall.mean_iou
        covered += estimate.low <= 0.7 <= estimate.high
    # 57 expected; fewer than 50 has a probability of 1 in 1000.
    assert covered >= 50


def test_a_seed_repeats_an_interval_and_one_heap_has_none() -> None:
    samples = [make_sample(i) for i in range(9)]

    def spread(sample: Sample) -> OccupancyDistribution:
        share = sample.heap_seed / 9
        return OccupancyDistribution(np.where(sample.target_amodal, share, 0.1))

    def interval(seed: int) -> object:
        results = evaluate(samples, {"it": spread}, seed=seed)
        return results["it"].overall.target_mass

    assert interval(3) == interval(3)
    assert len({interval(seed) for seed in range(5)}) > 1
    one = run([make_sample(0), make_sample(0, view=1)]).overall
    assert one.heaps == 1
    found = [one.iou.value, one.iou.low, one.iou.high]
    np.testing.assert_equal(found, [1.0, math.nan, math.nan])


def test_the_support_is_the_predictors_own() -> None:
    faint = np.where(make_sample().target_amodal, 0.015, 0.0)
    faint[4, 5] = 0.0  # 19 of 20 pixels are 95 %
    for threshold, held, share in ((0.0, 1.0, 0.95), (0.02, 0.0, 0.0)):
        answer = OccupancyDistribution(faint, threshold, "test")
        result = run([make_sample()], lambda _, answer=answer: answer)
        assert result.overall.containment.value == held
        assert result.records[0].support_share == share


def test_what_an_image_does_not_define_is_left_out_of_means() -> None:
    names = ("occupancy", "target_amodal", "target_modal")
    empty = dict.fromkeys(names, np.zeros(SHAPE))
    samples = [make_sample(0), dataclasses.replace(make_sample(1), **empty)]
    overall = run(samples, truth).overall
    assert overall.mean_iou.value == 1.0
    assert overall.mean_balanced_accuracy.value == 1.0
    assert overall.containment.value == 1.0
    # But it is a place where nothing was to be found.
    assert overall.target_mass.value == pytest.approx(20 / 24 / 2)


def test_seconds_are_the_median_of_the_predictors(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = 0.0

    def slow_at_first(sample: Sample) -> OccupancyDistribution:
        nonlocal now
        now += (2.5, 0.25, 0.5)[sample.heap_seed]
        return truth(sample)

    monkeypatch.setattr(time, "perf_counter", lambda: now)
    result = run([make_sample(i) for i in range(3)], slow_at_first)
    assert [r.seconds for r in result.records] == [2.5, 0.25, 0.5]
    assert result.overall.seconds == 0.5


def test_results_are_strict_json() -> None:
    result = run([make_sample(0)], nothing)
    told = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    overall = told["overall"]
    assert overall["iou"] == {"value": 0.0, "low": None, "high": None}
    assert overall["counts"]["positives"] == 28
    assert sum(overall["calibration"]["pixels"]) == 192
    assert sum(overall["calibration"]["observed"]) == 20
    assert list(told["by_visibility"]) == ["partly_visible"]
    assert list(told["by_target"]) == ["box_2to1"]
    (image,) = told["images"]
    assert (image["heap_seed"], image["target_name"]) == (0, "box_2to1")
    assert image["target_mass"] is None
    assert image["brier_score"] == pytest.approx(20 / 192)


def test_the_table_is_markdown() -> None:
    samples = [
        make_sample(i, visible=0.5 * (i > 1), target_name=name)
        for i, name in enumerate(("lid", "lid", "domino", "lid"))
    ]
    lines = markdown_table(
        evaluate(samples, {"good": truth, "odd": good_or_bad})
    ).splitlines()
    assert len({line.count("|") for line in lines}) == 1
    cells = [[c.strip() for c in li.strip("|").split("|")] for li in lines]
    parts = ["all, 4", "hidden, 2", "partly visible, 2", "lid, 3", "domino, 1"]
    assert [row[:2] for row in cells[2:]] == [
        [part, name] for part in parts for name in ("good", "odd")
    ]
    assert cells[2][2:4] == ["100.0%", "1.000"]
    assert cells[3][3].startswith("0.500 (0.000 to ")
    assert cells[3][5] == "0.500"
    # Of one target there is no table of targets.
    one = markdown_table({"good": run(samples[:2])})
    assert "lid" not in one
    assert "nan" not in one


@pytest.mark.parametrize(
    ("predict", "words"),
    [
        (lambda s: np.zeros((3, 4)), r"\(3, 4\), not \(12, 16\)"),
        (lambda s: 2 * s.occupancy, r"outside \[0, 1\]"),
        (lambda s: s.occupancy - 0.1, r"outside \[0, 1\]"),
        (lambda s: np.full(s.shape, np.nan), "NaN"),
        (lambda s: s.occupancy * np.float32(1 + 1e-6), ""),
    ],
)
def test_a_bad_prediction_is_named_but_not_rounding(
    predict: Callable[[Sample], np.ndarray], words: str
) -> None:
    def it(sample: Sample) -> OccupancyDistribution:
        return OccupancyDistribution(predict(sample))

    if not words:
        assert run([make_sample()], it)
        return
    with pytest.raises(ValueError, match=words) as error:
        run([make_sample(5)], it)
    assert "of it for heap 5, box_2to1" in str(error.value)


@pytest.mark.parametrize(
    ("samples", "predictors", "resamples", "words"),
    [
        ([], {"it": truth}, 1, "no sample"),
        ([make_sample()], {}, 1, "no predictor"),
        ([make_sample()], {"it": truth}, 0, "needs draws"),
    ],
)
def test_nothing_to_evaluate_is_an_error(
    samples: list[Sample], predictors: dict, resamples: int, words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        evaluate(iter(samples), predictors, resamples=resamples)


def test_a_wrong_camera_is_told_and_nothing_else_changes() -> None:
    sample = make_sample()
    assert Disturbance()(sample) is sample
    told = Disturbance(height_offset=0.01, focal_error=-0.02)(sample)
    X_WC, intrinsics = sample.X_WC.copy(), sample.intrinsics.copy()
    X_WC[2, 3] += 0.01
    intrinsics[[0, 1], [0, 1]] *= 0.98
    np.testing.assert_allclose(told.X_WC, X_WC)
    np.testing.assert_allclose(told.intrinsics, intrinsics)
    # The floor that is seen seems to lie so much higher as well.
    points = told.camera.unproject(told.depth)
    assert points[..., 2] == pytest.approx(0.01, abs=1e-6)
    for name in ("depth", "occupancy", "target_modal", "target_amodal"):
        np.testing.assert_array_equal(
            getattr(told, name), getattr(sample, name)
        )
    assert told.key == sample.key


def test_noise_depends_on_seed_and_sample_alone() -> None:
    def seen(seed: int, sample: Sample) -> np.ndarray:
        told = Disturbance(noise=DepthNoise(speckle=0.5), seed=seed)(sample)
        np.testing.assert_array_equal(told.occupancy, sample.occupancy)
        return told.depth

    first = seen(1, make_sample(3))
    np.testing.assert_array_equal(first, seen(1, make_sample(3)))
    for other in (
        make_sample(3).depth,
        seen(2, make_sample(3)),
        seen(1, make_sample(4)),
        seen(1, make_sample(3, view=1)),
    ):
        assert not np.array_equal(first, other)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("focal_error", -1.0),
        ("focal_error", math.nan),
        ("height_offset", math.inf),
    ],
)
def test_an_impossible_camera_is_an_error(key: str, value: float) -> None:
    with pytest.raises(ValueError, match="not"):
        Disturbance(**{key: value})
