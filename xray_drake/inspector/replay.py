"""Runs a search again, and keeps a snapshot of each decision."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pydrake.systems.framework import Context

from xray_drake.benchmark.records import ROLLOUTS, SCENARIO, read_rollouts
from xray_drake.benchmark.variants import Variant
from xray_drake.choices import current_occupancy
from xray_drake.inspector.snapshot import Snapshot, SnapshotRecorder
from xray_drake.provenance import versions
from xray_drake.scene.heap import Heap
from xray_drake.search.diagram import AGENT, SearchDiagram, build_search_diagram
from xray_drake.search.monitor import Observer, begin_search
from xray_drake.search.record import ActionRecord, SearchRecord
from xray_drake.search.rollout import run_search
from xray_drake.station.objects import make_heap
from xray_drake.station.scenario import (
    Scenario,
    parse_scenario,
)

Record = Mapping[str, Any]
"""A rollout as its JSON has it (DESIGN.md)."""

_KEYS = {"policy", "seed", "target", "objects", "actions"}

_FIRST_LOOK = 0.01
"""Simulated time until a policy has decided for the first time, s."""


_CANDIDATES = 5
"""So many of the ranking are planned for."""


@dataclass(frozen=True, eq=False)
class Replay:
    """A search with a snapshot of each decision.

    Attributes:
        scenario: of the search.
        heap: at the start.
        record: of what was run here.
        snapshots: of its decisions, in order; at least one.
    """

    scenario: Scenario
    heap: Heap
    record: SearchRecord
    snapshots: tuple[Snapshot, ...]

    @property
    def ended(self) -> bool:
        """The search went on to its end; else there is one decision."""
        return bool(self.record.end)


def first_decision(scenario: Scenario, heap: Heap) -> Replay:
    """Looks at a heap and decides, but does not act.

    Args:
        scenario: of the search.
        heap: what lies in the bin.
    """
    diagram = build_search_diagram(scenario, heap=heap)
    recorder = SnapshotRecorder(candidates=_CANDIDATES)
    simulator, monitor = begin_search(diagram, observers=(recorder,))
    simulator.AdvanceTo(_FIRST_LOOK)
    while not recorder.snapshots:
        simulator.AdvanceTo(simulator.get_context().get_time() + _FIRST_LOOK)
    return Replay(scenario, heap, monitor.record, tuple(recorder.snapshots))


def replay_search(
    scenario: Scenario,
    heap: Heap,
    *,
    progress: Callable[[float], None] | None = None,
) -> Replay:
    """Runs a search from start to end.

    Args:
        scenario: of the search; the same gives the same search.
        heap: what lies in the bin.
        progress: told the share of the horizon's actions that is done.

    Raises:
        RuntimeError: the simulation failed.
        KeyboardInterrupt: Ctrl-C.
    """
    diagram = build_search_diagram(scenario, heap=heap)
    recorder = SnapshotRecorder(candidates=_CANDIDATES)
    observers: tuple[Observer, ...] = (recorder,)
    if progress is not None:
        observers += (_Progress(scenario.horizon, progress),)
    record = run_search(diagram, observers=observers)
    if record.end == "interrupted":
        raise KeyboardInterrupt
    return Replay(scenario, heap, record, tuple(recorder.snapshots))


class _Progress(Observer):
    """Tells how far the search is."""

    def __init__(self, horizon: int, progress: Callable[[float], None]) -> None:
        self._horizon, self._progress = horizon, progress

    def ended(
        self, diagram: SearchDiagram, context: Context, record: ActionRecord
    ) -> None:
        self._progress(record.step / self._horizon)


@dataclass(frozen=True, eq=False)
class RecordedRollout:
    """A rollout that was recorded earlier.

    Attributes:
        record: as it was written.
        scenario: makes it again.
        source: the file, for messages.
    """

    record: Record
    scenario: Scenario
    source: str


def load_rollout(
    path: Path,
    *,
    index: int | None = None,
    policy: str | None = None,
    seed: int | None = None,
) -> RecordedRollout:
    """Reads a rollout that ``search --json`` or ``benchmark`` has recorded.

    Args:
        path: a record (JSON), a benchmark's ``rollouts.jsonl`` or its folder.
        index: of a benchmark's records this one, from 0.
        policy: of a benchmark's records the first of this policy …
        seed: … and of this seed.

    Raises:
        ValueError: no such record, one that tells too little to be made again,
            or none at all.
        OSError: the file cannot be read.
    """
    if path.is_dir():
        path = path / ROLLOUTS
    if not path.is_file():
        raise ValueError(f"there is no file {path}")
    wanted = {"number": index, "policy": policy, "seed": seed}
    wanted = {key: value for key, value in wanted.items() if value is not None}
    if path.suffix == ".jsonl":
        record = _choose(path, wanted)
    elif wanted:
        raise ValueError(
            f"{path} holds one rollout: --rollout, --policy and --seed choose "
            f"one of a benchmark's {ROLLOUTS}"
        )
    else:
        record = _read(path)
    if record["policy"] == AGENT:
        raise ValueError(
            f"{path}: the rollout of seed {record['seed']} is an agent's: the "
            "record does not hold what it would choose, so it cannot be "
            "made again"
        )
    return RecordedRollout(record, _scenario_of(record, path), str(path))


def _read(path: Path) -> Record:
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ValueError(f"{path} is not JSON: {error}") from error
    if not isinstance(record, dict) or not set(record) >= _KEYS:
        raise ValueError(
            f"{path} is no record of a rollout: 'xray-drake search --json "
            "FILE' writes one"
        )
    return record


def _choose(path: Path, wanted: Mapping[str, Any]) -> Record:
    records = read_rollouts(path.parent, path.name)
    if not records:
        raise ValueError(f"{path} holds no rollouts")
    if not 0 <= wanted.get("number", 0) < len(records):
        raise ValueError(
            f"{path} has no rollout {wanted['number']}: there are "
            f"{len(records)}, from 0"
        )
    found = [
        record
        for number, record in enumerate(records)
        if wanted == {key: (record | {"number": number})[key] for key in wanted}
    ]
    if not found:
        seeds = [record["seed"] for record in records]
        raise ValueError(
            f"{path} has no rollout of "
            f"{', '.join(f'{key} {value}' for key, value in wanted.items())}; "
            f"policies: {', '.join(sorted({r['policy'] for r in records}))}; "
            f"seeds: {min(seeds)} to {max(seeds)}"
        )
    if found[0]["end"] == "error":
        raise ValueError(
            f"{path}: the rollout of seed {found[0]['seed']} ended with an "
            f"error, so there is nothing to show: {found[0].get('reason', '')}"
        )
    return found[0]


def _scenario_of(record: Record, path: Path) -> Scenario:
    """Returns what makes a rollout again.

    Before records held it, a benchmark's was in the file beside them.
    """
    if record.get("scenario"):
        return parse_scenario(
            record["scenario"],
            f"the scenario in {path}",
            folder=path.parent,
        )
    shared = path.parent / SCENARIO
    if path.suffix != ".jsonl" or not shared.is_file():
        raise ValueError(
            f"{path} does not hold its scenario, since an older version wrote "
            "it: search again with 'xray-drake search --seed "
            f"{record['seed']} … --json FILE'"
        )
    scenario = parse_scenario(
        shared.read_text(encoding="utf-8"),
        str(shared),
        searched=False,
        folder=shared.parent,
    )
    variant = Variant(
        record["policy"],
        current_occupancy(record["occupancy"]),
        record.get("target_first", True),
    )
    return replace(
        variant.applied_to(scenario),
        seed=record["seed"],
        scene=replace(scenario.scene, target=record["target"]),
    )


def remake_heap(
    rollout: RecordedRollout,
    *,
    progress: Callable[[float], None] | None = None,
) -> Heap:
    """Drops the heap of a recorded rollout.

    Raises:
        ValueError: it is another heap than it was then.
        HeapError: heap after heap failed.
    """
    heap = make_heap(rollout.scenario, progress=progress)
    names = [model.name for model in heap.objects]
    if names != list(rollout.record["objects"]):
        raise ValueError(
            f"{rollout.source}: the heap of seed {heap.seed} comes out "
            f"otherwise than recorded{_versions_differ(rollout.record)}; "
            f"'xray-drake inspect --seed {heap.seed} …' shows what it is now"
        )
    return heap


def difference(record: Record, replayed: SearchRecord) -> str:
    """Says where a replay goes otherwise than the record; empty if nowhere.

    Args:
        record: of the rollout.
        replayed: of the replay.
    """
    then, now = record["actions"], replayed.to_dict()["actions"]
    for step, (a, b) in enumerate(zip(then, now, strict=False), start=1):
        for key in ("object", "outcome"):
            if a[key] != b[key]:
                return (
                    f"from step {step} on the replay differs from the record "
                    f"({key} {b[key] or 'none'}, not {a[key] or 'none'})"
                    f"{_versions_differ(record)}"
                )
    if len(then) != len(now) and record.get("end") != "interrupted":
        return (
            f"the replay took {len(now)} actions, not {len(then)} as recorded"
            f"{_versions_differ(record)}"
        )
    return ""


def _versions_differ(record: Record) -> str:
    """Names the versions that are not those of the record."""
    then = record.get("versions", {})
    changed = [
        f"{name} {then[name]}, now {version}"
        for name, version in versions().items()
        if then.get(name, version) != version
    ]
    return f": it was recorded with {', '.join(changed)}" if changed else ""
