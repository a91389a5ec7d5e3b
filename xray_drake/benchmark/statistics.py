"""What records of rollouts say: rates, intervals, and parts of the heaps.

Intervals of rates are Wilson's; those of differences between two variants are
percentile bootstraps that draw heaps, each with what both variants did on it.
"""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import binomtest

from xray_drake.benchmark.records import HeapKey, Record, heap_of
from xray_drake.seeding import stream

MOST_VISIBLE = 0.9
"""Heaps that show more of their target do not count (PROTOCOL.md)."""

_TILTED = 5.0
"""Degrees, from which on a target does not lie flat (PROTOCOL.md)."""

_RESAMPLES = 10_000


@dataclass(frozen=True)
class Estimate:
    """A mean and its 95 % interval; NaN without data.

    Attributes:
        value: over the heaps.
        low, high: bounds.
        heaps: how many.
    """

    value: float
    low: float
    high: float
    heaps: int


NONE = Estimate(np.nan, np.nan, np.nan, 0)
"""Of no heaps."""

QUARTILES = (
    "actions_lower_quartile",
    "actions_median",
    "actions_upper_quartile",
)
"""Names of :func:`action_quartiles`."""


@dataclass(frozen=True)
class Part:
    """Some of the heaps.

    Attributes:
        key: name in files.
        title: name in tables.
        heaps: which.
    """

    key: str
    title: str
    heaps: frozenset[HeapKey]


def quantities(records: Sequence[Record], horizon: int) -> dict[str, Estimate]:
    """Returns what records of one variant say, by the names of report.csv.

    What is no rate has no interval, and numbers of ends and attempts are whole.
    Empty without records.

    Args:
        records: of one variant, at most one each heap.
        horizon: actions at most.
    """
    if not records:
        return {}
    values: dict[str, float] = dict(
        zip(QUARTILES, action_quartiles(records), strict=True)
    )
    for k, value in enumerate(success_within(records, horizon), 1):
        values[f"success_within_{k}"] = value
    for prefix, counts in (
        ("end", Counter(record["end"] for record in records)),
        (
            "attempts",
            Counter(a["outcome"] for a in _actions(records) if "outcome" in a),
        ),
    ):
        values |= {f"{prefix}_{k}": n for k, n in sorted(counts.items())}
    stages: dict[str, list[float]] = {}
    for action in _actions(records):
        for stage, seconds in (action.get("seconds") or {}).items():
            stages.setdefault(stage, []).append(seconds)
    values |= {f"seconds_{s}": float(np.mean(t)) for s, t in stages.items()}
    values["core_seconds"] = _mean(
        [r["cpu_seconds"]["rollout"] for r in records if "cpu_seconds" in r]
    )
    return {"success_rate": success_rate(records)} | {
        name: Estimate(value, np.nan, np.nan, len(records))
        for name, value in values.items()
    }


def _actions(records: Sequence[Record]) -> list[dict[str, Any]]:
    return [a for record in records for a in record.get("actions", [])]


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else np.nan


def success_rate(records: Sequence[Record]) -> Estimate:
    """Returns the share of successes with Wilson's interval."""
    if not records:
        return NONE
    successes = sum(record["success"] for record in records)
    interval = binomtest(successes, len(records)).proportion_ci(method="wilson")
    return Estimate(
        successes / len(records),
        float(interval.low),
        float(interval.high),
        len(records),
    )


def actions(records: Sequence[Record]) -> list[int]:
    """Returns the numbers of actions of the successes, sorted."""
    return sorted(r["num_actions"] for r in records if r["success"])


def action_quartiles(records: Sequence[Record]) -> tuple[float, float, float]:
    """Returns the quartiles of :func:`actions`; NaN where there are none."""
    numbers = actions(records)
    if not numbers:
        return np.nan, np.nan, np.nan
    low, median, high = np.percentile(numbers, [25, 50, 75])
    return float(low), float(median), float(high)


def success_within(records: Sequence[Record], horizon: int) -> list[float]:
    """Returns the share of successes within 1, 2, … ``horizon`` actions."""
    numbers = np.array(actions(records))
    return [
        float(np.count_nonzero(numbers <= k) / len(records))
        for k in range(1, horizon + 1)
    ]


