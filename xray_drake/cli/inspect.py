"""``xray-drake inspect``."""

import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from xray_drake.cli.errors import errors_as_lines

if TYPE_CHECKING:
    from xray_drake.dataset.sample import Sample


def inspect(
    dataset: Annotated[
        Path, typer.Argument(metavar="DATASET", help="Holds dataset.json.")
    ],
    samples: Annotated[
        int, typer.Option(min=1, help="How many, drawn at random.")
    ] = 8,
    index: Annotated[
        list[int] | None,
        typer.Option(help="This one instead, from 0; repeatable."),
    ] = None,
    split: Annotated[
        str | None, typer.Option(help="train, validation or test.")
    ] = None,
    target: Annotated[
        list[str] | None, typer.Option(help="Of this target; repeatable.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the draw.")] = 0,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Write the figure here: PNG, PDF or SVG. By default "
            "samples.png, or nothing with --meshcat."
        ),
    ] = None,
    meshcat: Annotated[
        bool,
        typer.Option(
            "--meshcat", help="Show them one by one in Meshcat; Ctrl-C ends it."
        ),
    ] = False,
) -> None:
    """Show samples of a dataset as a figure or in Meshcat."""
    with errors_as_lines():
        chosen = choose(
            dataset,
            samples=samples,
            indices=index,
            split=split,
            targets=target,
            seed=seed,
        )
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
    from xray_drake.drawing.sample_figure import sample_figure

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
