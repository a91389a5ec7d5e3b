"""Records of rollouts on disk: one folder, or several together."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from xray_drake.benchmark.paper import changes
from xray_drake.benchmark.variants import Variant
from xray_drake.choices import WITHOUT_NETWORK
from xray_drake.files import LinesError, read_json_lines
from xray_drake.scene.targets import is_mesh
from xray_drake.station.config import PerceptionConfig, PolicyConfig
from xray_drake.station.scenario import (
    Scenario,
    parse_scenario,
    record_scenario,
)

ROLLOUTS = "rollouts.jsonl"
SCENARIO = "scenario.yaml"

_KEYS = ("policy", "target", "seed", "end")
_SEED = re.compile(r"^seed: *(\d+) *$\n?", re.MULTILINE)

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
        changed: in what it is not the scenario of that name, a few words each.
        repeated: records that were left out, since their heap had been
            searched by the same variant before.
    """

    records: list[Record]
    scenario: str = ""
    changed: tuple[str, ...] = ()
    repeated: int = 0


def heap_of(record: Record) -> HeapKey:
    """Returns which heap a rollout searched."""
    return record["target"], record["seed"]


def shared_scenario(scenario: Scenario) -> str:
    """Returns a scenario as YAML, without what differs from rollout to rollout.

    That is the seed and what makes the variant.
    """
    return record_scenario(
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
    """Reads the records of a folder.

    A last line that was cut short is left out, with a warning.

    Args:
        folder: of a benchmark; without a file there are none.
        name: of the file.

    Raises:
        LinesError: another line cannot be read, or is no rollout.
    """
    path = folder / name
    records = read_json_lines(path)
    for number, record in enumerate(records, 1):
        missing = [key for key in _KEYS if key not in record]
        if missing:
            raise LinesError(
                f"{path}: record {number} is no rollout: it lacks "
                f"{', '.join(missing)}; take the line out"
            )
    return records


def check_records(
    folder: Path, records: Sequence[Record], scenario: str
) -> None:
    """Checks that records are of the scenario beside them.

    Args:
        folder: that they are from, for messages.
        records: of :func:`read_rollouts`; those that do not say their scenario
            are passed over.
        scenario: of :func:`shared_scenario`.

    Raises:
        ValueError: one is of another scenario, or another seed's or target's
            than it says.
    """
    wanted = _without_paths(scenario, str(folder / SCENARIO))
    for number, record in enumerate(records, 1):
        text = record.get("scenario")
        if not text:
            continue
        where = f"{folder / ROLLOUTS}: record {number}"
        seed = _SEED.search(text)
        own = int(seed[1]) if seed else Scenario().seed
        # Parsed once for all seeds.
        found = _without_paths(_SEED.sub("", text), where)
        if found != wanted or own != record["seed"]:
            raise ValueError(
                f"{where} is of another scenario than {SCENARIO}, or of "
                f"another seed than {record['seed']}: take the line out"
            )


@lru_cache(maxsize=256)
def _without_paths(text: str, source: str) -> str:
    """Returns a shared scenario; a record may name a file by another path."""
    scenario = parse_scenario(text or "{}", source, searched=False)
    meshes = [Path(path).name for path in scenario.scene.meshes]
    return shared_scenario(
        replace(
            scenario,
            scene=replace(scenario.scene, meshes=meshes),
            perception=replace(
                scenario.perception,
                weights=Path(scenario.perception.weights).name,
            ),
        )
    )


def in_order(records: Iterable[Record]) -> list[Record]:
    """Sorts records by variant, target and seed."""
    return sorted(records, key=lambda r: (Variant.of(r).order, heap_of(r)))


def collect(folders: Sequence[Path]) -> Collection:
    """Reads the records of several folders together.

    Where the same variant searched the same heap more than once, the first
    record counts.

    Raises:
        ValueError: a folder holds no rollouts, no readable scenario, or a
            record of another one; or two do not belong together: their heaps
            are not made in the same way, or one variant goes by two settings.
    """
    found: dict[tuple[Variant, HeapKey], Record] = {}
    settings: dict[Variant, tuple[str, Path]] = {}
    repeated, first = 0, None
    for folder in folders:
        records = read_rollouts(folder)
        path = folder / SCENARIO
        if not records or not path.is_file():
            raise ValueError(f"{folder} holds no rollouts of a benchmark")
        text = path.read_text(encoding="utf-8")
        scenario = parse_scenario(
            text, str(path), searched=False, folder=folder
        )
        check_records(folder, records, text)
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
        changed=changes(first[1]) if first else (),
        repeated=repeated,
    )


def _heaps_alone(scenario: Scenario) -> str:
    """Returns what all variants share, on heaps of any target."""
    scene = scenario.scene
    if not is_mesh(scene.target):
        scene = replace(scene, target=Scenario().scene.target)
    return shared_scenario(
        replace(
            scenario,
            scene=scene,
            policy=PolicyConfig(),
            perception=PerceptionConfig(),
        )
    )


def _settings(scenario: Scenario, variant: Variant) -> str:
    """Returns the settings of policy and perception that a variant uses."""
    defaults, perception = Scenario(), scenario.perception
    if variant.occupancy not in WITHOUT_NETWORK:
        perception = replace(
            perception, geometric=defaults.perception.geometric
        )
    if variant.occupancy in ("", *WITHOUT_NETWORK):
        perception = replace(
            perception,
            weights=defaults.perception.weights,
            dtype=defaults.perception.dtype,
        )
    return shared_scenario(
        replace(defaults, policy=scenario.policy, perception=perception)
    )