def bootstrap_mean(
    values: Sequence[float], *, resamples: int = _RESAMPLES, seed: int = 0
) -> Estimate:
    """Returns a mean with its percentile bootstrap interval.

    What is drawn is how often each distinct value occurs, which is a draw of
    the values themselves and does not depend on their order. Where all are
    the same the interval is a point: it does not speak for others.

    Args:
        values: one each heap.
        resamples: how often to draw.
        seed: of the draws.
    """
    if not len(values):
        return NONE
    distinct, counts = np.unique(np.asarray(values, float), return_counts=True)
    n = len(values)
    drawn = stream(seed, "bootstrap").multinomial(n, counts / n, resamples)
    low, high = np.percentile(drawn @ distinct / n, [2.5, 97.5])
    mean = float(counts @ distinct / n)
    return Estimate(mean, float(low), float(high), n)


def success_difference(
    records: Sequence[Record], others: Sequence[Record]
) -> Estimate:
    """Returns how much higher the success rate is, on heaps of both.

    Args:
        records: of one variant, at most one each heap.
        others: of another.
    """
    pairs = _pairs(records, others)
    return bootstrap_mean([a["success"] - b["success"] for a, b in pairs])


def action_difference(
    records: Sequence[Record], others: Sequence[Record]
) -> Estimate:
    """Returns how many actions more are taken, on heaps both succeed on."""
    return bootstrap_mean(
        [
            a["num_actions"] - b["num_actions"]
            for a, b in _pairs(records, others)
            if a["success"] and b["success"]
        ]
    )


def _pairs(
    records: Sequence[Record], others: Sequence[Record]
) -> list[tuple[Record, Record]]:
    by_heap = {heap_of(record): record for record in others}
    return [
        (record, by_heap[heap_of(record)])
        for record in records
        if heap_of(record) in by_heap
    ]


def starts(records: Sequence[Record]) -> dict[HeapKey, dict[str, float]]:
    """Returns how each heap started; those that failed are left out.

    Where several variants searched a heap, the first record tells.
    """
    found: dict[HeapKey, dict[str, float]] = {}
    for record in records:
        if "target_visible_fraction" in record.get("start", {}):
            found.setdefault(heap_of(record), record["start"])
    return found


def occluded(records: Sequence[Record]) -> list[Record]:
    """Leaves out heaps whose target starts more than 90 % visible.

    A heap that failed counts, for all variants alike: nothing is hidden.
    """
    seen = {
        heap
        for heap, start in starts(records).items()
        if start["target_visible_fraction"] > MOST_VISIBLE
    }
    return [record for record in records if heap_of(record) not in seen]


def start_shares(records: Sequence[Record]) -> dict[str, float]:
    """Returns how the heaps' targets start, as shares of the heaps.

    Args:
        records: of any variants; each heap counts once.

    Returns:
        ``hidden`` (no pixel visible), ``partly visible``, ``more than 90 %
        visible`` and ``tilted by more than 5°``; empty without heaps.
    """
    found = list(starts(records).values())
    if not found:
        return {}
    seen = np.array([start["target_visible_fraction"] for start in found])
    tilt = np.array([start["target_tilt_deg"] for start in found])
    partly = (seen > 0) & (seen <= MOST_VISIBLE)
    return {
        "hidden": float(np.mean(seen == 0)),
        "partly visible": float(np.mean(partly)),
        "more than 90 % visible": float(np.mean(seen > MOST_VISIBLE)),
        "tilted by more than 5°": float(np.mean(tilt > _TILTED)),
    }


def draws(records: Sequence[Record]) -> Counter[str]:
    """Counts the draws that the heaps took.

    Returns:
        ``drawn`` in all, ``visible``: those that showed too much of the target
        and were drawn again, and ``failed``: those that did not rest.
    """
    counts: Counter[str] = Counter()
    for start in starts(records).values():
        redrawn = int(start.get("redrawn", 0))
        attempts = int(start.get("attempts", 1))
        counts["drawn"] += attempts
        counts["visible"] += redrawn
        counts["failed"] += attempts - 1 - redrawn
    return counts


def parts(records: Sequence[Record]) -> list[Part]:
    """Returns all heaps, then parts of them by how their targets start.

    Hidden and partly visible ones; and thirds by how large a modal mask covers
    the target, in multiples of the target's own silhouette. Parts without
    heaps are left out.
    """
    found = starts(records)
    every = frozenset(heap_of(record) for record in records)
    hidden = frozenset(
        heap
        for heap, start in found.items()
        if start["target_visible_fraction"] == 0
    )
    result = [
        Part("all", "all", every),
        Part("hidden", "hidden", hidden),
        Part("partly_visible", "partly visible", frozenset(found) - hidden),
        *_thirds(found),
    ]
    return [part for part in result if part.heaps]


