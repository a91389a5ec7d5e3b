"""``xray-drake evaluate``."""

import errno
import json as json_format
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from xray_drake.choices import DTYPES, WITHOUT_NETWORK
from xray_drake.cli.errors import errors_as_lines
from xray_drake.cli.options import Dataset, Dtype, OfSplit, OfTargets
from xray_drake.dataset.manifest import read_manifest
from xray_drake.files import sole_writer, write_whole_file
from xray_drake.provenance import Run, current, describe, record_run

if TYPE_CHECKING:
    from xray_drake.dataset.sample import Sample
    from xray_drake.inspector.figures import Example
    from xray_drake.training.evaluation import Predictor

app = typer.Typer(
    help="Say how good an inference is on labelled images.",
    no_args_is_help=True,
)

_PICTURES = (".png", ".pdf", ".svg")


@app.command()
def occupancy(
    dataset: Dataset,
    weights: Annotated[
        list[Path] | None,
        typer.Option(help="Of a network; repeatable."),
    ] = None,
    exact: Annotated[
        bool, typer.Option("--exact/--no-exact", help="Exact inference, too.")
    ] = True,
    expected: Annotated[
        bool,
        typer.Option(
            "--expected", help="The label guessed without a network, too."
        ),
    ] = False,
    unscaled: Annotated[
        bool,
        typer.Option(
            "--unscaled",
            help="Networks of a single box once more, without scaling the "
            "image to the box.",
        ),
    ] = False,
    posterior: Annotated[
        bool,
        typer.Option(
            "--posterior",
            help="Networks' posterior, too: where the target probably is.",
        ),
    ] = False,
    dtype: Dtype = None,
    split: OfSplit = None,
    target: OfTargets = None,
    images: Annotated[
        int | None,
        typer.Option(min=1, help="How many, drawn at random; by default all."),
    ] = None,
    json: Annotated[
        Path | None, typer.Option(help="Write the results here, by image too.")
    ] = None,
    figure: Annotated[
        Path | None,
        typer.Option(help="Draw examples here: PNG, PDF or SVG."),
    ] = None,
    examples: Annotated[
        int, typer.Option(min=1, help="In the figure: the first images.")
    ] = 6,
    worst: Annotated[
        bool,
        typer.Option(
            "--worst",
            help="In the figure: those of the lowest IoU by the first "
            "--weights, or else by exact inference.",
        ),
    ] = False,
    noise: Annotated[
        bool, typer.Option("--noise", help="Depth as a real sensor sees it.")
    ] = False,
    height_offset: Annotated[
        float,
        typer.Option(
            help="Tell inference that the camera is so much higher, m."
        ),
    ] = 0.0,
    focal_error: Annotated[
        float,
        typer.Option(
            help="Tell inference that the focal length is larger by this share."
        ),
    ] = 0.0,
    incomplete: Annotated[
        bool,
        typer.Option(
            "--incomplete", help="Of a dataset that is being made, too."
        ),
    ] = False,
    seed: Annotated[
        int, typer.Option(min=0, help="Of the draw, noise and intervals.")
    ] = 0,
) -> None:
    """Compare predicted distributions with their labels: Table I.

    Intervals are 95 % bootstraps over heaps. The camera's errors and the noise
    change what inference sees; the labels stay.
    """
    with errors_as_lines():
        _check_outputs(json, figure)
        predictors = _predictors(
            weights or [],
            exact=exact,
            expected=expected,
            unscaled=unscaled,
            posterior=posterior,
            dtype=dtype or DTYPES[0],
        )

        from xray_drake.dataset.augmentation import DepthNoise
        from xray_drake.dataset.reader import OccupancyDataset
        from xray_drake.training.disturbance import Disturbance
        from xray_drake.training.evaluation import evaluate, markdown_table

        disturb = Disturbance(
            noise=DepthNoise() if noise else None,
            height_offset=height_offset,
            focal_error=focal_error,
            seed=seed,
        )
        data = OccupancyDataset(
            dataset, split=split, targets=target or None, incomplete=incomplete
        )
        made_by = current(
            weights=weights or [], dtype=(dtype or DTYPES[0]) if weights else ""
        )
        settings = {
            "dataset": str(dataset),
            "split": split,
            "targets": target or None,
            "weights": [str(path) for path in weights or []],
            "dtype": made_by.dtype,
            "noise": noise,
            "height_offset": height_offset,
            "focal_error": focal_error,
            "seed": seed,
        }
        manifest = read_manifest(dataset)
        run = Run(
            "evaluate",
            made_by,
            manifest.scenario,
            [seed],
            {**settings, "fingerprint": manifest.fingerprint()},
        )
        chosen = _draw(len(data), images, seed)

        def sample(index: int) -> "Sample":
            return disturb(data.sample(index))

        with ExitStack() as stack:
            # A pipe takes no manifest.
            files = [
                path
                for path in (json, figure)
                if path is not None and (path.is_file() or not path.exists())
            ]
            for path in files:
                stack.enter_context(sole_writer(path))
            results = evaluate(
                _with_progress(chosen, sample), predictors, seed=seed
            )
            typer.echo(markdown_table(results))
            typer.echo(f"\n{describe([made_by], seeds=[seed])}")
            if json is not None:
                report = {
                    **settings,
                    "provenance": made_by.to_dict(),
                    "predictors": {
                        name: result.to_dict()
                        for name, result in results.items()
                    },
                }
                text = json_format.dumps(report, indent=1, allow_nan=False)
                write_whole_file(json, f"{text}\n".encode())
                typer.echo(f"wrote {json}")
            if figure is not None:
                ious = {
                    name: [record.counts.iou for record in result.records]
                    for name, result in results.items()
                }
                drawn = _choose(ious, examples, worst=worst)
                _write_figure(
                    [
                        _example(
                            sample(chosen[i]),
                            predictors,
                            {name: values[i] for name, values in ious.items()},
                        )
                        for i in drawn
                    ],
                    figure,
                )
                typer.echo(f"wrote {figure}")
            for path in files:
                record_run(path, run)


