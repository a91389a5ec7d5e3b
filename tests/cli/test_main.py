import os
import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest
import typer
from pydrake.multibody.plant import MultibodyPlant
from typer.testing import CliRunner

from tests.cli.running import output
from xray_drake import __version__
from xray_drake.choices import BOX_TARGETS, TALL_TARGETS, TARGET_NAMES
from xray_drake.cli.main import app, errors_as_lines
from xray_drake.policy.registry import POLICIES
from xray_drake.processes import Lost
from xray_drake.scene.heap import HeapError
from xray_drake.station.scenario import ScenarioError


def test_version() -> None:
    assert output("--version") == f"xray-drake {__version__}\n"


def test_help_names_every_command() -> None:
    told = output("--help")
    for command in (
        *("search", "benchmark", "doctor"),
        *("generate", "dataset", "inspect", "objects", "study"),
    ):
        assert command in told


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
        (ScenarioError("of two\n  lines"), 2),
        (FileNotFoundError(2, "none", "of two\n  lines"), 1),
        (HeapError("of two\n  lines"), 1),
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


@pytest.mark.parametrize(
    ("bug", "line"),
    [
        (lambda: None + 1, "TypeError: "),
        (lambda: np.zeros(3) + np.zeros(4), "ValueError: operands"),
        (lambda: MultibodyPlant(time_step=0.0).GetBodyByName(""), "RuntimeE"),
        (lambda: MultibodyPlant(time_step=-1.0), "SystemExit: Failure at"),
    ],
)
def test_a_bug_is_not_hidden(
    bug: Callable[[], object], line: str, capsys: pytest.CaptureFixture
) -> None:
    """NumPy's and Drake's errors keep their kind and traceback."""
    with pytest.raises(typer.Exit) as exit_info, errors_as_lines():
        bug()
    assert exit_info.value.exit_code == 1
    *traceback, last = capsys.readouterr().err.splitlines()
    assert last.startswith(f"xray-drake: {line}")
    assert any("test_main.py" in each for each in traceback)


def test_the_traceback_of_a_bug_in_a_process_is_shown(
    capsys: pytest.CaptureFixture,
) -> None:
    with pytest.raises(typer.Exit), errors_as_lines():
        raise Lost(1, "failed", "KeyError: 1", "traceback").error("heap 1")
    *traceback, last = capsys.readouterr().err.splitlines()
    assert traceback == ["traceback"]
    assert last.endswith("KeyError: 1")


@pytest.mark.parametrize(
    ("command", "encoding"),
    [
        (["search", "--help"], "ascii"),
        (["generate", "--help"], "latin-1"),
        (["objects", "list", "--family", "can"], "ascii"),
    ],
)
def test_the_output_may_have_any_encoding(
    command: list[str], encoding: str
) -> None:
    made = subprocess.run(
        [sys.executable, "-m", "xray_drake.cli.main", *command],
        env={**os.environ, "PYTHONIOENCODING": encoding},
        capture_output=True,
    )
    assert made.returncode == 0, made.stderr
    text = made.stdout.decode(encoding)
    assert "?" not in text
    assert "..." in text or "…" in text or " x " in text
