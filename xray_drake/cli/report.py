"""``xray-drake report``."""

from pathlib import Path
from typing import Annotated

import typer

from xray_drake.cli.errors import errors_as_lines


@errors_as_lines()
def report(
    folders: Annotated[
        list[Path],
        typer.Argument(metavar="DIR", help="Folders of xray-drake benchmark."),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="Folder to write to; by default the first."),
    ] = None,
) -> None:
    """Write the paper's Table II, Figure 6 and more from rollouts."""
    from xray_drake.benchmark.comparison import make_report
    from xray_drake.benchmark.records import collect
    from xray_drake.benchmark.report import success_table, write_report

    collection = collect(folders)
    made = make_report(collection)
    paths = write_report(made, out or folders[0])
    if collection.repeated:
        typer.echo(
            f"xray-drake: repeated rollouts, left out: "
            f"{collection.repeated} (the first of each counts)",
            err=True,
        )
    for line in (*success_table(made), "", *(f"wrote {p}" for p in paths)):
        typer.echo(line)
