"""``xray-drake inspect`` for heaps and rollouts: the Meshcat page."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import typer
from rich.console import Console

from xray_drake.cli.configure import configure
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


def drop(scenario: str, overrides: Mapping[str, Any]) -> Replay:
    """Drops a heap and lets the policy decide once.

    Args:
        scenario: a name or a YAML file.
        overrides: see :func:`xray_drake.cli.options.overrides`.

    Raises:
        ScenarioError: bad input.
        RuntimeError: no heap came to rest.
    """
    configured = configure(scenario, overrides)
    with progress_bar(Console(), "dropping the heap") as progress:
        heap = make_heap(configured, progress=progress)
    return first_decision(configured, heap)


def search_again(path: Path, step: int, **which: Any) -> Replay:
    """Runs a recorded rollout again; says where it goes otherwise.

    Args:
        path: see :func:`xray_drake.inspector.replay.load_rollout`.
        step: that is to be shown, from 1.
        **which: of several rollouts, see there.

    Raises:
        ValueError: bad input, or the rollout cannot be made again.
        OSError: a file cannot be read.
        RuntimeError: the simulation failed.
    """
    rollout = load_rollout(path, **which)
    actions = len(rollout.record["actions"])
    if step > actions + 1:
        raise ValueError(
            f"{path}: there is no step {step}: the rollout has "
            f"{actions}, and {actions + 1} is its end"
        )
    with progress_bar(Console(), "dropping the heap") as progress:
        heap = remake_heap(rollout, progress=progress)
    with progress_bar(Console(), "searching it again") as progress:
        replay = replay_search(rollout.scenario, heap, progress=progress)
    otherwise = difference(rollout.record, replay.record)
    if otherwise:
        typer.echo(f"{path}: {otherwise}")
    return replay


def show(
    replay: Replay, step: int, opacity: float, html: Path | None, live: bool
) -> None:
    """Shows a heap or a search.

    Args:
        replay: what.
        step: to begin with, from 1.
        opacity: of the heap.
        html: write a page here.
        live: serve a page with controls.

    Raises:
        OSError: the page cannot be written.
    """
    meshcat = start_meshcat()
    look_at_heap(meshcat)
    view = ReplayView(replay, meshcat)
    view.show(step)
    view.set_heap_opacity(opacity)
    if html is not None:
        view.record()
        write_html(meshcat, html)
        typer.echo(f"wrote {html}")
    if not live:
        return
    typer.echo(
        f"open {meshcat.web_url()}; its controls are under Open Controls; "
        "Ctrl-C here ends it"
    )
    InspectorPage(view, opacity=opacity, announce=typer.echo).loop()
