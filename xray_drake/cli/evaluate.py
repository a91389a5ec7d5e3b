"""``xray-drake evaluate``."""

import json as json_format
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from xray_drake.choices import DTYPES, WITHOUT_NETWORK, current_occupancy
from xray_drake.cli.errors import errors_as_lines
from xray_drake.cli.options import (
    Dataset,
    Dtype,
    Incomplete,
    OfSplit,
    OfTargets,
    Seed,
)
from xray_drake.cli.outputs import check_outputs
from xray_drake.cli.progress import counting_bar
from xray_drake.dataset.manifest import read_manifest
from xray_drake.files import sole_writer, write_whole_file
from xray_drake.provenance import Run, current, describe, record_run

if TYPE_CHECKING:
    from xray_drake.dataset.sample import Sample
    from xray_drake.training.evaluation import Predictor

app = typer.Typer(
    help="Say how good an inference is on labelled images.",
    no_args_is_help=True,
)

_Weights = Annotated[
    list[Path] | None, typer.Option(help="Of a network; repeatable.")
]
_Geometric = Annotated[bool, typer.Option(help="Geometric inference, too.")]
_GeometricLabel = Annotated[
    bool,
    typer.Option(
        "--geometric-label",
        help="The label guessed without a network, too.",
    ),
]
_Unscaled = Annotated[
    bool,
    typer.Option(
        "--unscaled",
        help="Networks of a single box once more, without scaling the image "
        "to the box.",
    ),
]
_Posterior = Annotated[
    bool,
    typer.Option(
        "--posterior",
        help="Networks' posterior, too: where the target probably is.",
    ),
]
_Images = Annotated[
    int | None,
    typer.Option(min=1, help="How many, drawn at random; by default all."),
]
_Json = Annotated[
    Path | None, typer.Option(help="Write the results here, by image too.")
]
_Figure = Annotated[
    Path | None, typer.Option(help="Draw examples here: PNG, PDF or SVG.")
]
_Examples = Annotated[
    int, typer.Option(min=1, help="In the figure: the first images.")
]
_Worst = Annotated[
    bool,
    typer.Option(
        "--worst",
        help="In the figure: those of the lowest IoU by the first --weights, "
        "or else by geometric inference.",
    ),
]
_Noise = Annotated[
    bool, typer.Option("--noise", help="Depth as a real sensor sees it.")
]
_HeightOffset = Annotated[
    float,
    typer.Option(help="Tell inference that the camera is so much higher, m."),
]
_FocalError = Annotated[
    float,
    typer.Option(
        help="Tell inference that the focal length is larger by this share."
    ),
]
_OldGeometric = Annotated[
    bool | None, typer.Option("--exact/--no-exact", hidden=True)
]
_OldGeometricLabel = Annotated[bool, typer.Option("--expected", hidden=True)]


@app.command()
@errors_as_lines()
def occupancy(
    dataset: Dataset,
    weights: _Weights = None,
    geometric: _Geometric = True,
    geometric_label: _GeometricLabel = False,
    exact: _OldGeometric = None,
    expected: _OldGeometricLabel = False,
    unscaled: _Unscaled = False,
    posterior: _Posterior = False,
    dtype: Dtype = None,
    split: OfSplit = None,
    target: OfTargets = None,
    images: _Images = None,
    json: _Json = None,
    figure: _Figure = None,
    examples: _Examples = 6,
    worst: _Worst = False,
    noise: _Noise = False,
    height_offset: _HeightOffset = 0.0,
    focal_error: _FocalError = 0.0,
    incomplete: Incomplete = False,
    seed: Seed = 0,
) -> None:
    """Compare predicted distributions with their labels: Table I.

    Intervals are 95 % bootstraps over heaps. The camera's errors and the noise
    change what inference sees; the labels stay.
    """
    check_outputs(json, picture=figure)
    files, used = weights or [], dtype or DTYPES[0]
    predictors = _predictors(
        files,
        without_network=_asked(geometric, geometric_label, exact, expected),
        unscaled=unscaled,
        posterior=posterior,
        dtype=used,
    )

    from xray_drake.dataset.augmentation import DepthNoise
    from xray_drake.dataset.reader import OccupancyDataset
    from xray_drake.seeding import stream
    from xray_drake.training.disturbance import Disturbance

    sensor = DepthNoise() if noise else None
    disturb = Disturbance(sensor, height_offset, focal_error, seed)
    data = OccupancyDataset(
        dataset, split=split, targets=target or None, incomplete=incomplete
    )
    made_by = current(weights=files, dtype=used if files else "")
    manifest = read_manifest(dataset)
    settings = {
        "dataset": str(dataset),
        "split": split,
        "targets": target or None,
        "weights": [str(path) for path in files],
        "dtype": made_by.dtype,
        "noise": noise,
        "height_offset": height_offset,
        "focal_error": focal_error,
        "seed": seed,
        "fingerprint": manifest.fingerprint(),
    }
    run = Run("evaluate", made_by, manifest.scenario, [seed], settings)

    def sample(index: int) -> "Sample":
        return disturb(data.sample(index))

    drawn = stream(seed, "evaluate").permutation(len(data))[:images]
    samples = [partial(sample, index) for index in sorted(drawn.tolist())]
    with _recorded(run, json, figure):
        ious = _evaluate(samples, predictors, run, json)
        if figure is not None:
            _draw_figure(samples, predictors, ious, figure, examples, worst)


