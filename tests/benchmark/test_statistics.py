import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import bootstrap

from tests.benchmark.synthetic import failure, record
from xray_drake.benchmark.statistics import (
    Part,
    action_difference,
    action_quartiles,
    actions,
    bootstrap_mean,
    causes,
    containment,
    draws,
    drop_seconds,
    occluded,
    parts,
    quantities,
    seconds_a_rollout,
    start_shares,
    success_difference,
    success_rate,
    success_within,
    within,
)

BOX = "box_2to1"


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """The interval's closed form (Wilson 1927) at 95 %."""
    z, n, p = 1.959963984540054, trials, successes / trials
    center = (p + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * math.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    return center - half, center + half


XRAY = [
    record("xray", 0, 2),
    record("xray", 1, 3),
    record("xray", 2, 7),
    record("xray", 3, 10, "horizon"),
    failure("xray", 4),
]
LARGEST = [
    record("largest", 0, 10, "horizon"),
    record("largest", 1, 4),
    record("largest", 2, 5),
    record("largest", 3, 10, "target_lost"),
    record("largest", 9, 1),
]


def values(records: list[dict]) -> dict[str, float]:
    return {k: e.value for k, e in quantities(records, 10).items()}


@given(trials=st.integers(1, 200), share=st.floats(0, 1))
def test_the_interval_is_wilsons(trials: int, share: float) -> None:
    successes = round(share * trials)
    rate = success_rate(
        [{"success": seed < successes} for seed in range(trials)]
    )
    low, high = wilson(successes, trials)
    assert rate.low == pytest.approx(max(low, 0), abs=1e-9)
    assert rate.high == pytest.approx(min(high, 1), abs=1e-9)
    assert 0 <= rate.low <= rate.value <= rate.high <= 1
    assert (rate.value, rate.heaps) == (successes / trials, trials)
    assert success_rate([]).heaps == 0
    assert math.isnan(success_rate([]).value)


def test_actions_are_of_successes_alone() -> None:
    assert actions(XRAY) == [2, 3, 7]
    assert action_quartiles(XRAY) == (2.5, 3.0, 5.0)
    assert np.isnan(action_quartiles(XRAY[3:])).all()
    assert success_within(XRAY, 8) == [0, 0.2, 0.4, 0.4, 0.4, 0.4, 0.6, 0.6]


def test_differences_are_of_heaps_that_both_searched() -> None:
    # Heaps 0 to 3: won, equal, equal, equal.
    difference = success_difference(XRAY, LARGEST)
    assert (difference.value, difference.heaps) == (0.25, 4)
    assert difference.low == 0 < difference.high <= 1
    # Both succeed on 1 and 2: −1 and +2 actions.
    fewer = action_difference(XRAY, LARGEST)
    assert (fewer.value, fewer.heaps) == (0.5, 2)
    assert (fewer.low, fewer.high) == (-1, 2)
    turned = success_difference(LARGEST, XRAY)
    assert turned.value == -0.25


@pytest.mark.parametrize(
    "others", [LARGEST[1:], [record("largest", 0, target="lid")]]
)
def test_without_common_heaps_there_is_no_difference(
    others: list[dict],
) -> None:
    """Heaps of other targets are other heaps."""
    difference = success_difference(XRAY[:1], others)
    assert difference.heaps == 0
    assert math.isnan(difference.value)


def test_the_bootstrap_is_scipys() -> None:
    rng = np.random.default_rng(2)
    ours, theirs = rng.random(120) < 0.8, rng.random(120) < 0.6
    found = bootstrap_mean(ours.astype(int) - theirs.astype(int))
    wanted = bootstrap(
        (ours.astype(float), theirs.astype(float)),
        lambda a, b, axis: a.mean(axis) - b.mean(axis),
        paired=True,
        vectorized=True,
        method="percentile",
    ).confidence_interval
    assert found.value == pytest.approx(ours.mean() - theirs.mean())
    # The spread of the means is 0.056; a bound's own error 0.002.
    assert found.low == pytest.approx(wanted.low, abs=0.012)
    assert found.high == pytest.approx(wanted.high, abs=0.012)


def test_the_bootstrap_does_not_depend_on_the_order() -> None:
    values = np.random.default_rng(0).integers(-3, 4, 50)
    assert bootstrap_mean(values) == bootstrap_mean(np.sort(values))
    assert bootstrap_mean(values) != bootstrap_mean(values, seed=1)


def test_each_heap_counts_once_in_how_targets_start() -> None:
    tilted = record("xray", 1, visible=0.5)
    tilted["start"]["target_tilt_deg"] = 9.0
    records = [
        record("xray", 0),
        record("largest", 0),
        tilted,
        record("xray", 2, visible=0.9),
        record("xray", 3, visible=0.91),
        failure("xray", 4),
    ]
    assert start_shares(records) == {
        "hidden": 0.25,
        "partly visible": 0.5,
        "more than 90 % visible": 0.25,
        "tilted by more than 5°": 0.25,
    }
    assert start_shares(records[-1:]) == {}
    kept = [(r["policy"], r["seed"]) for r in occluded(records)]
    assert ("xray", 2) in kept
    assert ("xray", 3) not in kept
    assert len(kept) == 5
    # A heap in view counts for none, nor for who failed before he looked.
    assert occluded([records[-2], failure("largest", 3)]) == []


def test_draws() -> None:
    first, second = record("xray", 0), record("xray", 1)
    first["start"] |= {"attempts": 4, "redrawn": 2}
    counts = draws([first, record("largest", 0), second, failure("xray", 2)])
    assert counts == {"drawn": 5, "visible": 2, "failed": 1}


def test_parts_by_hand() -> None:
    records = [
        record("xray", seed, visible=visible, cover=cover)
        for seed, (visible, cover) in enumerate(
            [(0.0, 400), (0.3, 200), (0.9, 1200), (0.0, 2000), (0.1, 3000)]
        )
    ]
    lone = record("xray", 5, visible=0.2, cover=0)
    found = {p.key: p for p in parts([*records, lone, failure("xray", 6)])}

    def seeds(key: str) -> set[int]:
        return {seed for _, seed in found[key].heaps}

    assert seeds("all") == {0, 1, 2, 3, 4, 5, 6}
    assert seeds("hidden") == {0, 3}
    assert seeds("partly_visible") == {1, 2, 4, 5}
    # Multiples 0.5, 1, 3, 5, 7.5 of the target's 400 pixels.
    assert seeds("cover_small") == {0, 1}
    assert seeds("cover_middle") == {2}
    assert seeds("cover_large") == {3, 4}
    assert found["cover_small"].title == "cover up to 1.7 ×"
    assert within(records, found["hidden"]) == [records[0], records[3]]


def test_parts_without_heaps_are_left_out() -> None:
    lone = record("xray", 5, visible=0.2, cover=0)
    assert [p.key for p in parts([lone])] == ["all", "partly_visible"]
    assert parts([failure("xray", 1)]) == [
        Part("all", "all", frozenset({(BOX, 1)}))
    ]


def test_the_first_decision_of_each_heap_says_what_the_support_held() -> None:
    records = [record("xray", seed) for seed in range(4)]
    for item, inside in zip(records, (1.0, 0.96, 0.5, 1.0), strict=True):
        item["actions"][0]["true_mask_in_support"] = inside
        item["actions"][1]["true_mask_in_support"] = 0.0
    assert containment(records) == (0.75, 0.5)
    assert containment(records, share=0.5) == (1.0, 0.5)
    assert np.isnan(containment([failure("xray", 1)])).all()


def test_times() -> None:
    records = [
        record("xray", 0, 1, cpu_seconds={"drop": 6.0, "rollout": 1.0}),
        record("largest", 0, 1, cpu_seconds={"drop": 6.0, "rollout": 3.0}),
        record("xray", 1, 3, cpu_seconds={"drop": 2.0, "rollout": 4.0}),
        failure("xray", 2),
    ]
    records[0]["actions"][0]["seconds"] = {"perception": 0.1, "planning": 0.4}
    found = values(records)
    assert found["core_seconds"] == pytest.approx(8 / 3)
    assert drop_seconds(records) == 4.0
    assert seconds_a_rollout(records) == pytest.approx((8 + 8) / 3)
    assert found["seconds_perception"] == pytest.approx((0.1 + 4 * 0.02) / 5)
    assert found["seconds_planning"] == 0.4
    assert found["seconds_occupancy"] == pytest.approx(0.03)
    assert math.isnan(seconds_a_rollout(records[-1:]))
    assert math.isnan(drop_seconds(records[-1:]))
    assert math.isnan(values(records[-1:])["core_seconds"])
    assert quantities([], 10) == {}


def test_ends_and_outcomes() -> None:
    ends = {k: n for k, n in values(XRAY).items() if k.startswith("end_")}
    assert ends == {"end_success": 3, "end_horizon": 1, "end_error": 1}
    records = [record("xray", 0, 3)]
    records[0]["actions"][1]["outcome"] = "failed"
    found = values([*records, failure("xray", 1)])
    assert (found["attempts_lifted"], found["attempts_failed"]) == (2, 1)


def test_causes_are_told_without_names_and_numbers() -> None:
    item = record("xray", 0, 3, objects=["book", "mug_003"])
    for action, outcome, reason in zip(
        item["actions"],
        ("failed", "slipped", "failed"),
        ("jaw hits book, mug_003", "holds 0.25 N, weighs 1 N", ""),
        strict=True,
    ):
        action |= {"outcome": outcome, "reason": reason}
    passed = "jaw: 12 too wide, 3 hit mug_003, 1 hit book; suction: 4 too wide"
    item["actions"][0]["ranking"] = [
        {"object": "book", "passed_over": passed},
        {"object": "mug_003", "passed_over": ""},
    ]
    assert causes([item, failure("xray", 1)]) == {
        "failed: jaw hits an object": 1,
        "slipped: holds … N, weighs … N": 1,
        "passed over: too wide": 1,
        "passed over: hit an object": 1,
    }
