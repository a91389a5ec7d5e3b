"""``xray-drake inspect``."""

import time
from collections.abc import Sequence
from functools import partial
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from xray_drake.cli.errors import errors_as_lines
from xray_drake.cli.options import one_of, replacing
from xray_drake.cli.outputs import check_outputs, check_picture
from xray_drake.splits import SPLITS

if TYPE_CHECKING:
    from xray_drake.dataset.sample import Sample


_HEAP = "Of a heap"
_of_rollout = partial(typer.Option, rich_help_panel="Of a rollout")
_of_page = partial(
    typer.Option, rich_help_panel="How heaps and rollouts are shown"
)
_of_samples = partial(typer.Option, rich_help_panel="Of a dataset")

_What = Annotated[
    Path | None,
    typer.Argument(
        metavar="WHAT",
        help="A rollout's record (search --json), a benchmark's folder or "
        "rollouts.jsonl, or a dataset's folder. Left out, a heap is dropped.",
    ),
]
_Seed = Annotated[
    int | None,
    typer.Option(
        min=0,
        help="Of the heap; of a benchmark's rollout; of the draw of samples "
        "(0).",
    ),
]
_Target = Annotated[
    list[str] | None, typer.Option(help="Of the heap; of samples, repeatable.")
]
_Policy = Annotated[
    str | None,
    typer.Option(help="Whose decision is shown; of a benchmark's rollout."),
]
_Scenario = Annotated[
    str,
    typer.Option(help="Name, or a YAML file.", rich_help_panel=_HEAP),
]
_Rollout = Annotated[
    int | None,
    _of_rollout(
        help="Of a benchmark's records this one, from 0; or choose by --policy "
        "and --seed."
    ),
]
_Step = Annotated[int, _of_rollout(min=1, help="To begin with, from 1.")]
_Opacity = Annotated[
    float,
    _of_page(
        min=0.0,
        max=1.0,
        help="Of the heap: below 1 one sees the target under it.",
    ),
]
_Html = Annotated[
    Path | None,
    _of_page(
        help="Write a page with all layers and steps, in place of a live one."
    ),
]
_Samples = Annotated[int, _of_samples(min=1, help="How many, drawn at random.")]
_Index = Annotated[
    list[int] | None,
    _of_samples(help="This one instead, from 0; repeatable."),
]
_Split = Annotated[str | None, _of_samples(help=f"{one_of(SPLITS)}.")]
_Out = Annotated[
    Path | None,
    _of_samples(
        help="Write the figure here: PNG, PDF or SVG. By default samples.png, "
        "or nothing with --meshcat."
    ),
]
_Meshcat = Annotated[
    bool,
    typer.Option(
        "--meshcat",
        help="Show samples one by one in Meshcat; Ctrl-C ends it. A heap or "
        "rollout is shown there anyway; with --html, too.",
    ),
]


_OF_HEAP = (
    *("cell", "camera", "heap", "target_scale", "target_mass"),
    *("target_color", "num_objects", "meshes", "scale", "occupancy"),
)
"""Options that make a heap."""


@replacing(*_OF_HEAP, panel=_HEAP)
@errors_as_lines()
def inspect(
    context: typer.Context,
    overrides: dict[str, Any],
    what: _What = None,
    seed: _Seed = None,
    target: _Target = None,
    policy: _Policy = None,
    scenario: _Scenario = "demo",
    rollout: _Rollout = None,
    step: _Step = 1,
    opacity: _Opacity = 1.0,
    html: _Html = None,
    samples: _Samples = 8,
    index: _Index = None,
    split: _Split = None,
    out: _Out = None,
    meshcat: _Meshcat = False,
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
    kind = kind_of(what)
    _check_options(kind, context)
    if kind == "dataset":
        assert what is not None
        chosen = choose(
            what,
            samples=samples,
            indices=index,
            split=split,
            targets=target,
            seed=seed or 0,
        )
        _show_samples(chosen, out, meshcat=meshcat)
        return
    # Drake takes a second to import, and datasets do without.
    from xray_drake.cli import inspect_search

    check_outputs(html)
    if kind == "rollout":
        assert what is not None
        replay = inspect_search.search_again(
            what, step, index=rollout, policy=policy, seed=seed
        )
    else:
        if target is not None and len(target) > 1:
            raise ValueError("a heap has one target: give --target once")
        asked = {"seed": seed, "policy.name": policy}
        asked["scene.target"] = target[0] if target else None
        overrides |= {k: v for k, v in asked.items() if v is not None}
        replay = inspect_search.drop(scenario, overrides)
    live = html is None or meshcat
    inspect_search.show(replay, step, opacity, html, live)


_PAGE = ("opacity", "html")
_USES = {
    "heap": (*("scenario", "policy", "target", *_OF_HEAP, *_PAGE),),
    "rollout": ("policy", "rollout", "step", *_PAGE),
    "dataset": ("samples", "index", "split", "target", "out"),
}
"""What is inspected, to the options that it takes beside those of all."""


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


def _check_options(kind: str, context: typer.Context) -> None:
    """Checks that the options given are of what is inspected.

    Raises:
        ValueError: one is not; it is named.
    """
    for name in context.params:
        others = [other for other, uses in _USES.items() if name in uses]
        source = context.get_parameter_source(name)
        given = source is not None and source.name == "COMMANDLINE"
        if given and others and kind not in others:
            raise ValueError(
                f"--{name.replace('_', '-')} is for a "
                f"{' or a '.join(others)}, and this is a {kind}"
            )


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


def _show_samples(
    chosen: Sequence[tuple[int, "Sample"]], out: Path | None, *, meshcat: bool
) -> None:
    """Writes a figure of samples, or shows one after another until Ctrl-C."""
    if out is None and not meshcat:
        out = Path("samples.png")
    if out is not None:
        from xray_drake.inspector.figures import sample_figure

        check_picture(out)
        sample_figure([sample for _, sample in chosen]).savefig(
            out, format=out.suffix.removeprefix(".").lower()
        )
        typer.echo(f"wrote {out}")
    if not meshcat:
        return
    from xray_drake.inspector.dataset import show_sample, start_viewer

    viewer = start_viewer()
    typer.echo(f"open {viewer.url}; Ctrl-C here ends it")
    try:
        for index, sample in cycle(chosen):
            show_sample(viewer, sample)
            typer.echo(
                f"sample {index}: {sample.key}, "
                f"{sample.visible_fraction:.0%} visible"
            )
            _wait_for_enter(len(chosen))
    except KeyboardInterrupt:
        typer.echo("")


def _wait_for_enter(count: int) -> None:
    """Waits for Enter; where there is no terminal, for Ctrl-C."""
    try:
        input("Enter shows the next " if count > 1 else "")
    except EOFError:
        while True:
            time.sleep(1.0)
