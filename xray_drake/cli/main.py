"""``xray-drake``: one command per job."""

import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from xray_drake import __version__
from xray_drake.cli.exits import BAD_INPUT, FAILED, INTERRUPTED

app = typer.Typer(
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


def complain(message: str, code: int = BAD_INPUT) -> typer.Exit:
    """Prints one line to standard error and returns the exit to raise."""
    typer.echo(f"xray-drake: {' '.join(message.split())}", err=True)
    return typer.Exit(code)


@contextmanager
def errors_as_lines() -> Iterator[None]:
    """Turns the errors of a job into one line and an exit status.

    Raises:
        typer.Exit: 2 for bad input, 1 for a file that cannot be written or a
            failed simulation, 130 for Ctrl-C.
    """
    try:
        yield
    except ValueError as error:
        raise complain(str(error)) from error
    except (OSError, RuntimeError) as error:
        if isinstance(error, typer.Exit):
            raise
        raise complain(str(error), FAILED) from error
    except KeyboardInterrupt:
        raise complain("interrupted", INTERRUPTED) from None


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


@app.command()
def search(
    scenario: Annotated[
        str, typer.Option(help="Name of a scenario, or a YAML file.")
    ] = "demo",
    policy: Annotated[
        str | None, typer.Option(help="xray, largest or random.")
    ] = None,
    target: Annotated[
        str | None,
        typer.Option(help="box_1to1 … box_10to1, lid, domino, flute."),
    ] = None,
    num_objects: Annotated[
        int | None, typer.Option(help="Distractors to drop.")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(help="Of heap, policy and execution.")
    ] = None,
    horizon: Annotated[
        int | None, typer.Option(help="Actions at most.")
    ] = None,
    meshes: Annotated[
        list[Path] | None,
        typer.Option(
            help="Folder of OBJ files that replace the distractors; repeatable."
        ),
    ] = None,
    execution: Annotated[str | None, typer.Option(help="quasi_static.")] = None,
    occupancy: Annotated[str | None, typer.Option(help="exact.")] = None,
    detector: Annotated[str | None, typer.Option(help="ground_truth.")] = None,
    segmenter: Annotated[str | None, typer.Option(help="ground_truth.")] = None,
    grasps: Annotated[str | None, typer.Option(help="models.")] = None,
    target_first: Annotated[
        bool | None,
        typer.Option(
            "--target-first/--no-target-first",
            help="Grasp the target whenever a grasp on it exists.",
        ),
    ] = None,
    json: Annotated[
        Path | None, typer.Option(help="Write the record here.")
    ] = None,
    html: Annotated[
        Path | None, typer.Option(help="Write a page that plays the search.")
    ] = None,
    meshcat: Annotated[
        bool,
        typer.Option(
            help="Show it live, with buttons, on a page of this machine; "
            "Ctrl-C ends it."
        ),
    ] = False,
) -> None:
    """Drop a heap on a target and search for it."""
    # Drake takes a second to import: not for --help and --version.
    from xray_drake.cli.search import SearchOptions, run

    with errors_as_lines():
        code = run(
            SearchOptions(
                scenario=scenario,
                overrides={
                    "policy.name": policy,
                    "policy.target_first": target_first,
                    "scene.target": target,
                    "scene.num_objects": num_objects,
                    "scene.meshes": [str(m) for m in meshes]
                    if meshes
                    else None,
                    "seed": seed,
                    "horizon": horizon,
                    "gripper.execution": execution,
                    "gripper.grasps": grasps,
                    "perception.occupancy": occupancy,
                    "perception.detector": detector,
                    "perception.segmenter": segmenter,
                },
                json=json,
                html=html,
                meshcat=meshcat,
            ),
            Console(),
        )
    raise typer.Exit(code)


@app.command()
def benchmark(
    out: Annotated[
        Path, typer.Option(help="Folder for the records; resumed if it exists.")
    ],
    scenario: Annotated[
        str, typer.Option(help="Name of a scenario, or a YAML file.")
    ] = "demo",
    policies: Annotated[
        str, typer.Option(help="Names with commas between.")
    ] = "random,largest,xray",
    heaps: Annotated[int, typer.Option(min=1, help="How many heaps.")] = 30,
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of the first; then one by one.")
    ] = 0,
    workers: Annotated[
        int, typer.Option(min=1, help="Processes.")
    ] = os.cpu_count() or 1,
    target: Annotated[str | None, typer.Option(help="Replaces it.")] = None,
    horizon: Annotated[
        int | None, typer.Option(help="Actions at most.")
    ] = None,
    target_first: Annotated[
        bool | None, typer.Option("--target-first/--no-target-first")
    ] = None,
) -> None:
    """Run policies on the same heaps and print the paper's Table II."""
    from xray_drake.cli.benchmark import run
    from xray_drake.cli.search import configure

    with errors_as_lines():
        names = tuple(name.strip() for name in policies.split(","))
        for name in names:
            configure(scenario, {"policy.name": name})
        run(
            configure(
                scenario,
                {
                    "scene.target": target,
                    "horizon": horizon,
                    "policy.target_first": target_first,
                },
            ),
            policies=names,
            seeds=range(seed, seed + heaps),
            folder=out,
            workers=workers,
            console=Console(),
        )


@app.command()
def doctor() -> None:
    """Say what this machine lacks, and the command that mends it."""
    from xray_drake.cli.doctor import run

    raise typer.Exit(run(Console()))


if __name__ == "__main__":
    app()
