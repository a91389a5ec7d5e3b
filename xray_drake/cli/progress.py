"""A bar for a job that takes seconds."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)


@contextmanager
def progress_bar(
    console: Console, job: str
) -> Iterator[Callable[[float], None]]:
    """Shows a bar while a job lasts; nothing where there is no terminal.

    Args:
        console: where.
        job: what it says.

    Yields:
        A function to be called with the share done, in [0, 1].
    """
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    ) as bars:
        task = bars.add_task(job, total=1.0)
        yield lambda share: bars.update(task, completed=share)
