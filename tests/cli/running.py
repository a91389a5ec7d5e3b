"""Runs the command line within the test's process."""

import shlex

from typer.testing import CliRunner

from xray_drake.cli.main import app


def answer(*words: object) -> tuple[int, str, str]:
    """Returns exit status, standard output and standard error.

    Text is split into words as a shell does it, anything else is one word. A
    bug of the program is raised, as it would be shown.
    """
    line: list[str] = []
    for word in words:
        line += shlex.split(word) if isinstance(word, str) else [str(word)]
    # No line of the help is broken.
    result = CliRunner().invoke(app, line, env={"COLUMNS": "1000"})
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout, result.stderr


def output(*words: object) -> str:
    """Returns the standard output of what succeeds without a complaint."""
    code, out, err = answer(*words)
    assert (code, err) == (0, ""), err
    return out


def complaint(*words: object, code: int = 2) -> str:
    """Returns the one line that something bad is answered with."""
    got, _, err = answer(*words)
    assert got == code, err
    (line,) = err.splitlines()
    assert line.startswith("xray-drake: ")
    return line
