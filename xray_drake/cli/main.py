"""``xray-drake``: one command per job."""

import logging
import os
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from xray_drake import __version__
from xray_drake.cli.dataset import app as dataset_app
from xray_drake.cli.errors import errors_as_lines
from xray_drake.cli.evaluate import app as evaluate_app
from xray_drake.cli.inspect import inspect
from xray_drake.cli.objects import app as objects_app
from xray_drake.cli.report import report
from xray_drake.cli.train import train

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


_Meshes = Annotated[
    list[Path] | None,
    typer.Option(
        help="Folder of meshes that replace the distractors; repeatable."
    ),
]
_Scale = Annotated[
    float | None, typer.Option(help="Factor from their unit to metres.")
]


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
    meshes: _Meshes = None,
    scale: _Scale = None,
    execution: Annotated[
        str | None, typer.Option(help="quasi_static or contact.")
    ] = None,
    occupancy: Annotated[
        str | None, typer.Option(help="learned, posterior or exact.")
    ] = None,
    weights: Annotated[
        str | None,
        typer.Option(help="File of a network's weights, or a folder of them."),
    ] = None,
    detector: Annotated[
        str | None, typer.Option(help="ground_truth or hsv.")
    ] = None,
    segmenter: Annotated[
        str | None, typer.Option(help="ground_truth or depth.")
    ] = None,
    grasps: Annotated[
        str | None, typer.Option(help="models, or depth without any.")
    ] = None,
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
    film_strip: Annotated[
        Path | None,
        typer.Option(
            help="Draw each decision as a picture here: PNG, PDF or SVG."
        ),
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
                    "scene.mesh_scale": scale,
                    "seed": seed,
                    "horizon": horizon,
                    "gripper.execution": execution,
                    "gripper.grasps": grasps,
                    "perception.occupancy": occupancy,
                    "perception.weights": weights,
                    "perception.detector": detector,
                    "perception.segmenter": segmenter,
                },
                json=json,
                html=html,
                meshcat=meshcat,
                film_strip=film_strip,
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
    occupancy: Annotated[
        str,
        typer.Option(
            help="learned, posterior, exact, or some with commas between: "
            "policies that look at the distribution run with each. By default "
            "the scenario's."
        ),
    ] = "",
    heaps: Annotated[int, typer.Option(min=1, help="How many heaps.")] = 30,
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of the first; then one by one.")
    ] = 0,
    workers: Annotated[
        int, typer.Option(min=1, help="Processes.")
    ] = os.cpu_count() or 1,
    target: Annotated[str | None, typer.Option(help="Replaces it.")] = None,
    num_objects: Annotated[
        int | None, typer.Option(help="Distractors to drop.")
    ] = None,
    meshes: _Meshes = None,
    scale: _Scale = None,
    horizon: Annotated[
        int | None, typer.Option(help="Actions at most.")
    ] = None,
    target_first: Annotated[
        bool | None, typer.Option("--target-first/--no-target-first")
    ] = None,
    execution: Annotated[
        str | None, typer.Option(help="quasi_static or contact.")
    ] = None,
    weights: Annotated[
        str | None,
        typer.Option(help="File of a network's weights, or a folder of them."),
    ] = None,
    detector: Annotated[
        str | None, typer.Option(help="ground_truth or hsv.")
    ] = None,
    segmenter: Annotated[
        str | None, typer.Option(help="ground_truth or depth.")
    ] = None,
    grasps: Annotated[
        str | None, typer.Option(help="models, or depth without any.")
    ] = None,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume/--no-resume",
            help="Go on with what the folder holds, or refuse it.",
        ),
    ] = True,
) -> None:
    """Run policies on the same heaps and print the paper's Table II."""
    from xray_drake.cli.benchmark import BenchmarkOptions, run

    with errors_as_lines():
        run(
            BenchmarkOptions(
                out=out,
                scenario=scenario,
                overrides={
                    "scene.target": target,
                    "scene.num_objects": num_objects,
                    "scene.random_number.mean": None
                    if num_objects is None
                    else 0.0,
                    "scene.meshes": [str(m) for m in meshes]
                    if meshes
                    else None,
                    "scene.mesh_scale": scale,
                    "horizon": horizon,
                    "gripper.execution": execution,
                    "gripper.grasps": grasps,
                    "perception.weights": weights,
                    "perception.detector": detector,
                    "perception.segmenter": segmenter,
                },
                policies=policies,
                occupancy=occupancy,
                target_first=target_first,
                seeds=range(seed, seed + heaps),
                workers=workers,
                resume=resume,
            ),
            Console(),
        )


@app.command()
def generate(
    out: Annotated[Path, typer.Argument(help="Folder of the dataset.")],
    images: Annotated[int, typer.Option(min=1, help="How many.")] = 10_000,
    scenario: Annotated[
        str, typer.Option(help="Name of a scenario, or a YAML file.")
    ] = "paper",
    target: Annotated[
        str,
        typer.Option(
            help="A target, some with commas between, or all: an equal share "
            "for each of the ten boxes. By default the scenario's."
        ),
    ] = "",
    split: Annotated[
        str,
        typer.Option(
            help="Which objects: train, validation, test; or all: 80, 10 and "
            "10 % of the images."
        ),
    ] = "train",
    seed: Annotated[int, typer.Option(min=0, help="Of the dataset.")] = 0,
    workers: Annotated[
        int, typer.Option(min=1, help="Processes.")
    ] = os.cpu_count() or 1,
    views_per_heap: Annotated[
        int, typer.Option(min=1, help="Cameras for each state of a heap.")
    ] = 1,
    snapshots: Annotated[
        int,
        typer.Option(
            min=1,
            help="States of a heap that are looked at: while it grows, and "
            "at rest.",
        ),
    ] = 1,
    num_objects: Annotated[
        int | None, typer.Option(help="Distractors in every heap.")
    ] = None,
    meshes: _Meshes = None,
    scale: _Scale = None,
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
) -> None:
    """Make a dataset of labelled images."""
    from xray_drake.cli.generate import GenerateOptions, run

    with errors_as_lines():
        overrides: dict[str, object] = {
            "scene.num_objects": num_objects,
            "scene.random_number.mean": None if num_objects is None else 0.0,
            "scene.meshes": [str(m) for m in meshes] if meshes else None,
            "scene.mesh_scale": scale,
        }
        run(
            GenerateOptions(
                out=out,
                images=images,
                scenario=scenario,
                overrides=overrides,
                target=target,
                split=split,
                seed=seed,
                views_per_heap=views_per_heap,
                snapshots=snapshots,
                shard_size=shard_size,
                color=color,
                label=label,
                workers=workers,
                cluster=cluster,
                resume=resume,
            ),
            Console(),
        )


@app.command()
def doctor() -> None:
    """Say what this machine lacks, and the command that mends it."""
    from xray_drake.cli.doctor import run

    raise typer.Exit(run(Console()))


app.command()(report)
app.command()(inspect)
app.command()(train)
app.add_typer(dataset_app, name="dataset")
app.add_typer(evaluate_app, name="evaluate")
app.add_typer(objects_app, name="objects")

if __name__ == "__main__":
    app()
