"""``xray-drake dataset``: check and info."""

import json as json_format
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from xray_drake.cli.errors import errors_as_lines
from xray_drake.cli.exits import FAILED
from xray_drake.cli.options import AsJson, Dataset, Workers
from xray_drake.cli.progress import counting_bar
from xray_drake.provenance import made_by

if TYPE_CHECKING:
    from xray_drake.dataset.check import CheckReport

app = typer.Typer(
    help="Check a dataset of labelled images, or tell what it is.",
    no_args_is_help=True,
)


@app.command()
@errors_as_lines()
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
    report = _check(dataset, deep=not fast, workers=workers)
    if json:
        _print_json(report)
    else:
        _print_verdict(report)
    raise typer.Exit(0 if report.sound else FAILED)


@app.command()
@errors_as_lines()
def info(dataset: Dataset, json: AsJson = False, workers: Workers = 1) -> None:
    """Tell what a dataset holds; damage is told, but is no failure."""
    report = _check(dataset, deep=True, workers=workers)
    if json:
        _print_json(report)
    else:
        _print_info(report, made_by(dataset))


def _check(folder: Path, *, deep: bool, workers: int) -> "CheckReport":
    # h5py and NumPy take a while to import: not for --help.
    from xray_drake.dataset.check import check_dataset

    with counting_bar(Console(stderr=True), "shards") as progress:
        return check_dataset(
            folder, deep=deep, workers=workers, progress=progress
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
    rows = [
        ("samples", f"{report.num_found} of {manifest.num_samples}"),
        *((f"  {split}", count) for split, count in manifest.splits.items()),
        ("targets", ", ".join(manifest.targets)),
        ("seed", manifest.seed),
        ("images", f"{manifest.width}×{manifest.height}"),
        ("views per heap", manifest.views_per_heap),
        ("snapshots per heap", manifest.snapshots),
    ]
    for (package, drake), shards in sorted(report.versions.items()):
        made = f"xray-drake {package}, Drake {drake} ({shards} shards)"
        rows.append(("made by", made))
    size = f"{report.num_bytes / 1e6:.1f} MB"
    if report.num_found:
        size += f", {report.num_bytes / report.num_found / 1e3:.1f} kB a sample"
    rows += [("manifest", manifest_line), ("size", size)]
    for name, value in report.statistics().items():
        if isinstance(value, float) and not name.startswith("objects"):
            rows.append((name.replace("_", " "), f"{value:.1%}"))
        elif not isinstance(value, dict):
            rows.append((name.replace("_", " "), value))
    for name, value in (*rows, ("defects", len(report.defects))):
        table.add_row(name, str(value))
    Console().print(table, highlight=False)
