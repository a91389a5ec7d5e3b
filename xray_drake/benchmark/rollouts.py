"""Runs policies on the same heaps, over processes, resumably."""

import gc
import json
import multiprocessing
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path

from xray_drake.benchmark.records import (
    ROLLOUTS,
    SCENARIO,
    Record,
    check_folder,
    heap_of,
    read_rollouts,
    shared_scenario,
)
from xray_drake.benchmark.variants import Variant
from xray_drake.files import write_whole_file
from xray_drake.station.scenario import Scenario, dump_scenario, parse_scenario
from xray_drake.threads import limit_threads

_ATTEMPTS = 2
"""How often a rollout is tried whose process dies (killed for memory, say)."""


@dataclass(frozen=True)
class Job:
    """All variants on one heap.

    Attributes:
        scenario: as YAML; seed, policy and occupancy are replaced.
        seed: of the heap.
        variants: not done yet.
    """

    scenario: str
    seed: int
    variants: tuple[Variant, ...]


def run_job(job: Job) -> Iterator[Record]:
    """Drops a heap once and runs each variant on it, in a worker process.

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
    from xray_drake.station.objects import make_heap

    scenario = parse_scenario(job.scenario, "benchmark")
    scenario.seed = job.seed
    start = time.process_time()
    try:
        heap = make_heap(scenario)
    except RuntimeError as error:
        for variant in job.variants:
            yield _failure(scenario, variant, error)
        return
    dropped = time.process_time() - start
    for variant in job.variants:
        start = time.process_time()
        try:
            diagram = build_search_diagram(
                _configured(scenario, variant), heap=heap
            )
            record = run_search(diagram).to_dict()
        except RuntimeError as error:
            record = _failure(scenario, variant, error)
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

    Raises:
        ValueError: the folder holds rollouts of another scenario.
        OSError: it cannot be written.
        RuntimeError: a worker failed otherwise than by its simulation.
    """
    shared = shared_scenario(scenario)
    folder.mkdir(parents=True, exist_ok=True)
    check_folder(folder, shared)
    (folder / SCENARIO).write_text(shared, encoding="utf-8")
    records = read_rollouts(folder)
    # Without a line cut short, to which the next record would be added.
    lines = [json.dumps(record) + "\n" for record in records]
    write_whole_file(folder / ROLLOUTS, "".join(lines).encode())
    text, target = dump_scenario(scenario), scenario.scene.target
    done = {(Variant.of(r), heap_of(r)) for r in records}
    jobs = []
    for seed in seeds:
        missing = tuple(v for v in variants if (v, (target, seed)) not in done)
        if missing:
            jobs.append(Job(text, seed, missing))
    with (folder / ROLLOUTS).open("a", encoding="utf-8") as file:
        for record in _run_jobs(jobs, workers):
            file.write(json.dumps(record) + "\n")
            file.flush()
            yield record


def _run_jobs(jobs: Sequence[Job], workers: int) -> Iterator[Record]:
    """Runs jobs, each in a process of its own.

    A process ends with its heap, so that memory does not grow: each rollout
    leaves some 90 MB, since diagrams with systems in Python are in reference
    cycles through C++.
    """
    limit_threads()  # the workers', which inherit it
    context = multiprocessing.get_context("forkserver")
    # Forked from a server that has imported everything, a process starts at
    # once; one that is spawned takes seconds.
    context.set_forkserver_preload(["xray_drake.search.rollout"])
    waiting = [(job, 1) for job in reversed(jobs)]
    running: dict[Connection, tuple[BaseProcess, Job, int]] = {}
    with ExitStack() as stack:
        stack.callback(_stop, running)
        while waiting or running:
            while waiting and len(running) < workers:
                job, attempt = waiting.pop()
                receiver, sender = context.Pipe(duplex=False)
                process: BaseProcess = context.Process(
                    target=_work, args=(job, sender)
                )
                process.start()
                sender.close()
                running[receiver] = process, job, attempt
            for ready in wait(list(running)):
                assert isinstance(ready, Connection)
                process, job, attempt = running[ready]
                try:
                    message = ready.recv()
                except EOFError:
                    message = None
                if isinstance(message, dict):
                    left = tuple(
                        v for v in job.variants if v != Variant.of(message)
                    )
                    running[ready] = process, replace(job, variants=left), 1
                    yield message
                    continue
                del running[ready]
                ready.close()
                process.join()
                if isinstance(message, str):
                    raise RuntimeError(f"heap of seed {job.seed}: {message}")
                if process.exitcode == 0 or not job.variants:
                    continue
                if attempt < _ATTEMPTS:
                    waiting.append((job, attempt + 1))
                    continue
                first, *others = job.variants
                yield _failure(
                    parse_scenario(job.scenario, "benchmark"),
                    first,
                    f"its process died with status {process.exitcode} "
                    f"{attempt} times",
                    seed=job.seed,
                )
                if others:
                    waiting.append((replace(job, variants=tuple(others)), 1))


def _work(job: Job, sender: Connection) -> None:
    # What is imported stays: the collector need not look at it.
    gc.freeze()
    try:
        for record in run_job(job):
            sender.send(record)
    except KeyboardInterrupt:
        return
    except Exception as error:
        reason = " ".join(str(error).split())
        sender.send(f"{type(error).__name__}: {reason}")
        raise


def _stop(running: dict[Connection, tuple[BaseProcess, Job, int]]) -> None:
    for process, *_ in running.values():
        process.terminate()
    for process, *_ in running.values():
        process.join()


def _configured(scenario: Scenario, variant: Variant) -> Scenario:
    perception = scenario.perception
    if variant.occupancy:
        perception = replace(perception, occupancy=variant.occupancy)
    return replace(
        scenario,
        policy=replace(
            scenario.policy,
            name=variant.policy,
            target_first=variant.target_first,
        ),
        perception=perception,
    )


def _failure(
    scenario: Scenario,
    variant: Variant,
    reason: object,
    *,
    seed: int | None = None,
) -> Record:
    return {
        "success": False,
        "num_actions": 0,
        "horizon": scenario.horizon,
        "policy": variant.policy,
        "target_first": variant.target_first,
        "occupancy": variant.occupancy,
        "seed": scenario.seed if seed is None else seed,
        "target": scenario.scene.target,
        "end": "error",
        "reason": " ".join(str(reason).split()),
    }