def _choose(
    ious: Mapping[str, Sequence[float]], examples: int, *, worst: bool
) -> Sequence[int]:
    """Returns which images the figure shows.

    Raises:
        ValueError: there is none.
    """
    from xray_drake.inspector.figures import choose_examples

    drawn = choose_examples(next(iter(ious.values())), examples, worst=worst)
    if not drawn:
        raise ValueError("no image has an IoU to find the worst by")
    return drawn


def _check_outputs(json: Path | None, figure: Path | None) -> None:
    """Finds out before the work is done that its result has no place.

    Raises:
        ValueError: a figure's name does not end as a picture's.
        OSError: a folder does not exist, or the file is a folder.
    """
    if figure is not None and figure.suffix.lower() not in _PICTURES:
        raise ValueError(
            f"no picture can be written to {figure}: its name should end in "
            ".png, .pdf or .svg"
        )
    for path in (json, figure):
        if path is None:
            continue
        if path.is_dir():
            number = errno.EISDIR
        elif not path.absolute().parent.is_dir():
            number = errno.ENOENT
        else:
            continue
        raise OSError(number, os.strerror(number), str(path))


def _predictors(
    weights: Sequence[Path],
    *,
    exact: bool,
    expected: bool,
    unscaled: bool,
    posterior: bool,
    dtype: str,
) -> dict[str, "Predictor"]:
    """Returns networks, then what needs none, by the names of their rows.

    Raises:
        ValueError: there would be none, or the same file is given twice.
    """
    from xray_drake.training.predictors import (
        exact_predictor,
        expected_predictor,
        learned_predictor,
    )

    if not weights and not exact and not expected:
        raise ValueError(
            "nothing to evaluate: give --weights, or leave out --no-exact"
        )
    if len(set(weights)) < len(weights):
        raise ValueError("the same --weights are given twice")
    stems = [*WITHOUT_NETWORK, *(path.stem for path in weights)]
    named = {
        path.stem if stems.count(path.stem) == 1 else str(path): path
        for path in weights
    }
    learned = partial(learned_predictor, dtype=dtype)
    found = {name: learned(path) for name, path in named.items()}
    if unscaled:
        found |= {
            f"{name}, unscaled": learned(path, scaling=False)
            for name, path in named.items()
        }
    if posterior:
        found |= {
            f"{name}, posterior": learned(path, output="posterior")
            for name, path in named.items()
        }
    if expected:
        found["expected"] = expected_predictor()
    return found | ({"exact": exact_predictor()} if exact else {})


def _draw(total: int, images: int | None, seed: int) -> list[int]:
    """Returns the indices of the images, in the dataset's order."""
    from xray_drake.seeding import stream

    order = stream(seed, "evaluate").permutation(total)[:images]
    return sorted(order.tolist())


def _with_progress(
    indices: Sequence[int], sample: Callable[[int], "Sample"]
) -> Iterator["Sample"]:
    console = Console(stderr=True)
    with Progress(
        TextColumn("images"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    ) as bars:
        for index in bars.track(indices):
            yield sample(index)


def _example(
    sample: "Sample",
    predictors: Mapping[str, "Predictor"],
    ious: Mapping[str, float],
) -> "Example":
    from xray_drake.inspector.figures import Example

    predictions = {name: ask(sample) for name, ask in predictors.items()}
    return Example(sample=sample, predictions=predictions, ious=ious)


def _write_figure(examples: Sequence["Example"], path: Path) -> None:
    from xray_drake.inspector.figures import prediction_figure

    prediction_figure(examples).savefig(
        path, format=path.suffix.removeprefix(".").lower()
    )
