"""Runs policies on the same heaps, over processes, resumably."""

import gc
import json
import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from xray_drake.files import write_whole_file
from xray_drake.station.scenario import Scenario, dump_scenario, parse_scenario
from xray_drake.threads import limit_threads

ROLLOUTS = "rollouts.jsonl"
SCENARIO = "scenario.yaml"

_HEAPS_PER_WORKER = 4
"""Then the worker processes are replaced: each rollout leaves some 90 MB, since
diagrams with systems in Python are in reference cycles through C++."""


@dataclass(frozen=True)
class Job:
    """All policies on one heap.

    Attributes:
        scenario: as YAML.
        seed: of the heap.
        policies: not done yet.
    """

    scenario: str
    seed: int
    policies: tuple[str, ...]


def run_job(job: Job) -> list[dict[str, Any]]:
    """Drops a heap once and runs each policy on it, in a worker process.

    Returns:
        One record a policy. A heap that cannot be dropped, or a rollout that
        fails, gives records with ``end`` set to "error" and a ``reason``.
    """
    # Imported in the worker, after its threads are limited.
    from xray_drake.search.diagram import build_search_diagram
    from xray_drake.search.rollout import run_search
    from xray_drake.station.objects import make_heap

    scenario = parse_scenario(job.scenario, "benchmark")
    scenario.seed = job.seed
    heap, records = None, []
    for policy in job.policies:
        scenario.policy.name = policy
        try:
            if heap is None:
                heap = make_heap(scenario)
            diagram = build_search_diagram(scenario, heap=heap)
            record = run_search(diagram).to_dict()
        except RuntimeError as error:
            reason = " ".join(str(error).split())
            record = {
                "seed": job.seed,
                "policy": policy,
                "target": scenario.scene.target,
                "success": False,
                "num_actions": 0,
                "end": "error",
                "reason": reason,
            }
        records.append(record)
        gc.collect()
    return records


def run_rollouts(
    scenario: Scenario,
    *,
    policies: Sequence[str],
    seeds: Sequence[int],
    folder: Path,
    workers: int,
) -> Iterator[dict[str, Any]]:
    """Runs every policy on the same heaps and yields each record as it ends.

    Each record is a line of ``folder/rollouts.jsonl``, written as it comes.
    What the file already holds is not run again.

    Args:
        scenario: seed and policy are replaced.
        policies: names of rankings.
        seeds: one heap each.
        folder: made if it does not exist.
        workers: processes; each uses one thread.

    Raises:
        ValueError: the folder holds rollouts of another scenario.
        OSError: it cannot be written.
    """
    text = dump_scenario(scenario)
    folder.mkdir(parents=True, exist_ok=True)
    check_folder(folder, text)
    (folder / SCENARIO).write_text(text, encoding="utf-8")
    records = read_rollouts(folder)
    # Without a line cut short, to which the next record would be added.
    lines = [json.dumps(record) + "\n" for record in records]
    write_whole_file(folder / ROLLOUTS, "".join(lines).encode())
    done = {(r["seed"], r["policy"]) for r in records}
    jobs = []
    for seed in seeds:
        missing = tuple(p for p in policies if (seed, p) not in done)
        if missing:
            jobs.append(Job(text, seed, missing))
    limit_threads()  # the workers', which inherit it
    batch = workers * _HEAPS_PER_WORKER
    with (folder / ROLLOUTS).open("a", encoding="utf-8") as file:
        for start in range(0, len(jobs), batch):
            for record in _run_batch(jobs[start : start + batch], workers):
                file.write(json.dumps(record) + "\n")
                file.flush()
                yield record


def _run_batch(jobs: Sequence[Job], workers: int) -> Iterator[dict[str, Any]]:
    """Runs jobs in processes that end with the batch.

    ``max_tasks_per_child`` would free the memory too, but Python 3.11's
    executor hangs when it replaces a worker.
    """
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        futures = [pool.submit(run_job, job) for job in jobs]
        try:
            for future in as_completed(futures):
                yield from future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def check_folder(folder: Path, scenario: str) -> None:
    """Checks that a folder's rollouts are of this scenario.

    Raises:
        ValueError: they are of another.
    """
    path = folder / SCENARIO
    if path.is_file() and path.read_text(encoding="utf-8") != scenario:
        raise ValueError(
            f"{folder} holds rollouts of another scenario: choose another "
            "--out, or remove it"
        )


def read_rollouts(folder: Path) -> list[dict[str, Any]]:
    """Reads the records of a folder; a line cut short by a kill is left out.

    Args:
        folder: of :func:`run_rollouts`; without a file there are none.
    """
    path = folder / ROLLOUTS
    if not path.is_file():
        return []
    records = []
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            records.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return records
