"""``xray-drake``: one command per job."""

import faulthandler
import logging
import sys
from collections.abc import Callable
from functools import wraps
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from xray_drake import __version__
from xray_drake.cli.dataset import app as dataset_app
from xray_drake.cli.errors import accept_any_output, errors_as_lines
from xray_drake.cli.evaluate import app as evaluate_app
from xray_drake.cli.inspect import inspect
from xray_drake.cli.objects import app as objects_app
from xray_drake.cli.options import (
    CORES,
    FLAT_TARGETS,
    OCCUPANCIES,
    POLICIES,
    SEARCHED,
    SPLITS,
    Mix,
    ScenarioName,
    Seed,
    Workers,
    one_of,
    replacing,
)
from xray_drake.cli.report import report
from xray_drake.cli.study import app as study_app
from xray_drake.cli.train import train


class _App(typer.Typer):
    """The program; also what its entry point calls."""

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        accept_any_output()
        if sys.__stderr__ is not None:
            # A crash of native code tells where.
            faulthandler.enable(sys.__stderr__)
        return super().__call__(*args, **kwargs)


app = _App(
    name="xray-drake",
    help="Mechanical search: find an object hidden in a heap.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def _version(value: bool) -> None:
    if value:
        typer.echo(f"xray-drake {__version__}")
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            callback=_version,
            is_eager=True,
            help="Print the version and exit.",
        ),
    ] = False,
) -> None:
    logging.basicConfig(
        stream=sys.stderr, level=logging.WARNING, format="%(message)s"
    )


def _runs(module: str) -> Callable:
    """Gives a command the body of ``cli.MODULE.run``; the status that it ends.

    Drake takes a second to import: not for --help and --version.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        @wraps(command)
        @errors_as_lines()
        def job(**options: Any) -> None:
            run = import_module(f"xray_drake.cli.{module}").run
            raise typer.Exit(run(**options) or 0)

        return job

    return decorate


@app.command()
@replacing("policy", "seed", "occupancy", "target_first", *SEARCHED)
@_runs("search")
def search(
    overrides: dict[str, Any],
    scenario: ScenarioName = "demo",
    json: Annotated[
        Path | None, typer.Option(help="Write the record here.")
    ] = None,
    html: Annotated[
        Path | None, typer.Option(help="Write a page that plays the search.")
    ] = None,
    film_strip: Annotated[
        Path | None,
        typer.Option(
            help="Draw each decision as a picture here: PNG, PDF or SVG."
        ),
    ] = None,
    save_heap: Annotated[
        Path | None,
        typer.Option(help="Write the heap here, as --heap reads it."),
    ] = None,
    meshcat: Annotated[
        bool,
        typer.Option(
            "--meshcat",
            help="Show it live, with buttons, on a page of this machine; "
            "Ctrl-C ends it.",
        ),
    ] = False,
) -> None:
    """Drop a heap on a target and search for it.

    The scenario decides what an option leaves out.
    """


@app.command()
@replacing("target_first", *SEARCHED)
@_runs("benchmark")
def benchmark(
    overrides: dict[str, Any],
    out: Annotated[
        Path, typer.Option(help="Folder for the records; resumed if it exists.")
    ],
    scenario: ScenarioName = "demo",
    policies: Annotated[
        str,
        typer.Option(
            help=f"{one_of([*POLICIES])}, or some with commas between."
        ),
    ] = "random,largest,xray",
    occupancy: Annotated[
        str,
        typer.Option(
            help=f"{one_of(OCCUPANCIES)}, or some with commas between: "
            "policies that look at the distribution run with each. By default "
            "the scenario's."
        ),
    ] = "",
    heaps: Annotated[int, typer.Option(min=1, help="How many heaps.")] = 30,
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of the first; then one by one.")
    ] = 0,
    workers: Workers = CORES,
    resume: Annotated[
        bool,
        typer.Option(help="Go on with what the folder holds, or refuse it."),
    ] = True,
    mix: Mix = False,
) -> None:
    """Run policies on the same heaps and print a table like the paper's.

    The scenario decides what an option leaves out.
    """


@app.command()
@replacing("cell", "camera", "num_objects", "meshes", "scale")
@_runs("generate")
def generate(
    overrides: dict[str, Any],
    out: Annotated[
        Path, typer.Argument(metavar="OUT", help="Folder of the dataset.")
    ],
    images: Annotated[int, typer.Option(min=1, help="How many.")] = 10_000,
    scenario: ScenarioName = "paper",
    target: Annotated[
        str,
        typer.Option(
            help=f"{one_of(FLAT_TARGETS)}, or some with commas between; or "
            "all: an equal share for each of the ten boxes. By default the "
            "scenario's."
        ),
    ] = "",
    split: Annotated[
        str,
        typer.Option(
            help=f"Which objects: {one_of(SPLITS)}; or all: 80, 10 and 10 % of "
            "the images."
        ),
    ] = "train",
    seed: Seed = 0,
    workers: Workers = CORES,
    views_per_heap: Annotated[
        int, typer.Option(min=1, help="Cameras for each state of a heap.")
    ] = 1,
    snapshots: Annotated[
        int,
        typer.Option(
            min=1, help="States of a heap: while it grows, and at rest."
        ),
    ] = 1,
    color: Annotated[
        bool, typer.Option("--color", help="With colour images.")
    ] = False,
    label: Annotated[
        str,
        typer.Option(help="paper, or exact: exact placement on the floor."),
    ] = "paper",
    shard_size: Annotated[
        int, typer.Option(min=1, help="Images per file, or a few more.")
    ] = 50,
    cluster: Annotated[
        str,
        typer.Option(
            help="Run on a Ray cluster: its address, auto, or local:N."
        ),
    ] = "",
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with what is there.")
    ] = False,
    mix: Mix = False,
) -> None:
    """Make a dataset of labelled images."""


@app.command()
@_runs("doctor")
def doctor() -> None:
    """Say what this machine lacks, and the command that mends it."""


app.command()(report)
app.command()(inspect)
app.command()(train)
app.add_typer(dataset_app, name="dataset")
app.add_typer(evaluate_app, name="evaluate")
app.add_typer(objects_app, name="objects")
app.add_typer(study_app, name="study")

if __name__ == "__main__":
    app()