@contextmanager
def _recorded(run: Run, *paths: Path | None) -> Iterator[None]:
    """Writes files alone, a manifest beside each; a pipe takes none."""
    written = [
        path
        for path in paths
        if path is not None and (path.is_file() or not path.exists())
    ]
    with ExitStack() as stack:
        for path in written:
            stack.enter_context(sole_writer(path))
        yield
        for path in written:
            record_run(path, run)


def _asked(
    geometric: bool, label: bool, exact: bool | None, expected: bool
) -> list[str]:
    """Returns what needs no network; old options are accepted with a line."""
    if exact is not None:
        current_occupancy("exact")
        geometric = exact
    if expected:
        current_occupancy("expected")
    asked = {"geometric_label": label or expected, "geometric": geometric}
    return [name for name, also in asked.items() if also]


def _evaluate(
    samples: Sequence[Callable[[], "Sample"]],
    predictors: Mapping[str, "Predictor"],
    run: Run,
    json: Path | None,
) -> dict[str, list[float]]:
    """Prints and writes the results; returns the IoU of each image."""
    from xray_drake.training.evaluation import evaluate, markdown_table

    (seed,) = run.seeds
    with counting_bar(Console(stderr=True), "images") as progress:

        def told() -> Iterator["Sample"]:
            for done, sample in enumerate(samples, 1):
                yield sample()
                progress(done, len(samples))

        results = evaluate(told(), predictors, seed=seed)
    typer.echo(markdown_table(results))
    typer.echo(f"\n{describe([run.provenance], seeds=run.seeds)}")
    if json is not None:
        settings = dict(run.settings)
        del settings["fingerprint"]
        report = {
            **settings,
            "provenance": run.provenance.to_dict(),
            "predictors": {
                name: result.to_dict() for name, result in results.items()
            },
        }
        text = json_format.dumps(report, indent=1, allow_nan=False)
        write_whole_file(json, f"{text}\n".encode())
        typer.echo(f"wrote {json}")
    return {
        name: [record.counts.iou for record in result.records]
        for name, result in results.items()
    }


def _draw_figure(
    samples: Sequence[Callable[[], "Sample"]],
    predictors: Mapping[str, "Predictor"],
    ious: Mapping[str, Sequence[float]],
    path: Path,
    examples: int,
    worst: bool,
) -> None:
    from xray_drake.inspector.figures import (
        Example,
        choose_examples,
        prediction_figure,
    )

    drawn = choose_examples(next(iter(ious.values())), examples, worst=worst)
    if not drawn:
        raise ValueError("no image has an IoU to find the worst by")
    found = []
    for i in drawn:
        sample = samples[i]()
        predictions = {name: ask(sample) for name, ask in predictors.items()}
        own = {name: values[i] for name, values in ious.items()}
        found.append(Example(sample, predictions, own))
    kind = path.suffix.removeprefix(".").lower()
    prediction_figure(found).savefig(path, format=kind)
    typer.echo(f"wrote {path}")


def _predictors(
    weights: Sequence[Path],
    *,
    without_network: Sequence[str],
    unscaled: bool,
    posterior: bool,
    dtype: str,
) -> dict[str, "Predictor"]:
    """Returns networks, then what needs none, by the names of their rows.

    Raises:
        ValueError: there would be none, or the same file is given twice.
    """
    from xray_drake.training.predictors import predictor

    if not weights and not without_network:
        raise ValueError(
            "nothing to evaluate: give --weights, or leave out --no-geometric"
        )
    if len(set(weights)) < len(weights):
        raise ValueError("the same --weights are given twice")
    stems = [*WITHOUT_NETWORK, *(path.stem for path in weights)]
    named = {
        path.stem if stems.count(path.stem) == 1 else str(path): path
        for path in weights
    }
    kinds = (
        ("", "learned", True, True),
        (", unscaled", "learned", False, unscaled),
        (", posterior", "posterior", True, posterior),
    )
    found = {
        f"{name}{suffix}": predictor(
            kind, weights=path, dtype=dtype, scaling=scaling
        )
        for suffix, kind, scaling, asked in kinds
        if asked
        for name, path in named.items()
    }
    return found | {name: predictor(name) for name in without_network}
