"""How a command tells what went wrong: one line and an exit status."""

import codecs
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from unicodedata import normalize

import typer

from xray_drake.cli.exits import BAD_INPUT, FAILED, INTERRUPTED
from xray_drake.faults import is_fault, one_line


def complain(message: str, code: int = BAD_INPUT) -> typer.Exit:
    """Prints one line to standard error and returns the exit to raise."""
    typer.echo(f"xray-drake: {' '.join(message.split())}", err=True)
    return typer.Exit(code)


@contextmanager
def errors_as_lines() -> Iterator[None]:
    """Turns the errors of a job into one line and an exit status.

    The line of a fault of the program comes after its traceback.

    Raises:
        typer.Exit: 2 for bad input, 1 for a file that cannot be written, a
            failed simulation or a fault, 130 for Ctrl-C.
        BrokenPipeError: whom the output is for has heard enough.
    """
    try:
        yield
    except (typer.Exit, BrokenPipeError):
        raise
    except KeyboardInterrupt:
        raise complain("interrupted", INTERRUPTED) from None
    except (Exception, SystemExit) as error:
        if isinstance(error, SystemExit) and not isinstance(error.code, str):
            raise
        if is_fault(error):
            traceback.print_exception(error)
            raise complain(one_line(error), FAILED) from error
        # Those of the fault of a process, see ``processes.Lost``.
        for note in getattr(error, "__notes__", ()):
            typer.echo(note, err=True)
        bad = isinstance(error, ValueError)
        code = BAD_INPUT if bad else FAILED
        raise complain(one_line(error), code) from error


_PLAIN = {"×": "x", "→": "->", "–": "-", "−": "-", "°": " deg"}


def accept_any_output() -> None:
    """Prints what the output's encoding lacks in plainer characters.

    A terminal, a pipe or the log of a test machine may be ASCII or Latin-1.
    """
    codecs.register_error("plain", _plain)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="plain")


def _plain(error: UnicodeError) -> tuple[str, int]:
    assert isinstance(error, UnicodeEncodeError)
    text = ""
    for character in error.object[error.start : error.end]:
        plain = _PLAIN.get(character) or normalize("NFKD", character)
        text += plain if plain.isascii() else "?"
    return text, error.end
