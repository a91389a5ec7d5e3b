"""``xray-drake study``: the experiments behind the README's tables."""

from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from xray_drake.cli.errors import errors_as_lines
from xray_drake.cli.options import CORES, Dataset, Mix, Workers
from xray_drake.cli.progress import counting_bar

if TYPE_CHECKING:
    from xray_drake.studies.study import Study

app = typer.Typer(
    help="Run an experiment of the README again; it goes on after a kill.",
    no_args_is_help=True,
)

_Out = Annotated[
    Path, typer.Option(help="Folder for its lines, tables and manifest.")
]
_Heaps = Annotated[int, typer.Option(min=1, help="Of each sort.")]


def _measures(command: Callable[..., None]) -> Callable[..., None]:
    """Makes a command run the study that is called like it.

    That is made from its own options.
    """
    name = command.__name__

    @wraps(command)
    @errors_as_lines()
    def job(*, out: Path, workers: int, mix: bool, **options: Any) -> None:
        study = getattr(import_module(f"xray_drake.studies.{name}"), name)
        _run(study(**options), out, workers, mix)

    return job


@app.command()
@_measures
def heap_settings(
    out: _Out,
    heaps: _Heaps = 24,
    settings: Annotated[
        str, typer.Option(help="With commas between; by default all.")
    ] = "",
    workers: Workers = CORES,
    mix: Mix = False,
) -> None:
    """Compare physics settings by the speed and the quality of heaps."""


@app.command()
@_measures
def label_ceiling(
    dataset: Dataset,
    out: _Out,
    images: Annotated[int, typer.Option(min=1, help="At most.")] = 100,
    step: Annotated[int, typer.Option(min=1, help="Every n-th image.")] = 1,
    weights: Annotated[Path | None, typer.Option(help="To compare.")] = None,
    workers: Workers = CORES,
    mix: Mix = False,
) -> None:
    """Measure how well labels can be known from the image alone."""


@app.command()
@_measures
def tall_targets(
    out: _Out,
    heaps: _Heaps = 15,
    workers: Workers = CORES,
    mix: Mix = False,
) -> None:
    """Compare inference of tall targets: taken for flat, and resting."""


@app.command()
@_measures
def contact_grasps(
    out: _Out,
    meshes: Annotated[
        Path | None,
        typer.Option(file_okay=False, exists=True, help="With five scans."),
    ] = None,
    most: Annotated[
        int | None, typer.Option(min=1, help="Objects and poses.")
    ] = None,
    loads: Annotated[
        list[float] | None,
        typer.Option(
            "--load", help="Weight over what a grasp holds; repeatable."
        ),
    ] = None,
    carrier: Annotated[str, typer.Option(help="wrist or arm.")] = "wrist",
    workers: Workers = CORES,
    mix: Mix = False,
) -> None:
    """Compare the analysis of grasps with their execution by contact."""


def _run(study: "Study", out: Path, workers: int, mix: bool) -> None:
    from xray_drake.provenance import made_by
    from xray_drake.studies.study import lines_path, run_study

    console = Console()
    with counting_bar(console, study.name) as progress:
        tables = run_study(
            study, out, workers=workers, mix=mix, progress=progress
        )
    for name, rows in tables.items():
        _print(console, rows)
        typer.echo(f"wrote {out / name}.csv")
    typer.echo(made_by(lines_path(study, out)))


def _print(console: Console, rows: Sequence[Mapping[str, Any]]) -> None:
    if rows:
        table = Table(*rows[0])
        for row in rows:
            table.add_row(*map(_shown, row.values()))
        console.print(table)


def _shown(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
