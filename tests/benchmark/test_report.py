import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from xray_drake.benchmark.report import (
    containment,
    occluded,
    start_shares,
    summarize,
    table,
)


def record(
    policy: str,
    seed: int,
    end: str,
    num_actions: int,
    *,
    visible: float = 0.0,
    tilt: float = 0.0,
    inside: float = 1.0,
) -> dict:
    return {
        "policy": policy,
        "seed": seed,
        "end": end,
        "success": end == "success",
        "num_actions": num_actions,
        "start": {"target_visible_fraction": visible, "target_tilt_deg": tilt},
        "actions": [
            {"true_mask_in_support": inside},
            {"true_mask_in_support": 0.0},
        ],
    }


RECORDS = [
    record("xray", 0, "success", 2, visible=0.0),
    record("xray", 1, "success", 3, visible=0.5, tilt=9.0, inside=0.96),
    record("xray", 2, "success", 7, visible=0.9, inside=0.5),
    record("xray", 3, "horizon", 10, visible=0.95),
    record("largest", 0, "horizon", 10, visible=0.0),
    record("largest", 1, "horizon", 10, visible=0.5, tilt=9.0, inside=0.96),
    record("largest", 2, "target_lost", 4, visible=0.9, inside=0.5),
    {
        "policy": "largest",
        "seed": 4,
        "end": "error",
        "reason": "heap after heap failed",
        "success": False,
        "num_actions": 0,
    },
]


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """The interval's closed form (Wilson 1927) at 95 %."""
    z, n, p = 1.959963984540054, trials, successes / trials
    center = (p + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * math.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    return center - half, center + half


def test_summaries_by_hand() -> None:
    xray, largest = summarize(RECORDS)
    assert (xray.policy, xray.rollouts, xray.successes) == ("xray", 4, 3)
    assert xray.rate == 0.75
    # Of 2, 3, 7: the failure at 10 actions does not count.
    assert xray.quartiles == (2.5, 3.0, 5.0)
    assert xray.ends == {"success": 3, "horizon": 1}
    assert (xray.low, xray.high) == pytest.approx(wilson(3, 4))

    assert (largest.policy, largest.rollouts) == ("largest", 4)
    assert largest.rate == largest.successes == 0
    assert np.isnan(largest.quartiles).all()
    # A heap that failed counts as a rollout, so that nothing is left out.
    assert largest.ends == {"horizon": 2, "target_lost": 1, "error": 1}
    assert (largest.low, largest.high) == pytest.approx(wilson(0, 4))


def test_policies_stand_in_the_order_of_their_first_record() -> None:
    names = [summary.policy for summary in summarize(RECORDS[::-1])]
    assert names == ["largest", "xray"]
    assert summarize([]) == []


@given(trials=st.integers(1, 200), share=st.floats(0, 1))
def test_the_interval_is_wilsons(trials: int, share: float) -> None:
    successes = round(share * trials)
    records = [
        record("xray", seed, "success" if seed < successes else "horizon", 5)
        for seed in range(trials)
    ]
    (summary,) = summarize(records)
    low, high = wilson(successes, trials)
    assert summary.low == pytest.approx(max(low, 0), abs=1e-9)
    assert summary.high == pytest.approx(min(high, 1), abs=1e-9)
    assert 0 <= summary.low <= summary.rate <= summary.high <= 1


def test_each_heap_counts_once_in_how_targets_start() -> None:
    # Seeds 0 to 3; seed 4 never became a heap.
    assert start_shares(RECORDS) == {
        "hidden": 0.25,
        "partial": 0.5,
        "visible": 0.25,
        "tilted": 0.25,
    }
    assert start_shares(RECORDS[-1:]) == {}


def test_the_first_decision_of_each_heap_says_what_the_support_held() -> None:
    # Seeds 0 to 3: all, 96 %, half, all.
    assert containment(RECORDS) == (0.75, 0.5)
    assert containment(RECORDS, share=0.5) == (1.0, 0.5)
    assert np.isnan(containment(RECORDS[-1:])).all()


def test_a_target_in_full_view_is_not_occluded() -> None:
    kept = [(r["policy"], r["seed"]) for r in occluded(RECORDS)]
    assert ("xray", 2) in kept
    assert ("xray", 3) not in kept
    assert len(kept) == len(RECORDS) - 1
    assert occluded([]) == []


def test_the_table_is_markdown() -> None:
    lines = table(RECORDS).splitlines()
    rows = [line for line in lines if line.startswith("|")]
    assert len({row.count("|") for row in rows}) == 1
    cells = [[c.strip() for c in row.strip("|").split("|")] for row in rows]
    # A table of all heaps, then one without seed 3.
    assert cells[0] == cells[4]
    assert cells[2] == [
        "xray",
        "75% of 4",
        "30% to 95%",
        "2.5, 3, 5",
        "success 3, horizon 1",
    ]
    assert cells[6][:2] == ["xray", "100% of 3"]
    for row in (cells[3], cells[7]):
        assert row[:2] == ["largest", "0% of 4"]
        assert "error 1" in row[-1]
    text = " ".join(lines)
    assert "hidden 25%" in text
    assert "in 75% of the heaps, all of it in 50%" in text
