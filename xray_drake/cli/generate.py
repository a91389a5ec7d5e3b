"""``xray-drake generate``."""

import time
from collections import Counter, defaultdict
from collections.abc import Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import typer
from rich.console import Console

from xray_drake.choices import BOX_TARGETS, TARGET_NAMES
from xray_drake.cli.configure import configure
from xray_drake.cli.options import names_in
from xray_drake.cli.progress import counting_bar
from xray_drake.dataset.check import check_dataset
from xray_drake.dataset.engine import open_dataset, run_processes, run_ray
from xray_drake.dataset.generator import ShardReport, plan_dataset
from xray_drake.dataset.manifest import MANIFEST_NAME, Manifest, check_same
from xray_drake.files import append_json_lines, sole_writer
from xray_drake.provenance import (
    Run,
    check_resumable,
    current,
    made_by,
    record_run,
)
from xray_drake.splits import SPLITS
from xray_drake.station.objects import imported_objects
from xray_drake.station.scenario import Scenario, ScenarioError

LOG = "generate.jsonl"
"""A line for each shard: what it cost, and the heaps that failed."""

HELD_OUT = 0.1
"""Share of the images in each of validation and test under --split all."""


def run(
    out: Path,
    scenario: str,
    overrides: Mapping[str, Any],
    *,
    target: str,
    split: str,
    images: int,
    workers: int,
    cluster: str,
    resume: bool,
    mix: bool,
    **plan: Any,
) -> None:
    """Makes what is missing of a dataset, checks it and says what it cost.

    Args:
        out: folder of the dataset.
        scenario: a name, or a YAML file.
        overrides: see :func:`xray_drake.cli.options.overrides`.
        target: names with commas, "all" for the ten boxes, or "" for the
            scenario's.
        split: train, validation, test or all.
        images: how many.
        workers: processes.
        cluster: address of a Ray cluster, or "".
        resume: go on with what the folder holds.
        mix: even where other code has made that.
        plan: see :func:`xray_drake.dataset.generator.plan_dataset`.

    Raises:
        ValueError: bad input.
        OSError: a file that cannot be written.
        RuntimeError: a shard could not be made.
    """
    configured = configure(scenario, overrides, searched=False)
    manifest = plan_dataset(
        configured,
        splits=_splits(split, images),
        targets=_targets(target),
        **plan,
    )
    out.mkdir(parents=True, exist_ok=True)
    make = partial(run_processes, workers=workers)
    if cluster:
        make = partial(run_ray, address=cluster)
    with sole_writer(out):
        if resume:
            manifest = _taken_up(out, manifest, mix)
        _generate(out, configured, manifest, make, workers, resume)


def _targets(text: str) -> tuple[str, ...]:
    if text == "all":
        return BOX_TARGETS
    for name in (names := names_in(text)):
        if name not in TARGET_NAMES:
            raise ScenarioError(
                f"no target is called {name!r}: choose all, or of "
                f"{', '.join(TARGET_NAMES)}"
            )
    return tuple(names)


def _splits(split: str, images: int) -> dict[str, int]:
    if split == "all":
        held_out = round(images * HELD_OUT)
        return dict.fromkeys(SPLITS, held_out) | {
            "train": images - 2 * held_out
        }
    if split not in SPLITS:
        raise ScenarioError(
            f"no split is called {split!r}: choose one of "
            f"{', '.join(SPLITS)}, all"
        )
    return {split: images}


def _made(out: Path, manifest: Manifest) -> bool:
    """Says whether a shard is there."""
    return any((out / s.name).is_file() for s in manifest.expected_shards())


def _taken_up(out: Path, manifest: Manifest, mix: bool) -> Manifest:
    """Returns the manifest in the folder, if it is that of this dataset."""
    if _made(out, manifest):
        check_resumable(out, current(), mix=mix)
    if (out / MANIFEST_NAME).is_file():
        return check_same(out, manifest, mix=mix)
    return manifest


def _generate(
    out: Path,
    scenario: Scenario,
    manifest: Manifest,
    make: Any,
    workers: int,
    resume: bool,
) -> None:
    resumed = resume and _made(out, manifest)
    missing = open_dataset(
        out,
        manifest,
        resume=resume,
        damaged=lambda path, why: typer.echo(f"{why}: it is made again"),
    )
    plan, seeds = manifest.to_dict(), [manifest.seed]
    asked = {k: plan[k] for k in ("splits", "targets", "options", "meshes")}
    run = Run("generate", current(), manifest.scenario, seeds, asked)
    record_run(out, run, resumed=resumed)
    if scenario.scene.meshes:
        # Decomposed once, by all processes together; workers find the cache.
        imported_objects(scenario, workers=workers)
    start, reports = time.monotonic(), []
    done = manifest.num_samples - sum(shard.count for shard in missing)
    made: Counter[str] = Counter()
    with (
        counting_bar(Console(), "images", transient=False) as bar,
        append_json_lines(out / LOG) as log,
    ):

        def progress(name: str, samples: int) -> None:
            made[name] = samples
            bar(done + made.total(), manifest.num_samples)

        for report in make(out, manifest, missing, progress=progress):
            reports.append(report)
            log(asdict(report))
    _summarize(out, manifest, reports, time.monotonic() - start)


def _summarize(
    out: Path, manifest: Manifest, reports: list[ShardReport], wall: float
) -> None:
    for defect in check_dataset(out, deep=False).defects:
        typer.echo(str(defect))
    typer.echo(f"{manifest.num_samples} images in {out}")
    if reports:
        samples = sum(report.samples for report in reports)
        heaps = sum(report.heaps for report in reports)
        failures = [line for report in reports for line in report.failures]
        cpu = sum(report.cpu for report in reports)
        stages: dict[str, float] = defaultdict(float)
        for report in reports:
            for stage, seconds in report.seconds.items():
                stages[stage] += seconds
        shares = ", ".join(f"{k} {v / samples:.3f}" for k, v in stages.items())
        typer.echo(
            f"made {samples} from {heaps} heaps in {wall:.0f} s: "
            f"{cpu / samples:.2f} core-seconds an image ({shares})"
        )
        draws = heaps + len(failures)
        typer.echo(
            f"{len(failures)} of {draws} heaps failed and were drawn again "
            f"({len(failures) / draws:.1%})"
        )
        for line in failures:
            typer.echo(f"  {line}")
    typer.echo(made_by(out))
