"""``xray-drake inspect``."""

import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from xray_drake.choices import OCCUPANCIES
from xray_drake.cli.errors import errors_as_lines
from xray_drake.cli.options import one_of, overrides
from xray_drake.splits import SPLITS

if TYPE_CHECKING:
    from xray_drake.dataset.sample import Sample


_SEARCHED, _RECORDED = "Of a heap", "Of a rollout"
_SHOWN = "How heaps and rollouts are shown"
_SAMPLES = "Of a dataset"


def inspect(
    what: Annotated[
        Path | None,
        typer.Argument(
            metavar="WHAT",
            help="A rollout's record (search --json), a benchmark's folder or "
            "rollouts.jsonl, or a dataset's folder. Left out, a heap is "
            "dropped.",
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Of the heap; of a benchmark's rollout; of the draw of "
            "samples (0).",
        ),
    ] = None,
    target: Annotated[
        list[str] | None,
        typer.Option(help="Of the heap; of samples, repeatable."),
    ] = None,
    scenario: Annotated[
        str | None,
        typer.Option(
            help="Name, or a YAML file; by default demo.",
            rich_help_panel=_SEARCHED,
        ),
    ] = None,
    num_objects: Annotated[
        int | None,
        typer.Option(help="Distractors to drop.", rich_help_panel=_SEARCHED),
    ] = None,
    meshes: Annotated[
        list[Path] | None,
        typer.Option(
            help="Folder of meshes that replace the distractors; repeatable.",
            rich_help_panel=_SEARCHED,
        ),
    ] = None,
    scale: Annotated[
        float | None,
        typer.Option(
            help="Factor from their unit to metres.", rich_help_panel=_SEARCHED
        ),
    ] = None,
    occupancy: Annotated[
        str | None,
        typer.Option(help=f"{one_of(OCCUPANCIES)}.", rich_help_panel=_SEARCHED),
    ] = None,
    policy: Annotated[
        str | None,
        typer.Option(
            help="Whose decision is shown; of a benchmark's rollout.",
            rich_help_panel=_SEARCHED,
        ),
    ] = None,
    rollout: Annotated[
        int | None,
        typer.Option(
            help="Of a benchmark's records this one, from 0; or choose by "
            "--policy and --seed.",
            rich_help_panel=_RECORDED,
        ),
    ] = None,
    step: Annotated[
        int | None,
        typer.Option(
            min=1, help="To begin with, from 1.", rich_help_panel=_RECORDED
        ),
    ] = None,
    opacity: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            max=1.0,
            help="Of the heap: below 1 one sees the target under it.",
            rich_help_panel=_SHOWN,
        ),
    ] = None,
    html: Annotated[
        Path | None,
        typer.Option(
            help="Write a page with all layers and steps, in place of a live "
            "one.",
            rich_help_panel=_SHOWN,
        ),
    ] = None,
    samples: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="How many, drawn at random (8).",
            rich_help_panel=_SAMPLES,
        ),
    ] = None,
    index: Annotated[
        list[int] | None,
        typer.Option(
            help="This one instead, from 0; repeatable.",
            rich_help_panel=_SAMPLES,
        ),
    ] = None,
    split: Annotated[
        str | None,
        typer.Option(help=f"{one_of(SPLITS)}.", rich_help_panel=_SAMPLES),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Write the figure here: PNG, PDF or SVG. By default "
            "samples.png, or nothing with --meshcat.",
            rich_help_panel=_SAMPLES,
        ),
    ] = None,
    meshcat: Annotated[
        bool,
        typer.Option(
            "--meshcat",
            help="Show samples one by one in Meshcat; Ctrl-C ends it. A heap "
            "or rollout is shown there anyway; with --html, too.",
        ),
    ] = False,
) -> None:
    """Look into a heap, a recorded rollout or a dataset.

    A heap or a rollout comes as a Meshcat page with layers, an x-ray view and
    buttons to go through the decisions; samples of a dataset as a figure or
    in Meshcat.

    xray-drake inspect --seed 7

    xray-drake inspect search.json

    xray-drake inspect out/table2 --policy xray --seed 3

    xray-drake inspect out/paper --out samples.png
    """
    given = {
        "scenario": scenario,
        "num-objects": num_objects,
        "meshes": meshes,
        "scale": scale,
        "occupancy": occupancy,
        "policy": policy,
        "rollout": rollout,
        "step": step,
        "opacity": opacity,
        "html": html,
        "target": target,
        "samples": samples,
        "index": index,
        "split": split,
        "out": out,
    }
    with errors_as_lines():
        kind = kind_of(what)
        check_options(
            kind, [name for name, value in given.items() if value is not None]
        )
        if kind == "dataset":
            assert what is not None
            _inspect_dataset(
                choose(
                    what,
                    samples=8 if samples is None else samples,
                    indices=index,
                    split=split,
                    targets=target,
                    seed=seed or 0,
                ),
                out,
                meshcat=meshcat,
            )
            return
        # Drake takes a second to import, and datasets do without.
        from xray_drake.cli.inspect_search import (
            PageOptions,
            inspect_heap,
            inspect_rollout,
        )

        options = PageOptions(
            step=step or 1,
            opacity=1.0 if opacity is None else opacity,
            html=html,
            live=html is None or meshcat,
        )
        if kind == "rollout":
            assert what is not None
            inspect_rollout(
                what,
                options,
                Console(),
                index=rollout,
                policy=policy,
                seed=seed,
            )
            return
        if target is not None and len(target) > 1:
            raise ValueError("a heap has one target: give --target once")
        inspect_heap(
            scenario or "demo",
            overrides(
                seed=seed,
                target=target[0] if target else None,
                num_objects=num_objects,
                meshes=meshes,
                scale=scale,
                occupancy=occupancy,
                policy=policy,
            ),
            options,
            Console(),
        )


