"""Runs the command line within the test's process."""

from typer.testing import CliRunner

from xray_drake.cli.main import app


def answer(*arguments: object) -> tuple[int, str, str]:
    """Returns exit status, standard output and standard error.

    A bug of the program is raised, as it would be shown.
    """
    result = CliRunner().invoke(app, list(map(str, arguments)))
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout, result.stderr


def output(*arguments: object) -> str:
    """Returns the standard output of what succeeds without a complaint."""
    code, out, err = answer(*arguments)
    assert (code, err) == (0, ""), err
    return out


def complaint(*arguments: object, code: int = 2) -> str:
    """Returns the one line that something bad is answered with."""
    got, _, err = answer(*arguments)
    assert got == code, err
    (line,) = err.splitlines()
    assert line.startswith("xray-drake: ")
    return line
