"""How a command tells what went wrong: one line and an exit status."""

from collections.abc import Iterator
from contextlib import contextmanager

import typer

from xray_drake.cli.exits import BAD_INPUT, FAILED, INTERRUPTED


def complain(message: str, code: int = BAD_INPUT) -> typer.Exit:
    """Prints one line to standard error and returns the exit to raise."""
    typer.echo(f"xray-drake: {' '.join(message.split())}", err=True)
    return typer.Exit(code)


@contextmanager
def errors_as_lines() -> Iterator[None]:
    """Turns the errors of a job into one line and an exit status.

    Raises:
        typer.Exit: 2 for bad input, 1 for a file that cannot be written or a
            failed simulation, 130 for Ctrl-C.
    """
    try:
        yield
    except ValueError as error:
        raise complain(str(error)) from error
    except (OSError, RuntimeError) as error:
        if isinstance(error, typer.Exit):
            raise
        raise complain(str(error), FAILED) from error
    except KeyboardInterrupt:
        raise complain("interrupted", INTERRUPTED) from None
