"""``xray-drake generate``."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from xray_drake.choices import BOX_TARGETS, TARGET_NAMES
from xray_drake.cli.configure import configure
from xray_drake.dataset.check import check_dataset
from xray_drake.dataset.engine import (
    open_dataset,
    run_processes,
    run_ray,
)
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
from xray_drake.station.scenario import ScenarioError

LOG = "generate.jsonl"
"""A line for each shard: what it cost, and the heaps that failed."""

HELD_OUT = 0.1
"""Share of the images in each of validation and test under --split all."""


@dataclass
class GenerateOptions:
    """What the command line asked for.

    Attributes:
        out: folder of the dataset.
        images: how many.
        scenario: a name or a YAML file.
        overrides: see :func:`xray_drake.cli.options.overrides`.
        target: a name, names with commas, "all" for the ten boxes, or "" for
            the scenario's.
        split: train, validation, test or all.
        seed, views_per_heap, snapshots, shard_size, color, label: see
            :func:`xray_drake.dataset.generator.plan_dataset`.
        workers: processes.
        cluster: address of a Ray cluster, or "".
        resume: go on with what the folder holds.
        mix: even where other code has made that.
    """

    out: Path
    images: int
    scenario: str
    overrides: dict[str, Any]
    target: str
    split: str
    seed: int
    views_per_heap: int
    snapshots: int
    shard_size: int
    color: bool
    label: str
    workers: int
    cluster: str
    resume: bool
    mix: bool = False


class _Rate(ProgressColumn):
    def render(self, task: Task) -> Text:
        return Text(f"{task.speed:.2f}/s" if task.speed else "")


def run(options: GenerateOptions, console: Console) -> None:
    """Makes what is missing of a dataset, checks it and says what it cost.

    Raises:
        ValueError: bad input.
        OSError: a file that cannot be written.
        RuntimeError: a shard could not be made.
    """
    manifest = _plan(options)
    options.out.mkdir(parents=True, exist_ok=True)
    with sole_writer(options.out):
        _generate(options, manifest, console)


def _generate(
    options: GenerateOptions, manifest: Manifest, console: Console
) -> None:
    out, now = options.out, current()
    resumed = options.resume and any(
        (out / shard.name).is_file() for shard in manifest.expected_shards()
    )
    if resumed:
        check_resumable(out, now, mix=options.mix)
    if options.resume and (out / MANIFEST_NAME).is_file():
        manifest = check_same(out, manifest, mix=options.mix)
    missing = open_dataset(
        out,
        manifest,
        resume=options.resume,
        damaged=lambda path, reason: console.print(
            f"{reason}: it is made again", highlight=False, soft_wrap=True
        ),
    )
    settings = {
        name: manifest.to_dict()[name]
        for name in ("splits", "targets", "options", "meshes")
    }
    record_run(
        out,
        Run("generate", now, manifest.scenario, [manifest.seed], settings),
        resumed=resumed,
    )
    done = manifest.num_samples - sum(shard.count for shard in missing)
    scenario = configure(options.scenario, options.overrides, searched=False)
    if scenario.scene.meshes:
        # Decomposed once, by all processes together; workers find the cache.
        imported_objects(scenario, workers=options.workers)
    start, reports = time.monotonic(), []
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        _Rate(),
        TimeElapsedColumn(),
        TimeRemainingColumn(elapsed_when_finished=True),
        console=console,
        disable=not console.is_terminal,
        speed_estimate_period=300,
    ) as bars:
        task = bars.add_task(
            "images", total=manifest.num_samples, completed=done
        )
        under_way: dict[str, int] = {}

        def progress(name: str, samples: int) -> None:
            bars.update(task, advance=samples - under_way.get(name, 0))
            under_way[name] = samples

        with append_json_lines(out / LOG) as log:
            for report in _run(options, manifest, missing, progress):
                reports.append(report)
                log(report.to_dict())
    _summarize(out, manifest, reports, time.monotonic() - start, console)
    console.print(made_by(out), highlight=False, soft_wrap=True)


def _plan(options: GenerateOptions) -> Manifest:
    scenario = configure(options.scenario, options.overrides, searched=False)
    targets: tuple[str, ...] = ()
    if options.target == "all":
        targets = BOX_TARGETS
    elif options.target:
        targets = tuple(name.strip() for name in options.target.split(","))
    for name in targets:
        if name not in TARGET_NAMES:
            raise ScenarioError(
                f"no target is called {name!r}: choose all, or of "
                f"{', '.join(TARGET_NAMES)}"
            )
    if options.split == "all":
        held_out = round(options.images * HELD_OUT)
        splits = dict.fromkeys(SPLITS, held_out)
        splits["train"] = options.images - 2 * held_out
    elif options.split in SPLITS:
        splits = {options.split: options.images}
    else:
        raise ScenarioError(
            f"no split is called {options.split!r}: choose one of "
            f"{', '.join(SPLITS)}, all"
        )
    return plan_dataset(
        scenario,
        splits=splits,
        seed=options.seed,
        targets=targets,
        views_per_heap=options.views_per_heap,
        snapshots=options.snapshots,
        shard_size=options.shard_size,
        color=options.color,
        label=options.label,
    )


def _run(
    options: GenerateOptions, manifest: Manifest, missing: Any, progress: Any
) -> Iterator[ShardReport]:
    if options.cluster:
        return run_ray(
            options.out,
            manifest,
            missing,
            address=options.cluster,
            progress=progress,
        )
    return run_processes(
        options.out,
        manifest,
        missing,
        workers=options.workers,
        progress=progress,
    )


def _summarize(
    out: Path,
    manifest: Manifest,
    reports: list[ShardReport],
    wall: float,
    console: Console,
) -> None:
    check = check_dataset(out, deep=False)
    for defect in check.defects:
        console.print(str(defect), highlight=False, soft_wrap=True)
    console.print(
        f"{manifest.num_samples} images in {out}",
        highlight=False,
        soft_wrap=True,
    )
    if not reports:
        return
    samples = sum(report.samples for report in reports)
    heaps = sum(report.heaps for report in reports)
    failures = [line for report in reports for line in report.failures]
    cpu = sum(report.cpu for report in reports)
    stages: dict[str, float] = {}
    for report in reports:
        for stage, seconds in report.seconds.items():
            stages[stage] = stages.get(stage, 0.0) + seconds
    shares = ", ".join(
        f"{stage} {seconds / samples:.3f}" for stage, seconds in stages.items()
    )
    console.print(
        f"made {samples} from {heaps} heaps in {wall:.0f} s: "
        f"{cpu / samples:.2f} core-seconds an image ({shares})",
        highlight=False,
        soft_wrap=True,
    )
    draws = heaps + len(failures)
    console.print(
        f"{len(failures)} of {draws} heaps failed and were drawn again "
        f"({len(failures) / draws:.1%})",
        highlight=False,
    )
    for line in failures:
        console.print(f"  {line}", highlight=False, soft_wrap=True)
