import os
import subprocess
import sys
from collections.abc import Callable, Iterable

import numpy as np
import pytest
import typer
from pydrake.multibody.plant import MultibodyPlant

from tests.cli.running import output
from xray_drake import __version__
from xray_drake.choices import BOX_TARGETS, TALL_TARGETS, TARGET_NAMES
from xray_drake.cli.main import errors_as_lines
from xray_drake.policy.registry import POLICIES
from xray_drake.processes import Lost
from xray_drake.scene.heap import HeapError
from xray_drake.station.scenario import ScenarioError

FIRST, *_, LAST = BOX_TARGETS
TARGETS = (f"{FIRST} … {LAST}", *sorted({*TARGET_NAMES} - {*BOX_TARGETS}))
"""As the help names them."""


def test_version() -> None:
    assert output("--version") == f"xray-drake {__version__}\n"


def test_help_names_every_command() -> None:
    told = output("--help")
    for command in (
        *("search", "benchmark", "doctor"),
        *("generate", "dataset", "inspect", "objects", "study"),
    ):
        assert command in told


@pytest.mark.parametrize(
    ("command", "option", "named", "others"),
    [
        ("search", "--policy", POLICIES, ()),
        ("benchmark", "--policies", POLICIES, ()),
        ("search", "--target", TARGETS + TALL_TARGETS, ()),
        ("benchmark", "--target", TARGETS + TALL_TARGETS, ()),
        ("generate", "--target", TARGETS, TALL_TARGETS),
    ],
)
def test_help_names_every_choice(
    command: str, option: str, named: Iterable[str], others: Iterable[str]
) -> None:
    told = output(command, "--help").splitlines()
    (line,) = [line for line in told if f" {option} " in line]
    assert all(name in line for name in named)
    assert not any(name in line for name in others)


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
    ("error", "code", "lines"),
    [
        (ScenarioError("two\n  lines"), 2, ["xray-drake: two lines"]),
        (
            FileNotFoundError(2, "none", "a\nb"),
            1,
            [r"xray-drake: [Errno 2] none: 'a\nb'"],
        ),
        (HeapError("two\n  lines"), 1, ["xray-drake: two lines"]),
        (KeyboardInterrupt(), 130, ["xray-drake: interrupted"]),
        (typer.Exit(5), 5, []),
        (
            Lost(1, "failed", "KeyError: 1", "traceback").error("heap 1"),
            1,
            ["traceback", "xray-drake: heap 1: KeyError: 1"],
        ),
    ],
)
def test_an_error_is_one_line_and_a_status(
    error: BaseException,
    code: int,
    lines: list[str],
    capsys: pytest.CaptureFixture,
) -> None:
    """That of a bug in another process stands below its traceback."""
    with pytest.raises(typer.Exit) as exit_info, errors_as_lines():
        raise error
    assert exit_info.value.exit_code == code
    out, err = capsys.readouterr()
    assert (out, err.splitlines()) == ("", lines)


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


@pytest.mark.parametrize(
    ("command", "encoding"),
    [
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
