"""``xray-drake benchmark``."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from xray_drake.benchmark.paper import changes
from xray_drake.benchmark.records import (
    ROLLOUTS,
    Collection,
    heap_of,
    read_rollouts,
)
from xray_drake.benchmark.report import make_report, success_table
from xray_drake.benchmark.rollouts import begun, run_rollouts
from xray_drake.benchmark.variants import Variant, variants
from xray_drake.cli.configure import configure
from xray_drake.station.objects import imported_objects
from xray_drake.station.scenario import Scenario


@dataclass
class BenchmarkOptions:
    """What the command line asked for.

    Attributes:
        out: folder of the records.
        scenario: a name or a YAML file.
        overrides: see :func:`xray_drake.cli.options.overrides`.
        policies: names with commas between.
        occupancy: what infers the distribution, with commas between, or ""
            for the scenario's.
        target_first: as the scenario's ``policy.target_first``, or ``None``
            to leave that.
        seeds: one heap each.
        workers: processes.
        resume: go on with what the folder holds.
        mix: even with what other code has made.
    """

    out: Path
    scenario: str
    overrides: Mapping[str, Any]
    policies: str
    occupancy: str
    target_first: bool | None
    seeds: Sequence[int]
    workers: int
    resume: bool
    mix: bool = False


def run(options: BenchmarkOptions, console: Console) -> None:
    """Runs the rollouts that are missing and prints the paper's Table II.

    Raises:
        ValueError: bad input, or the folder holds rollouts of another
            scenario or of other code, or is written by another process.
        OSError: it cannot be written.
        RuntimeError: a worker failed.
    """
    scenario, compared = _plan(options)
    target = scenario.scene.target
    wanted = {(v, (target, seed)) for v in compared for seed in options.seeds}
    if not options.resume and read_rollouts(options.out):
        raise ValueError(
            f"{options.out} holds rollouts: leave out --no-resume to go on "
            "with them, or choose another --out"
        )
    records = begun(options.out, scenario, compared, mix=options.mix)
    already = {_key(record) for record in records}
    if scenario.scene.meshes:
        # Decomposed once, by all processes together; workers find the cache.
        imported_objects(scenario, workers=options.workers)
    with Progress(
        TextColumn("rollouts"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
    ) as bars:
        task = bars.add_task(
            "", total=len(wanted), completed=len(wanted & already)
        )
        for _ in run_rollouts(
            scenario,
            variants=compared,
            seeds=options.seeds,
            folder=options.out,
            workers=options.workers,
            mix=options.mix,
        ):
            bars.advance(task)
    records = [r for r in read_rollouts(options.out) if _key(r) in wanted]
    try:
        found = Collection(records, scenario.name, changes(scenario))
        lines = success_table(make_report(found))
    except ValueError as error:  # done, though all targets were in view
        lines = [str(error)]
    for line in (
        *lines,
        "",
        f"{len(records)} rollouts in {options.out / ROLLOUTS}; "
        f"xray-drake report {options.out} tells more",
    ):
        console.print(line, soft_wrap=True, highlight=False)


def _key(record: dict[str, Any]) -> tuple[Variant, tuple[str, int]]:
    return Variant.of(record), heap_of(record)


def _plan(options: BenchmarkOptions) -> tuple[Scenario, tuple[Variant, ...]]:
    """Checks every policy with every inference before the first heap."""
    own = configure(options.scenario, {})
    occupancies = _names(options.occupancy) or [own.perception.occupancy]
    target_first = options.target_first
    if target_first is None:
        target_first = own.policy.target_first
    compared = variants(
        _names(options.policies), occupancies, target_first=target_first
    )
    if not compared:
        raise ValueError("no --policies are named")
    for variant in compared:
        configure(
            options.scenario,
            {
                **options.overrides,
                "seed": options.seeds[-1],
                "policy.name": variant.policy,
                "perception.occupancy": variant.occupancy or occupancies[0],
            },
        )
    scenario = configure(
        options.scenario,
        {**options.overrides, "perception.occupancy": occupancies[0]},
    )
    return scenario, compared


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]
