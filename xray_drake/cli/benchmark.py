"""``xray-drake benchmark``."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import typer
from rich.console import Console

from xray_drake.benchmark.comparison import make_report
from xray_drake.benchmark.paper import changes
from xray_drake.benchmark.records import (
    ROLLOUTS,
    Collection,
    heap_of,
    read_rollouts,
)
from xray_drake.benchmark.report import success_table
from xray_drake.benchmark.rollouts import begun, run_rollouts
from xray_drake.benchmark.variants import Variant, variants
from xray_drake.choices import current_occupancy
from xray_drake.cli.configure import configure
from xray_drake.cli.options import names_in
from xray_drake.cli.progress import counting_bar
from xray_drake.station.objects import (
    check_heaps,
    imported_objects,
    name_of_target,
)
from xray_drake.station.scenario import Scenario


def run(
    out: Path,
    scenario: str,
    overrides: Mapping[str, Any],
    *,
    policies: str,
    occupancy: str,
    heaps: int,
    seed: int,
    workers: int,
    resume: bool,
    mix: bool,
) -> None:
    """Runs the rollouts that are missing and prints the paper's Table II.

    Args:
        out: folder of the records.
        scenario: a name, or a YAML file.
        overrides: see :func:`xray_drake.cli.options.overrides`.
        policies: names with commas between.
        occupancy: what infers the distribution, with commas between, or ""
            for the scenario's.
        heaps: how many.
        seed: of the first; then one by one.
        workers: processes.
        resume: go on with what the folder holds.
        mix: even with what other code has made.

    Raises:
        ValueError: bad input, or the folder holds rollouts of another
            scenario or of other code, or is written by another process.
        OSError: it cannot be written.
        RuntimeError: a worker failed.
    """
    seeds = range(seed, seed + heaps)
    configured, compared = _plan(
        scenario, overrides, names_in(policies), names_in(occupancy), seeds[-1]
    )
    check_heaps(configured)
    target = name_of_target(configured)
    wanted = {(v, (target, seed)) for v in compared for seed in seeds}
    if not resume and read_rollouts(out):
        raise ValueError(
            f"{out} holds rollouts: leave out --no-resume to go on with them, "
            "or choose another --out"
        )
    already = {_key(r) for r in begun(out, configured, compared, mix=mix)}
    if configured.scene.meshes:
        # Decomposed once, by all processes together; workers find the cache.
        imported_objects(configured, workers=workers)
    with counting_bar(Console(), "rollouts", transient=False) as progress:
        done = len(wanted & already)
        progress(done, len(wanted))
        for _ in run_rollouts(
            configured,
            variants=compared,
            seeds=seeds,
            folder=out,
            workers=workers,
            mix=mix,
        ):
            done += 1
            progress(done, len(wanted))
    records = [r for r in read_rollouts(out) if _key(r) in wanted]
    try:
        found = Collection(records, configured.name, changes(configured))
        lines = success_table(make_report(found))
    except ValueError as error:  # done, though all targets were in view
        lines = [str(error)]
    for line in (
        *lines,
        "",
        f"{len(records)} rollouts in {out / ROLLOUTS}; "
        f"xray-drake report {out} tells more",
    ):
        typer.echo(line)


def _key(record: dict[str, Any]) -> tuple[Variant, tuple[str, int]]:
    return Variant.of(record), heap_of(record)


def _plan(
    name: str,
    overrides: Mapping[str, Any],
    policies: Sequence[str],
    occupancies: Sequence[str],
    seed: int,
) -> tuple[Scenario, tuple[Variant, ...]]:
    """Checks every policy with every inference before the first heap."""
    cell = {k: v for k, v in overrides.items() if k.startswith("cell")}
    own = configure(name, cell)
    occupancies = [
        current_occupancy(each)
        for each in occupancies or [own.perception.occupancy]
    ]
    shared = {**overrides, "perception.occupancy": occupancies[0]}
    first = shared.pop("policy.target_first", own.policy.target_first)
    compared = variants(policies, occupancies, target_first=first)
    if not compared:
        raise ValueError("no --policies are named")
    for variant in compared:
        each = {"seed": seed, "policy.name": variant.policy}
        if variant.occupancy:
            each["perception.occupancy"] = variant.occupancy
        configure(name, shared | each)
    return configure(name, shared), compared
