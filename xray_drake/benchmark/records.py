"""Records of rollouts on disk: one folder, or several together."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from xray_drake.benchmark.variants import Variant
from xray_drake.choices import WITHOUT_NETWORK
from xray_drake.station.scenario import (
    PerceptionConfig,
    PolicyConfig,
    Scenario,
    dump_scenario,
    parse_scenario,
)

ROLLOUTS = "rollouts.jsonl"
SCENARIO = "scenario.yaml"

HeapKey = tuple[str, int]
"""What makes a heap again under one scenario: target and seed."""

Record = dict[str, Any]
"""A rollout as DESIGN.md has it, and as a benchmark adds to it: ``reason``
where it ended with an error, ``cpu_seconds`` of ``drop`` and ``rollout``."""


@dataclass(frozen=True, eq=False)
class Collection:
    """The records of some folders.

    Attributes:
        records: by variant, target and seed, whatever order they came in.
        scenario: name of the scenario.
        repeated: records that were left out, since their heap had been
            searched by the same variant before.
    """

    records: list[Record]
    scenario: str = ""
    repeated: int = 0


def heap_of(record: Record) -> HeapKey:
    """Returns which heap a rollout searched."""
    return record["target"], record["seed"]


def shared_scenario(scenario: Scenario) -> str:
    """Returns a scenario as YAML, without what differs from rollout to rollout.

    That is the seed and what makes the variant.
    """
    return dump_scenario(
        replace(
            scenario,
            seed=0,
            policy=replace(
                scenario.policy,
                name=PolicyConfig().name,
                target_first=PolicyConfig().target_first,
            ),
            perception=replace(
                scenario.perception, occupancy=PerceptionConfig().occupancy
            ),
        )
    )


def check_folder(folder: Path, scenario: str) -> None:
    """Checks that a folder's rollouts are of this scenario.

    Args:
        folder: of a benchmark, or empty, or none.
        scenario: of :func:`shared_scenario`.

    Raises:
        ValueError: they are of another.
    """
    path = folder / SCENARIO
    if path.is_file() and path.read_text(encoding="utf-8") != scenario:
        raise ValueError(
            f"{folder} holds rollouts of another scenario: choose another "
            "--out, or remove it"
        )


def read_rollouts(folder: Path, name: str = ROLLOUTS) -> list[Record]:
    """Reads the records of a folder; a line cut short by a kill is left out.

    Args:
        folder: of a benchmark; without a file there are none.
        name: of the file.
    """
    path = folder / name
    if not path.is_file():
        return []
    records = []
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            records.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return records


def in_order(records: Iterable[Record]) -> list[Record]:
    """Sorts records by variant, target and seed."""
    return sorted(records, key=lambda r: (Variant.of(r).order, heap_of(r)))


def collect(folders: Sequence[Path]) -> Collection:
    """Reads the records of several folders together.

    Where the same variant searched the same heap more than once, the first
    record counts.

    Raises:
        ValueError: a folder holds no rollouts or no readable scenario, or two
            do not belong together: their heaps are not made in the same way,
            or one variant goes by two settings.
    """
    found: dict[tuple[Variant, HeapKey], Record] = {}
    settings: dict[Variant, tuple[str, Path]] = {}
    repeated, first = 0, None
    for folder in folders:
        records = read_rollouts(folder)
        path = folder / SCENARIO
        if not records or not path.is_file():
            raise ValueError(f"{folder} holds no rollouts of a benchmark")
        scenario = parse_scenario(
            path.read_text(encoding="utf-8"), str(path), searched=False
        )
        first = first or (folder, scenario)
        if _heaps_alone(scenario) != _heaps_alone(first[1]):
            raise ValueError(
                f"{first[0]} and {folder} are of different scenarios "
                f"({SCENARIO} in them): their heaps cannot be compared"
            )
        for record in records:
            variant = Variant.of(record)
            own = _settings(scenario, variant)
            known, where = settings.setdefault(variant, (own, folder))
            if own != known:
                raise ValueError(
                    f"{where} and {folder} both hold {variant.label}, with "
                    f"different settings ({SCENARIO} in them)"
                )
            key = variant, heap_of(record)
            repeated += key in found
            found.setdefault(key, record)
    return Collection(
        records=in_order(found.values()),
        scenario=first[1].name if first else "",
        repeated=repeated,
    )


def _heaps_alone(scenario: Scenario) -> str:
    """Returns what all variants share, on heaps of any target."""
    return shared_scenario(
        replace(
            scenario,
            scene=replace(scenario.scene, target=Scenario().scene.target),
            policy=PolicyConfig(),
            perception=PerceptionConfig(),
        )
    )


def _settings(scenario: Scenario, variant: Variant) -> str:
    """Returns the settings of policy and perception that a variant uses."""
    defaults, perception = Scenario(), scenario.perception
    if variant.occupancy not in WITHOUT_NETWORK:
        perception = replace(perception, exact=defaults.perception.exact)
    if variant.occupancy in ("", *WITHOUT_NETWORK):
        perception = replace(
            perception,
            weights=defaults.perception.weights,
            dtype=defaults.perception.dtype,
        )
    return shared_scenario(
        replace(defaults, policy=scenario.policy, perception=perception)
    )
