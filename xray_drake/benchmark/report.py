"""What many rollouts say: the paper's Table II."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import binomtest


@dataclass(frozen=True)
class PolicySummary:
    """How one policy did.

    Attributes:
        policy: its name.
        rollouts: how many, errors included.
        successes: how many found the target.
        low, high: Wilson 95 % interval of the success rate.
        quartiles: of the number of actions over successes; NaN without any.
        ends: end to how many rollouts.
    """

    policy: str
    rollouts: int
    successes: int
    low: float
    high: float
    quartiles: tuple[float, float, float]
    ends: dict[str, int]

    @property
    def rate(self) -> float:
        """Share of successes."""
        return self.successes / self.rollouts


def summarize(records: Sequence[dict[str, Any]]) -> list[PolicySummary]:
    """Summarises records by policy, in the order of their first record."""
    summaries = []
    for policy in dict.fromkeys(record["policy"] for record in records):
        own = [record for record in records if record["policy"] == policy]
        actions = [r["num_actions"] for r in own if r["success"]]
        interval = binomtest(len(actions), len(own)).proportion_ci(
            method="wilson"
        )
        quartiles = (
            np.percentile(actions, [25, 50, 75]) if actions else [np.nan] * 3
        )
        ends = [record["end"] for record in own]
        summaries.append(
            PolicySummary(
                policy=policy,
                rollouts=len(own),
                successes=len(actions),
                low=float(interval.low),
                high=float(interval.high),
                quartiles=(
                    float(quartiles[0]),
                    float(quartiles[1]),
                    float(quartiles[2]),
                ),
                ends={end: ends.count(end) for end in dict.fromkeys(ends)},
            )
        )
    return summaries


def start_shares(records: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Returns how the heaps' targets start: shares of the heaps.

    Args:
        records: of any policies; each heap counts once.

    Returns:
        ``hidden`` (no pixel visible), ``partial``, ``visible`` (more than 90 %
        visible: such heaps do not count as occluded) and ``tilted`` (by more
        than 5°).
    """
    heaps = {
        record["seed"]: record["start"]
        for record in records
        if "target_visible_fraction" in record.get("start", {})
    }
    if not heaps:
        return {}
    seen = np.array([s["target_visible_fraction"] for s in heaps.values()])
    tilt = np.array([s["target_tilt_deg"] for s in heaps.values()])
    return {
        "hidden": float(np.mean(seen == 0)),
        "partial": float(np.mean((seen > 0) & (seen <= 0.9))),
        "visible": float(np.mean(seen > 0.9)),
        "tilted": float(np.mean(tilt > 5)),
    }


def containment(
    records: Sequence[dict[str, Any]], *, share: float = 0.95
) -> tuple[float, float]:
    """Says how often inference kept the true place of the target inside.

    Args:
        records: of any policies; the first decision of each heap counts.
        share: of the true amodal mask that must lie in the support.

    Returns:
        Share of the heaps in which that much, and in which all of the mask
        lay in the support.
    """
    first = {
        r["seed"]: r["actions"][0].get("true_mask_in_support")
        for r in records
        if r.get("actions")
    }
    inside = np.array([share for share in first.values() if share is not None])
    if not inside.size:
        return float("nan"), float("nan")
    return float(np.mean(inside >= share)), float(np.mean(inside >= 1.0))


def occluded(
    records: Sequence[dict[str, Any]], *, visible: float = 0.9
) -> list[dict[str, Any]]:
    """Returns the records whose target starts at most this visible."""
    return [
        r
        for r in records
        if r.get("start", {}).get("target_visible_fraction", 0.0) <= visible
    ]


def table(records: Sequence[dict[str, Any]]) -> str:
    """Returns the paper's Table II as Markdown.

    All heaps, then those that count as occluded (at most 90 % visible), then
    how they start and how often the true place was in the support.
    """
    some, whole = containment(records)
    shares = ", ".join(
        f"{name} {share:.0%}" for name, share in start_shares(records).items()
    )
    return "\n".join(
        [
            "All heaps:",
            "",
            *_rows(records),
            "",
            "Heaps whose target starts at most 90 % visible:",
            "",
            *_rows(occluded(records)),
            "",
            f"Targets at the start: {shares}.",
            "",
            f"The support held at least 95 % of the target's true amodal mask "
            f"in {some:.0%} of the heaps, all of it in {whole:.0%}.",
        ]
    )


def _rows(records: Sequence[dict[str, Any]]) -> list[str]:
    lines = [
        "| policy | success rate | 95 % interval | actions, quartiles | ends |",
        "|---|---|---|---|---|",
    ]
    for s in summarize(records):
        quartiles = ", ".join(f"{q:g}" for q in s.quartiles)
        ends = ", ".join(f"{end} {count}" for end, count in s.ends.items())
        lines.append(
            f"| {s.policy} | {s.rate:.0%} of {s.rollouts} | "
            f"{s.low:.0%} to {s.high:.0%} | {quartiles} | {ends} |"
        )
    return lines
