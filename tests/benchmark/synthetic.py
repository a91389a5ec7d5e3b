"""Records as a benchmark writes them, without a simulation."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from xray_drake.benchmark.records import ROLLOUTS, SCENARIO, shared_scenario
from xray_drake.provenance import current
from xray_drake.station.scenario import Scenario, load_scenario

_ENDS = ("horizon", "target_lost", "nothing_graspable")


def record(
    policy: str,
    seed: int,
    num_actions: int = 3,
    end: str = "success",
    *,
    occupancy: str = "geometric",
    visible: float = 0.0,
    cover: int = 400,
    target: str = "box_2to1",
    **changes: Any,
) -> dict[str, Any]:
    """Returns the record of one rollout.

    Args:
        policy, seed, num_actions, end, occupancy, target: of the record.
        visible: fraction of the target at the start.
        cover: pixels of what covers it; its own silhouette has 400.
        **changes: further keys, or others in place of these.
    """
    return {
        "success": end == "success",
        "num_actions": num_actions,
        "horizon": 10,
        "policy": policy,
        "target_first": True,
        "occupancy": occupancy,
        "execution": "quasi_static",
        "seed": seed,
        "target": target,
        "objects": ["book"],
        "start": {
            "target_tilt_deg": 0.0,
            "num_dropped": 14,
            "attempts": 1,
            "redrawn": 0,
            "target_visible_fraction": visible,
            "target_pixels": 400,
            "cover_pixels": cover,
            "cover_fraction": 1 - visible,
            "num_covers": 1,
        },
        "actions": [
            {
                "step": step,
                "outcome": "lifted",
                "true_mask_in_support": 1.0,
                "seconds": {"perception": 0.02, "occupancy": 0.03},
            }
            for step in range(1, num_actions + 1)
        ],
        "end": end,
        **current().to_dict(),
        "cpu_seconds": {"drop": 4.0, "rollout": 2.0 + seed / 100},
        **changes,
    }


def failure(policy: str, seed: int, reason: str = "no rest") -> dict[str, Any]:
    """Returns the record of a heap that could not be dropped."""
    return {
        "success": False,
        "num_actions": 0,
        "horizon": 10,
        "policy": policy,
        "target_first": True,
        "occupancy": "geometric",
        "seed": seed,
        "target": "box_2to1",
        "end": "error",
        "reason": reason,
        **current().to_dict(),
    }


def many_records(heaps: int = 40) -> list[dict[str, Any]]:
    """Returns records of policies that differ, on the same heaps."""
    rng = np.random.default_rng(3)
    records = []
    for seed in range(heaps):
        visible = round(max(float(rng.uniform(-0.4, 0.9)), 0.0), 4)
        cover = int(rng.integers(150, 3000))
        for policy, occupancy, chance, steps in (
            ("random", "geometric", 0.45, 7.0),
            ("largest", "geometric", 0.65, 5.5),
            ("xray", "geometric", 0.8, 4.5),
            ("xray", "learned", 0.85, 4.0),
            ("oracle", "geometric", 0.9, 3.5),
        ):
            won = rng.random() < chance
            count = int(np.clip(rng.poisson(steps), 1, 10)) if won else 10
            end = "success" if won else str(rng.choice(_ENDS))
            starts = {"visible": visible, "cover": cover}
            found = record(
                policy, seed, count, end, occupancy=occupancy, **starts
            )
            records.append(found)
    return records


def write_folder(
    folder: Path,
    records: Iterable[dict[str, Any]],
    scenario: Scenario | None = None,
) -> Path:
    """Writes a folder as a benchmark leaves it."""
    folder.mkdir(parents=True)
    lines = [json.dumps(item) + "\n" for item in records]
    (folder / ROLLOUTS).write_text("".join(lines), encoding="utf-8")
    text = shared_scenario(scenario or load_scenario("demo"))
    (folder / SCENARIO).write_text(text, encoding="utf-8")
    return folder
