"""``xray-drake search``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydrake.systems.framework import Context
from rich.console import Console
from rich.table import Table

from xray_drake.cli.configure import configure
from xray_drake.cli.exits import INTERRUPTED
from xray_drake.cli.progress import progress_bar
from xray_drake.drawing.meshcat_layers import look_at_bin, start_meshcat
from xray_drake.inspector.film_strip import PICTURES, FilmStrip
from xray_drake.inspector.recording import record_search, write_html
from xray_drake.inspector.session import InteractiveSearch
from xray_drake.messages import SearchAction
from xray_drake.scene.heap import Heap
from xray_drake.search.diagram import SearchDiagram, build_search_diagram
from xray_drake.search.record import ActionRecord, SearchRecord, write_record
from xray_drake.search.rollout import run_search
from xray_drake.station.objects import make_heap
from xray_drake.station.scenario import Scenario, ScenarioError


@dataclass
class SearchOptions:
    """What the command line asked for.

    Attributes:
        scenario: a name or a YAML file.
        overrides: see :func:`xray_drake.cli.options.overrides`.
        json, html, film_strip: files to write.
        meshcat: show it live.
    """

    scenario: str
    overrides: dict[str, Any]
    json: Path | None = None
    html: Path | None = None
    meshcat: bool = False
    film_strip: Path | None = None

    @property
    def files(self) -> tuple[Path, ...]:
        """What is to be written."""
        paths = (self.json, self.html, self.film_strip)
        return tuple(path for path in paths if path is not None)


class _Narrator:
    """Prints one line per action."""

    def __init__(self, console: Console) -> None:
        self._console = console

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
        how = record.grasp.kind.value if record.grasp else ""
        parts = [f"{record.step:2d}  {record.outcome.value}"]
        if record.grasp:
            parts.append(f"{what} by {how}")
        parts.append(f"target {record.target_visible_fraction:.0%} visible")
        parts.append(f"support {record.support_before} px")
        if record.reason:
            parts.append(record.reason)
        self._console.print("  ".join(parts), highlight=False, soft_wrap=True)


def check_output(path: Path | None) -> None:
    """Checks that a file can be written, before the work for it is done.

    Args:
        path: of the file; None for none.

    Raises:
        ScenarioError: it is a folder, or in none.
    """
    if path is not None and path.is_dir():
        raise ScenarioError(
            f"cannot write {path}: it is a folder; name a file in it"
        )
    if path is not None and not path.absolute().parent.is_dir():
        raise ScenarioError(
            f"cannot write {path}: the folder "
            f"{path.absolute().parent} does not exist"
        )


def run(options: SearchOptions, console: Console) -> int:
    """Runs the search and returns the exit status.

    Raises:
        ScenarioError: bad input.
        OSError: a file that cannot be written.
        RuntimeError: the simulation failed, or no heap came to rest.
    """
    scenario = configure(options.scenario, options.overrides)
    strip = options.film_strip
    if strip is not None and strip.suffix.lower() not in PICTURES:
        raise ScenarioError(
            f"no film strip can be written to {strip}: its name should end in "
            f"{', '.join(PICTURES)}"
        )
    for path in options.files:
        check_output(path)
    narrator = _Narrator(console)
    if options.meshcat:
        return _run_live(scenario, options, narrator, console)
    film = FilmStrip()
    observers = (narrator, film) if strip is not None else (narrator,)
    heap = _drop(scenario, console)
    if options.html is None:
        diagram = build_search_diagram(scenario, heap=heap)
        record = run_search(diagram, observers=observers)
    else:
        diagram = build_search_diagram(
            scenario, heap=heap, meshcat=start_meshcat()
        )
        record, meshcat = record_search(diagram, observers=observers)
    if options.json is not None:
        write_record(record, options.json)
    if options.html is not None:
        write_html(meshcat, options.html)
    if strip is not None and film.snapshots:
        film.write(strip)
    _summarize(record, options, console)
    return INTERRUPTED if record.end == "interrupted" else 0


def _run_live(
    scenario: Scenario,
    options: SearchOptions,
    narrator: _Narrator,
    console: Console,
) -> int:
    for option, path in (
        ("--html", options.html),
        ("--film-strip", options.film_strip),
    ):
        if path is not None:
            raise ScenarioError(
                f"{option} records a search from end to end: leave out "
                "--meshcat"
            )
    meshcat = start_meshcat()
    console.print(
        f"open {meshcat.web_url()} and press run, step or new heap "
        "(under Open Controls); "
        "Ctrl-C here ends it"
    )
    session = InteractiveSearch(scenario, meshcat, observers=(narrator,))
    session.new_heap(scenario.seed)
    look_at_bin(meshcat, from_afar=scenario.gripper.execution == "contact")
    session.loop()
    record = session.record
    if record is not None:
        if options.json is not None:
            write_record(record, options.json)
        _summarize(record, options, console)
    return 0


def _drop(scenario: Scenario, console: Console) -> Heap:
    count = scenario.scene.num_objects
    with progress_bar(console, f"dropping {count} objects") as progress:
        heap = make_heap(scenario, progress=progress)
    console.print(
        f"heap of seed {heap.seed}: {heap.target.name} under "
        f"{len(heap.objects)} objects",
        highlight=False,
    )
    return heap


def _summarize(
    record: SearchRecord, options: SearchOptions, console: Console
) -> None:
    table = Table(title=f"{record.policy} on seed {record.seed}")
    for column in ("end", "actions", "target visible at the start", "support"):
        table.add_column(column)
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
    console.print(table)
    for path in options.files:
        if path.exists():
            console.print(f"wrote {path}", highlight=False, soft_wrap=True)
