"""How every study runs: items in processes, a JSON line for each, tables."""

import csv
import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from xray_drake.files import write_whole_file
from xray_drake.processes import run_jobs
from xray_drake.provenance import Provenance, Run, current, open_lines

Line = dict[str, Any]
"""What JSON takes: an item of a study, and what was measured of it."""

Table = Sequence[Mapping[str, Any]]
"""Rows; each has the same columns, and numbers in the units that they name."""


@dataclass(frozen=True)
class Study:
    """An experiment.

    Attributes:
        name: of the study, and of its files.
        items: what tells each item from the others, as JSON takes it.
        measure: returns what is measured of an item; it runs in a process of
            its own, so it is a function of a module's top level, or a partial
            of one. Not to depend on other items.
        tables: what the lines of all items come to, by the tables' names.
        seeds: that all follows from.
        settings: those that must be as they were to go on.
        made_by: what would measure; by default this process's code.
    """

    name: str
    items: Sequence[Line]
    measure: Callable[[Line], Line]
    tables: Callable[[list[Line]], Mapping[str, Table]]
    seeds: Sequence[int] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    made_by: Provenance = field(default_factory=current)


def lines_path(study: Study, folder: Path) -> Path:
    """Returns the file of a study's lines; its manifest lies beside it."""
    return folder / f"{study.name}.jsonl"


def run_study(
    study: Study,
    folder: Path,
    *,
    workers: int,
    mix: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Mapping[str, Table]:
    """Measures the items that are missing and writes the tables.

    Args:
        study: what to measure.
        folder: for ``NAME.jsonl``, a line for each item, its manifest, and a
            CSV file for each table; made if it does not exist.
        workers: processes at a time.
        mix: go on with what other code, versions or weights have made.
        progress: told how many items are done, of how many.

    Returns:
        The tables, of all lines in the file.

    Raises:
        ValueError: see :func:`xray_drake.provenance.open_lines`.
        OSError: a file cannot be written.
        RuntimeError: an item could not be measured.
    """
    folder.mkdir(parents=True, exist_ok=True)
    run = Run(
        study.name, study.made_by, seeds=study.seeds, settings=study.settings
    )
    path = lines_path(study, folder)
    with open_lines(path, run, mix=mix) as (lines, add):
        missing = [
            item
            for item in study.items
            if not any(item.items() <= line.items() for line in lines)
        ]
        total = len(study.items)
        begun = total - len(missing)
        progress(begun, total)
        for done, line in enumerate(_measured(study, missing, workers), 1):
            lines.append(line)
            add(line)
            progress(begun + done, total)
        tables = study.tables(lines)
        for name, rows in tables.items():
            write_whole_file(folder / f"{name}.csv", comma_separated(rows))
    return tables


def _measured(
    study: Study, items: Sequence[Line], workers: int
) -> Iterator[Line]:
    # Of a partial, the function's.
    home = getattr(study.measure, "func", study.measure).__module__
    for item, line in run_jobs(
        study.measure,
        items,
        workers=workers,
        preload=[home],
        name=lambda item: f"{study.name}, {item}",
    ):
        yield item | line


def comma_separated(rows: Table) -> bytes:
    """Returns rows as CSV, UTF-8."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]) if rows else [])
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()