_PAGE = ("opacity", "html")
_USES = {
    "heap": (
        *("scenario", "num-objects", "meshes", "scale", "occupancy", "policy"),
        *("target", *_PAGE),
    ),
    "rollout": ("policy", "rollout", "step", *_PAGE),
    "dataset": ("samples", "index", "split", "target", "out"),
}
"""What is inspected, to the options that it takes beside --seed, --meshcat."""


def kind_of(what: Path | None) -> str:
    """Returns "heap", "rollout" or "dataset", by what a path looks like.

    Raises:
        ValueError: there is nothing.
    """
    if what is None:
        return "heap"
    if not what.exists():
        raise ValueError(
            f"there is no file or folder {what}: make a record with "
            "'xray-drake search --json', or a dataset with 'xray-drake "
            "generate'"
        )
    if what.suffix in (".json", ".jsonl") or (what / "rollouts.jsonl").exists():
        return "rollout"
    return "dataset"


def check_options(kind: str, given: Sequence[str]) -> None:
    """Checks that options are of what is inspected.

    Raises:
        ValueError: one is not; it is named.
    """
    for name in given:
        if name not in _USES[kind]:
            others = [other for other, uses in _USES.items() if name in uses]
            raise ValueError(
                f"--{name} is for a {' or a '.join(others)}, and this is a "
                f"{kind}"
            )


def _inspect_dataset(
    chosen: Sequence[tuple[int, "Sample"]], out: Path | None, *, meshcat: bool
) -> None:
    if out is None and not meshcat:
        out = Path("samples.png")
    if out is not None:
        write_figure([sample for _, sample in chosen], out)
        typer.echo(f"wrote {out}")
    if meshcat:
        _show(chosen)


def choose(
    folder: Path,
    *,
    samples: int,
    indices: Sequence[int] | None,
    split: str | None,
    targets: Sequence[str] | None,
    seed: int,
) -> list[tuple[int, "Sample"]]:
    """Returns samples with their indices; complete or not, the dataset serves.

    Args:
        folder: of the dataset.
        samples: how many to draw, at most.
        indices: these and no others, if given.
        split: of this split; None is all.
        targets: of these targets; None is all.
        seed: of the draw.

    Raises:
        DatasetError: the folder is no dataset, or it is damaged.
        ValueError: there is no sample of an index.
    """
    from xray_drake.dataset.reader import OccupancyDataset
    from xray_drake.seeding import stream

    dataset = OccupancyDataset(
        folder, split=split, targets=targets or None, incomplete=True
    )
    if not indices:
        drawn = stream(seed, "inspect").permutation(len(dataset))[:samples]
        indices = sorted(int(i) for i in drawn)
    for index in indices:
        if not 0 <= index < len(dataset):
            raise ValueError(
                f"{folder} has no sample {index}: there are {len(dataset)}, "
                "from 0"
            )
    return [(index, dataset.sample(index)) for index in indices]


def write_figure(samples: Sequence["Sample"], path: Path) -> None:
    """Writes a figure of samples, in the format that its name ends with.

    Raises:
        ValueError: no format is called so.
        OSError: it cannot be written.
    """
    from xray_drake.inspector.figures import sample_figure

    figure = sample_figure(samples)
    kinds = figure.canvas.get_supported_filetypes()
    kind = path.suffix.removeprefix(".").lower()
    if kind not in kinds:
        raise ValueError(
            f"no picture can be written to {path}: its name should end in "
            ".png, .pdf or .svg"
        )
    figure.savefig(path, format=kind)


def _show(chosen: Sequence[tuple[int, "Sample"]]) -> None:
    """Shows one sample after another until Ctrl-C."""
    from xray_drake.inspector.dataset import show_sample, start_viewer

    viewer = start_viewer()
    typer.echo(f"open {viewer.url}; Ctrl-C here ends it")
    try:
        for index, sample in _around(chosen):
            show_sample(viewer, sample)
            typer.echo(
                f"sample {index}: {sample.key}, "
                f"{sample.visible_fraction:.0%} visible"
            )
            wait_for_enter(len(chosen))
    except KeyboardInterrupt:
        typer.echo("")


def _around(
    chosen: Sequence[tuple[int, "Sample"]],
) -> Iterator[tuple[int, "Sample"]]:
    while True:
        yield from chosen


def wait_for_enter(count: int) -> None:
    """Waits for Enter; where there is no terminal, for Ctrl-C."""
    try:
        input("Enter shows the next " if count > 1 else "")
    except EOFError:
        while True:
            time.sleep(1.0)
