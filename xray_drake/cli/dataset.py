"""``xray-drake dataset``: check and info."""

import json as json_format
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from xray_drake.cli.errors import errors_as_lines
from xray_drake.cli.exits import FAILED
from xray_drake.cli.options import AsJson, Dataset, Workers
from xray_drake.provenance import made_by

if TYPE_CHECKING:
    from xray_drake.dataset.check import CheckReport

app = typer.Typer(
    help="Check a dataset of labelled images, or tell what it is.",
    no_args_is_help=True,
)


@app.command()
def check(
    dataset: Dataset,
    fast: Annotated[
        bool,
        typer.Option(
            "--fast", help="Open each shard only; do not read every byte."
        ),
    ] = False,
    json: AsJson = False,
    workers: Workers = 1,
) -> None:
    """Check every file, byte and sample; exit 1 where something is wrong."""
    with errors_as_lines():
        report = _check(dataset, deep=not fast, workers=workers)
        if json:
            _print_json(report)
        else:
            _print_verdict(report)
        code = 0 if report.sound else FAILED
    raise typer.Exit(code)


@app.command()
def info(dataset: Dataset, json: AsJson = False, workers: Workers = 1) -> None:
    """Tell what a dataset holds; damage is told, but is no failure."""
    with errors_as_lines():
        report = _check(dataset, deep=True, workers=workers)
        if json:
            _print_json(report)
        else:
            _print_info(report, made_by(dataset))


def _check(folder: Path, *, deep: bool, workers: int) -> "CheckReport":
    # h5py and NumPy take a while to import: not for --help.
    from xray_drake.dataset.check import check_dataset

    console = Console(stderr=True)
    with Progress(
        TextColumn("shards"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    ) as bars:
        task = bars.add_task("", total=None)
        return check_dataset(
            folder,
            deep=deep,
            workers=workers,
            progress=lambda done, total: bars.update(
                task, completed=done, total=total
            ),
        )


def _print_json(report: "CheckReport") -> None:
    typer.echo(json_format.dumps(report.to_dict(), indent=1))


def _print_verdict(report: "CheckReport") -> None:
    """Prints each defect as a line, then one line of summary."""
    for defect in report.defects:
        typer.echo(" ".join(str(defect).split()))
    count = (
        f"{report.num_found} of {report.manifest.num_samples} samples in "
        f"{len(report.manifest.expected_shards())} shards"
    )
    if report.sound:
        how = "sound" if report.deep else "sound as far as a fast check sees"
        typer.echo(f"{how}: {count}")
    else:
        number = len(report.defects)
        typer.echo(f"{number} defect{'s' * (number > 1)}: {count}")


def _print_info(report: "CheckReport", manifest_line: str) -> None:
    manifest = report.manifest
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    samples = f"{report.num_found} of {manifest.num_samples}"
    table.add_row("samples", samples)
    for split, count in manifest.splits.items():
        table.add_row(f"  {split}", str(count))
    table.add_row("targets", ", ".join(manifest.targets))
    table.add_row("seed", str(manifest.seed))
    table.add_row("images", f"{manifest.width}×{manifest.height}")
    table.add_row("views per heap", str(manifest.views_per_heap))
    table.add_row("snapshots per heap", str(manifest.snapshots))
    for (package, drake), shards in sorted(report.versions.items()):
        table.add_row(
            "made by", f"xray-drake {package}, Drake {drake} ({shards} shards)"
        )
    table.add_row("manifest", manifest_line)
    size = f"{report.num_bytes / 1e6:.1f} MB"
    if report.num_found:
        size += f", {report.num_bytes / report.num_found / 1e3:.1f} kB a sample"
    table.add_row("size", size)
    for name, value in report.statistics().items():
        if isinstance(value, float) and not name.startswith("objects"):
            table.add_row(name.replace("_", " "), f"{value:.1%}")
        elif not isinstance(value, dict):
            table.add_row(name.replace("_", " "), str(value))
    table.add_row("defects", str(len(report.defects)))
    Console().print(table, highlight=False)
