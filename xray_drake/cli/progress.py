"""Bars for jobs that take seconds and more."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text


class _Rate(ProgressColumn):
    def render(self, task: Task) -> Text:
        return Text(f"{task.speed:.2f}/s" if task.speed else "")


def _bars(
    console: Console, *columns: ProgressColumn, transient: bool = True
) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        *columns,
        console=console,
        transient=transient,
        disable=not console.is_terminal,
        speed_estimate_period=300,
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
    left = TimeElapsedColumn(), TimeRemainingColumn()
    with _bars(console, *left) as bars:
        task = bars.add_task(job, total=1.0)
        yield lambda share: bars.update(task, completed=share)


@contextmanager
def counting_bar(
    console: Console, job: str, *, transient: bool = True
) -> Iterator[Callable[[int, int], None]]:
    """Shows how many of a job's items are done, and how fast.

    Args:
        console: where; nothing is shown where it is no terminal.
        job: what it says.
        transient: the bar goes when the job is done.

    Yields:
        A function to be called with how many are done, and of how many. The
        bar is there from its first call on, and stays up to its last item.
    """
    bars = _bars(
        console,
        MofNCompleteColumn(),
        _Rate(),
        TimeElapsedColumn(),
        TimeRemainingColumn(elapsed_when_finished=True),
        transient=transient,
    )
    task = bars.add_task(job, total=None)

    def update(done: int, total: int) -> None:
        bars.start()
        bars.update(task, completed=done, total=total)
        if done == total:
            bars.stop()

    try:
        yield update
    finally:
        bars.stop()
