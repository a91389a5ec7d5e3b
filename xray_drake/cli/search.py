"""``xray-drake search``."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import typer
from pydrake.systems.framework import Context
from rich.console import Console
from rich.table import Table

from xray_drake.cli.configure import configure
from xray_drake.cli.exits import INTERRUPTED
from xray_drake.cli.outputs import check_outputs
from xray_drake.cli.progress import progress_bar
from xray_drake.drawing.meshcat_layers import look_at_bin, start_meshcat
from xray_drake.inspector.film_strip import FilmStrip
from xray_drake.inspector.recording import record_search, write_html
from xray_drake.inspector.session import InteractiveSearch
from xray_drake.messages import SearchAction
from xray_drake.scene import heap_file
from xray_drake.scene.heap import Heap
from xray_drake.search.diagram import SearchDiagram, build_search_diagram
from xray_drake.search.record import ActionRecord, SearchRecord, write_record
from xray_drake.search.rollout import run_search
from xray_drake.station.objects import make_heap
from xray_drake.station.scenario import Scenario

_MOST = 5
"""Candidates of a ranking that are told."""


class _Narrator:
    """Prints a line per action, its ranking, and what was passed over why."""

    def decided(
        self, diagram: SearchDiagram, context: Context, action: SearchAction
    ) -> None:
        pass

    def ended(
        self, diagram: SearchDiagram, context: Context, record: ActionRecord
    ) -> None:
        found = record.object == diagram.heap.target.name
        what = "the target" if found else record.object or "nothing"
        if record.is_target and not found:
            what += ", taken for the target,"
        parts = [f"{record.step:2d}  {record.outcome.value}"]
        if record.grasp:
            parts.append(f"{what} by {record.grasp.kind.value}")
        parts.append(f"target {record.target_visible_fraction:.0%} visible")
        parts.append(f"support {record.support_before} px")
        if record.reason:
            parts.append(record.reason)
        typer.echo("  ".join(parts))
        ranked = [f"{c.name} {c.score:.4g}" for c in record.ranking[:_MOST]]
        others = len(record.ranking) - len(ranked)
        if ranked:
            more = f" and {others} more" if others else ""
            typer.echo(f"      ranked: {', '.join(ranked)}{more}")
        reasons: dict[str, list[str]] = {}
        for candidate in record.ranking:
            if candidate.passed_over:
                alike = reasons.setdefault(candidate.passed_over, [])
                alike.append(candidate.name)
        for reason, (name, *alike) in reasons.items():
            more = f" and {len(alike)} more" if alike else ""
            typer.echo(f"      passed over {name}{more}: {reason}")


def run(
    scenario: str,
    overrides: Mapping[str, Any],
    *,
    json: Path | None,
    html: Path | None,
    film_strip: Path | None,
    meshcat: bool,
    save_heap: Path | None = None,
) -> int:
    """Runs the search and returns the exit status.

    Args:
        scenario: a name, or a YAML file.
        overrides: see :func:`xray_drake.cli.options.overrides`.
        json: file for the record.
        html: file for a page that plays the search.
        film_strip: file for a picture of each decision.
        meshcat: show it live, on a page with buttons.
        save_heap: file for the heap as it lies before the first action.

    Raises:
        ValueError: bad input.
        OSError: a file that cannot be written.
        RuntimeError: the simulation failed, or no heap came to rest.
    """
    configured = configure(scenario, overrides)
    check_outputs(json, html, save_heap, picture=film_strip)
    if meshcat:
        for option, path in (
            ("--html", html),
            ("--film-strip", film_strip),
            ("--save-heap", save_heap),
        ):
            if path is not None:
                raise ValueError(
                    f"{option} records a search from end to end: leave out "
                    "--meshcat"
                )
        _run_live(configured, json)
        return 0
    film = FilmStrip()
    observers = (_Narrator(), film) if film_strip else (_Narrator(),)
    heap = _drop(configured)
    if save_heap is not None:
        heap_file.save_heap(heap, save_heap, configured.cell.bin)
    diagram = build_search_diagram(
        configured, heap=heap, meshcat=start_meshcat() if html else None
    )
    if html is None:
        record = run_search(diagram, observers=observers)
    else:
        record, page = record_search(diagram, observers=observers)
        write_html(page, html)
    if json is not None:
        write_record(record, json)
    if film_strip is not None and film.snapshots:
        film.write(film_strip)
    _summarize(record, [json, html, film_strip, save_heap])
    return INTERRUPTED if record.end == "interrupted" else 0


def _run_live(scenario: Scenario, json: Path | None) -> None:
    meshcat = start_meshcat()
    typer.echo(
        f"open {meshcat.web_url()} and press run, step or new heap "
        "(under Open Controls); "
        "Ctrl-C here ends it"
    )
    session = InteractiveSearch(scenario, meshcat, observers=(_Narrator(),))
    session.new_heap(scenario.seed)
    look_at_bin(meshcat, from_afar=scenario.gripper.execution == "contact")
    session.loop()
    if session.record is not None:
        if json is not None:
            write_record(session.record, json)
        _summarize(session.record, [json])


def _drop(scenario: Scenario) -> Heap:
    scene = scenario.scene
    what = Path(scene.heap_file).name or f"{scene.num_objects} objects"
    with progress_bar(Console(), f"dropping {what}") as progress:
        heap = make_heap(scenario, progress=progress)
    name = Path(scene.heap_file).name or f"seed {heap.seed}"
    typer.echo(
        f"heap of {name}: {heap.target.name} under {len(heap.objects)} objects"
    )
    return heap


def _summarize(record: SearchRecord, files: Sequence[Path | None]) -> None:
    table = Table(
        *("end", "actions", "target visible at the start", "support"),
        title=f"{record.policy} on seed {record.seed}",
    )
    start = record.start.get("target_visible_fraction")
    supports = [a.support_before for a in record.actions]
    if record.actions and record.actions[-1].support_after >= 0:
        supports.append(record.actions[-1].support_after)
    table.add_row(
        record.end or "not ended",
        f"{record.num_actions} of {record.horizon}",
        "unknown" if start is None else f"{start:.0%}",
        " → ".join(map(str, supports)),
    )
    Console().print(table)
    for path in files:
        if path is not None and path.exists():
            typer.echo(f"wrote {path}")