def _thirds(found: Mapping[HeapKey, Mapping[str, float]]) -> list[Part]:
    sizes = {
        heap: start["cover_pixels"] / start["target_pixels"]
        for heap, start in found.items()
        if start.get("cover_pixels", 0) > 0
    }
    if not sizes:
        return []
    low, high = np.quantile(list(sizes.values()), [1 / 3, 2 / 3])
    groups: dict[int, set[HeapKey]] = {0: set(), 1: set(), 2: set()}
    for heap, size in sizes.items():
        groups[int(size > low) + int(size > high)].add(heap)
    titles = {
        "cover_small": f"cover up to {low:.1f} ×",
        "cover_middle": f"cover {low:.1f} to {high:.1f} ×",
        "cover_large": f"cover over {high:.1f} ×",
    }
    return [
        Part(key, title, frozenset(groups[i]))
        for i, (key, title) in enumerate(titles.items())
    ]


def within(records: Sequence[Record], part: Part) -> list[Record]:
    """Returns the records of a part's heaps."""
    return [record for record in records if heap_of(record) in part.heaps]


def containment(
    records: Sequence[Record], *, share: float = 0.95
) -> tuple[float, float]:
    """Says how often inference kept the true place of the target inside.

    Args:
        records: with one inference; the first decision of each heap counts.
        share: of the true amodal mask that must lie in the support.

    Returns:
        Share of the heaps in which that much, and in which all of the mask
        lay in the support.
    """
    first: dict[HeapKey, float] = {}
    for record in records:
        for action in record.get("actions", [])[:1]:
            if "true_mask_in_support" in action:
                first.setdefault(
                    heap_of(record), action["true_mask_in_support"]
                )
    if not first:
        return np.nan, np.nan
    inside = np.array(list(first.values()))
    return float(np.mean(inside >= share)), float(np.mean(inside >= 1.0))


def drop_seconds(records: Sequence[Record]) -> float:
    """Returns the mean processor time of a heap's drop, redraws included, s.

    Args:
        records: of any variants; each heap counts once, by its first record.
    """
    return _mean([*_drops(records).values()])


def seconds_a_rollout(records: Sequence[Record]) -> float:
    """Returns the mean processor time of a rollout, s.

    Args:
        records: of all variants; a heap's drop counts once for all of them.
    """
    timed = [record for record in records if "cpu_seconds" in record]
    if not timed:
        return np.nan
    rollouts = sum(record["cpu_seconds"]["rollout"] for record in timed)
    return float((rollouts + sum(_drops(timed).values())) / len(timed))


def _drops(records: Sequence[Record]) -> dict[HeapKey, float]:
    drops: dict[HeapKey, float] = {}
    for record in records:
        if "cpu_seconds" in record:
            drops.setdefault(heap_of(record), record["cpu_seconds"]["drop"])
    return drops


def causes(records: Sequence[Record]) -> Counter[str]:
    """Counts why grasps failed, and why candidates were passed over.

    Objects and numbers are taken out of the words: "jaw hits an object". A
    candidate that was passed over counts once for each cause.
    """
    found: Counter[str] = Counter()
    for record in records:
        for action in record.get("actions", []):
            if action.get("reason"):
                cause = _cause(action["reason"], record)
                found[f"{action['outcome']}: {cause}"] += 1
            for candidate in action.get("ranking", []):
                parts = _PARTS.split(candidate["passed_over"])
                for cause in dict.fromkeys(_cause(p, record) for p in parts):
                    if cause:
                        found[f"passed over: {cause}"] += 1
    return found


_PARTS = re.compile("; |, (?=[0-9])|(?:jaw|suction): ")
_NUMBER = re.compile(r"[0-9]+(?:\.[0-9]+)?")
_NAMED = re.compile(r"[a-z]\w*_[0-9]\w*")


def _cause(text: str, record: Record) -> str:
    """Returns words without objects, and without numbers but for units."""
    own = {*record.get("objects", ()), record["target"]}
    words = re.sub(
        r"\w+",
        lambda m: (
            "an object" if m[0] in own or _NAMED.fullmatch(m[0]) else m[0]
        ),
        text,
    )
    words = words.replace("an object, an object", "an object")
    return _NUMBER.sub("…", re.sub("^[0-9]+ ", "", words))
