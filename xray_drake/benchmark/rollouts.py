"""Runs policies on the same heaps, over processes, resumably."""

import gc
import logging
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from xray_drake.benchmark.records import (
    ROLLOUTS,
    SCENARIO,
    Record,
    check_folder,
    check_records,
    heap_of,
    read_rollouts,
    shared_scenario,
)
from xray_drake.benchmark.variants import Variant
from xray_drake.faults import BREAKDOWNS, is_fault, one_line
from xray_drake.files import (
    append_json_lines,
    remove_leftovers,
    sole_writer,
    write_whole_file,
)
from xray_drake.policy.registry import POLICIES, Policy, for_workers
from xray_drake.processes import Lost, run_jobs
from xray_drake.provenance import (
    Provenance,
    Run,
    check_resumable,
    record_run,
)
from xray_drake.station.objects import name_of_target
from xray_drake.station.provenance import scenario_provenance
from xray_drake.station.scenario import (
    Scenario,
    parse_scenario,
    record_scenario,
)

_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Job:
    """All variants on one heap.

    Attributes:
        scenario: as YAML; seed, policy and occupancy are replaced.
        seed: of the heap.
        variants: not done yet.
        policies: those that a worker does not know.
    """

    scenario: str
    seed: int
    variants: tuple[Variant, ...]
    policies: Mapping[str, Policy] = field(default_factory=dict)


def run_job(job: Job) -> Iterator[Record]:
    """Drops a heap once and runs each variant on it, in a worker process.

    Variants that begin with the same grasps share the simulation of those.

    Yields:
        The record of each variant as it ends. A heap that cannot be dropped,
        or a rollout that fails, gives records with ``end`` set to "error" and
        a ``reason``.

    Raises:
        KeyboardInterrupt: Ctrl-C.
    """
    # Imported in the worker, after its threads are limited.
    from xray_drake.search.diagram import build_search_diagram
    from xray_drake.search.rollout import run_search
    from xray_drake.search.transitions import Transitions
    from xray_drake.station.objects import make_heap

    for name, policy in job.policies.items():
        POLICIES.register(name, policy)
    scenario = parse_scenario(job.scenario, "benchmark")
    scenario.seed = job.seed
    start = time.process_time()
    try:
        heap = make_heap(scenario)
    except BREAKDOWNS as error:
        reason = _told(error)
        for variant in job.variants:
            yield _failure(scenario, variant, reason)
        return
    dropped = time.process_time() - start
    by_contact = scenario.gripper.execution == "contact"
    transitions = None if by_contact else Transitions()
    for variant in job.variants:
        start = time.process_time()
        try:
            diagram = build_search_diagram(
                variant.applied_to(scenario), heap=heap
            )
            record = run_search(diagram, transitions=transitions).to_dict()
        except BREAKDOWNS as error:
            record = _failure(scenario, variant, _told(error))
        if record["end"] == "interrupted":
            raise KeyboardInterrupt
        record["cpu_seconds"] = {
            "drop": round(dropped, 3),
            "rollout": round(time.process_time() - start, 3),
        }
        yield record
        gc.collect()


def run_rollouts(
    scenario: Scenario,
    *,
    variants: Sequence[Variant],
    seeds: Sequence[int],
    folder: Path,
    workers: int,
    mix: bool = False,
) -> Iterator[Record]:
    """Runs every variant on the same heaps and yields each record as it ends.

    Each record is a line of ``folder/rollouts.jsonl``, written as it comes.
    What the file already holds is not run again.

    Args:
        scenario: seed and policy are replaced, and the inference where the
            policy looks at the distribution.
        variants: what to compare.
        seeds: one heap each.
        folder: made if it does not exist.
        workers: processes at a time; each uses one thread.

        mix: go on with what other code, versions or weights have made.

    Raises:
        ValueError: see :func:`begun`; or another process writes there.
        OSError: it cannot be written.
        RuntimeError: a worker failed otherwise than by its simulation.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with sole_writer(folder):
        records = begun(folder, scenario, variants, mix=mix)
        remove_leftovers(folder)
        write_whole_file(folder / SCENARIO, shared_scenario(scenario).encode())
        text, target = record_scenario(scenario), name_of_target(scenario)
        run = Run(
            "benchmark",
            _provenance(scenario, variants),
            text,
            seeds,
            {"variants": [variant.label for variant in variants]},
        )
        record_run(folder, run, resumed=bool(records))
        done = {(Variant.of(r), heap_of(r)) for r in records}
        policies = for_workers(v.policy for v in variants)
        jobs = []
        for seed in seeds:
            missing = tuple(
                v for v in variants if (v, (target, seed)) not in done
            )
            if missing:
                jobs.append(Job(text, seed, missing, policies))
        with append_json_lines(folder / ROLLOUTS) as add:
            for record in _run_jobs(jobs, workers):
                add(record)
                yield record


def begun(
    folder: Path,
    scenario: Scenario,
    variants: Sequence[Variant],
    *,
    mix: bool = False,
) -> list[Record]:
    """Returns what a folder holds of a benchmark that is to go on.

    Args:
        folder: of the benchmark; it need not be there.
        scenario: as :func:`run_rollouts` takes it.
        variants: what is to be compared.
        mix: see :func:`run_rollouts`.

    Raises:
        ValueError: it holds rollouts of another scenario, or a line that
            cannot be read; or other code, versions or weights made them, and
            they are not to be mixed.
    """
    shared = shared_scenario(scenario)
    check_folder(folder, shared)
    records = read_rollouts(folder)
    check_records(folder, records, shared)
    if records:
        check_resumable(
            folder,
            _provenance(scenario, variants),
            made_by=map(Provenance.from_dict, records),
            mix=mix,
        )
    return records


def _provenance(scenario: Scenario, variants: Sequence[Variant]) -> Provenance:
    return scenario_provenance(
        scenario,
        {v.applied_to(scenario).perception.occupancy for v in variants},
    )


def _run_jobs(jobs: Sequence[Job], workers: int) -> Iterator[Record]:
    """Runs jobs, each in a process of its own.

    With Drake before 1.58 each rollout leaves some 45 MB behind: diagrams with
    systems in Python are never freed there.
    """
    for _, record in run_jobs(
        run_job,
        jobs,
        workers=workers,
        preload=["xray_drake.search.rollout"],
        lost=_lost,
        remaining=_remaining,
    ):
        yield record


def _lost(lost: Lost[Job]) -> Record:
    """Returns the record of a rollout whose process died."""
    job = lost.job
    if lost.cause != "died":
        raise lost.error(f"heap of seed {job.seed}")
    scenario = parse_scenario(job.scenario, "benchmark")
    scenario.seed = job.seed
    return _failure(scenario, job.variants[0], lost.reason)


def _remaining(job: Job, record: Record) -> Job | None:
    left = tuple(v for v in job.variants if v != Variant.of(record))
    return replace(job, variants=left) if left else None


def _failure(scenario: Scenario, variant: Variant, reason: str) -> Record:
    run = variant.applied_to(scenario)
    return {
        "success": False,
        "num_actions": 0,
        "horizon": run.horizon,
        "policy": variant.policy,
        "target_first": variant.target_first,
        "occupancy": variant.occupancy,
        "seed": run.seed,
        "target": name_of_target(run),
        "end": "error",
        "reason": reason,
        "scenario": record_scenario(run),
        **scenario_provenance(run).to_dict(),
    }


def _told(error: BaseException) -> str:
    """Returns an error in one line; the traceback of a fault is logged."""
    if is_fault(error):
        _logger.error("", exc_info=error)
    return one_line(error)
