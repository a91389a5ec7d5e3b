import subprocess
import sys

import pytest
import typer
from typer.testing import CliRunner

from xray_drake import __version__
from xray_drake.choices import BOX_TARGETS, TALL_TARGETS, TARGET_NAMES
from xray_drake.cli.main import app, errors_as_lines
from xray_drake.policy.policies import POLICIES


def test_version() -> None:
    result = CliRunner().invoke(app, ["--version"])
    assert result.exit_code == 0
    assert result.stdout == f"xray-drake {__version__}\n"


def test_help_names_every_command() -> None:
    result = CliRunner().invoke(app, ["--help"])
    assert result.exit_code == 0
    for command in (
        *("search", "benchmark", "doctor"),
        *("generate", "dataset", "inspect", "objects"),
    ):
        assert command in result.stdout


def help_of(command: str) -> str:
    result = CliRunner().invoke(
        app, [command, "--help"], env={"COLUMNS": "1000"}
    )
    assert result.exit_code == 0
    return result.stdout


def line_of(option: str, text: str) -> str:
    (line,) = [line for line in text.splitlines() if f" {option} " in line]
    return line


@pytest.mark.parametrize(
    ("command", "option"), [("search", "--policy"), ("benchmark", "--policies")]
)
def test_help_names_every_policy(command: str, option: str) -> None:
    line = line_of(option, help_of(command))
    for name in POLICIES:
        assert name in line


@pytest.mark.parametrize(
    ("command", "more"),
    [("search", TALL_TARGETS), ("benchmark", TALL_TARGETS), ("generate", ())],
)
def test_help_names_every_target(command: str, more: tuple[str, ...]) -> None:
    line = line_of("--target", help_of(command))
    assert f"{BOX_TARGETS[0]} … {BOX_TARGETS[-1]}" in line
    for name in {*TARGET_NAMES, *more} - {*BOX_TARGETS}:
        assert name in line
    for name in {*TALL_TARGETS} - {*more}:
        assert name not in line


@pytest.mark.parametrize("arguments", ["'--version'", "'search', '--help'"])
def test_asking_for_help_does_not_wait_for_drake(arguments: str) -> None:
    script = (
        "import sys\n"
        "from xray_drake.cli.main import app\n"
        f"app([{arguments}], standalone_mode=False)\n"
        "assert 'pydrake' not in sys.modules\n"
        "assert 'torch' not in sys.modules\n"
    )
    subprocess.run(
        [sys.executable, "-c", script], check=True, stdout=subprocess.DEVNULL
    )


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (ValueError("of two\n  lines"), 2),
        (FileNotFoundError(2, "none", "of two\n  lines"), 1),
        (RuntimeError("of two\n  lines"), 1),
    ],
)
def test_an_error_is_one_line_and_a_status(
    error: Exception, code: int, capsys: pytest.CaptureFixture
) -> None:
    with pytest.raises(typer.Exit) as exit_info, errors_as_lines():
        raise error
    assert exit_info.value.exit_code == code
    out, err = capsys.readouterr()
    assert out == ""
    (line,) = err.splitlines()
    assert line.startswith("xray-drake: ")
    assert "of two" in line
    assert "lines" in line


def test_ctrl_c_has_the_status_that_shells_give_it(
    capsys: pytest.CaptureFixture,
) -> None:
    with pytest.raises(typer.Exit) as exit_info, errors_as_lines():
        raise KeyboardInterrupt
    assert exit_info.value.exit_code == 130
    assert capsys.readouterr().err == "xray-drake: interrupted\n"


def test_an_exit_is_not_an_error(capsys: pytest.CaptureFixture) -> None:
    with pytest.raises(typer.Exit) as exit_info, errors_as_lines():
        raise typer.Exit(5)
    assert exit_info.value.exit_code == 5
    assert capsys.readouterr().err == ""


def test_a_bug_is_not_hidden() -> None:
    with pytest.raises(TypeError), errors_as_lines():
        raise TypeError("a bug")
