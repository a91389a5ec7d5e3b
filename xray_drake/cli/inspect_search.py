"""``xray-drake inspect`` for heaps and rollouts: the Meshcat page."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer
from rich.console import Console

from xray_drake.cli.configure import configure
from xray_drake.cli.outputs import check_outputs
from xray_drake.cli.progress import progress_bar
from xray_drake.drawing.meshcat_layers import start_meshcat
from xray_drake.inspector.page import InspectorPage
from xray_drake.inspector.recording import write_html
from xray_drake.inspector.replay import (
    Replay,
    difference,
    first_decision,
    load_rollout,
    remake_heap,
    replay_search,
)
from xray_drake.inspector.view import ReplayView, look_at_heap
from xray_drake.station.objects import make_heap


@dataclass(frozen=True)
class PageOptions:
    """How heaps and rollouts are shown.

    Attributes:
        step: to begin with, from 1.
        opacity: of the heap.
        html: write a page here.
        live: serve a page with controls.
    """

    step: int = 1
    opacity: float = 1.0
    html: Path | None = None
    live: bool = True


def inspect_heap(
    scenario: str, overrides: Mapping[str, Any], options: PageOptions
) -> None:
    """Drops a heap, lets the policy decide once, and shows it.

    Args:
        scenario: a name or a YAML file.
        overrides: see :func:`xray_drake.cli.options.overrides`.
        options: how.

    Raises:
        ScenarioError: bad input.
        OSError: the page cannot be written.
        RuntimeError: no heap came to rest.
    """
    configured = configure(scenario, overrides)
    check_outputs(options.html)
    with progress_bar(Console(), "dropping the heap") as progress:
        heap = make_heap(configured, progress=progress)
    _show(first_decision(configured, heap), options)


def inspect_rollout(
    path: Path,
    options: PageOptions,
    *,
    index: int | None,
    policy: str | None,
    seed: int | None,
) -> None:
    """Runs a recorded rollout again and shows its decisions.

    Args:
        path: see :func:`xray_drake.inspector.replay.load_rollout`.
        options: how.
        index: of several rollouts this one, from 0.
        policy: of several, one of this policy …
        seed: … and of this seed.

    Raises:
        ValueError: bad input, or the rollout cannot be made again.
        OSError: a file cannot be read, or the page not written.
        RuntimeError: the simulation failed.
    """
    rollout = load_rollout(path, index=index, policy=policy, seed=seed)
    check_outputs(options.html)
    actions = len(rollout.record["actions"])
    if options.step > actions + 1:
        raise ValueError(
            f"{path}: there is no step {options.step}: the rollout has "
            f"{actions}, and {actions + 1} is its end"
        )
    with progress_bar(Console(), "dropping the heap") as progress:
        heap = remake_heap(rollout, progress=progress)
    with progress_bar(Console(), "searching it again") as progress:
        replay = replay_search(rollout.scenario, heap, progress=progress)
    otherwise = difference(rollout.record, replay.record)
    if otherwise:
        typer.echo(f"{path}: {otherwise}")
    _show(replay, options)


def _show(replay: Replay, options: PageOptions) -> None:
    meshcat = start_meshcat()
    look_at_heap(meshcat)
    view = ReplayView(replay, meshcat)
    view.show(options.step)
    view.set_heap_opacity(options.opacity)
    if options.html is not None:
        view.record()
        write_html(meshcat, options.html)
        typer.echo(f"wrote {options.html}")
    if not options.live:
        return
    typer.echo(
        f"open {meshcat.web_url()}; its controls are under Open Controls; "
        "Ctrl-C here ends it"
    )
    InspectorPage(view, opacity=options.opacity, announce=typer.echo).loop()
