import ctypes.util
import shutil

import pytest

import xray_drake.resources
from tests.cli.running import answer
from xray_drake.cli.doctor import SYSTEM_LIBRARIES


def doctor() -> tuple[int, list[str]]:
    code, out, err = answer("doctor")
    assert err == ""
    return code, out.splitlines()


def line_about(lines: list[str], what: str) -> str:
    (line,) = [line for line in lines if line[6:].startswith(f"{what}:")]
    return line


def test_it_finds_a_machine_that_runs_these_tests_fit() -> None:
    code, lines = doctor()
    assert code == 0
    for what in (
        *("Python", "drake", "torch", "trimesh", "opencv-python-headless"),
        *("system libraries", "models", "rendering without a screen"),
        *("weights", "caches", "threads"),
    ):
        assert line_about(lines, what).startswith("ok ")
    assert not any("LACK" in line for line in lines)


@pytest.mark.parametrize("missing", [("EGL", "SM"), tuple(SYSTEM_LIBRARIES)])
def test_it_says_which_library_is_missing_and_what_mends_it(
    missing: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    find = ctypes.util.find_library
    monkeypatch.setattr(
        ctypes.util,
        "find_library",
        lambda name: None if name in missing else find(name),
    )
    monkeypatch.setattr("sys.platform", "linux")
    code, lines = doctor()
    assert code == 1
    index = lines.index(line_about(lines, "system libraries"))
    assert lines[index].startswith("LACK")
    # One command on one line, to be copied.
    cure = lines[index + 1]
    assert "apt-get install" in cure
    assert cure.endswith(" libgl1-mesa-dri")
    for name, package in SYSTEM_LIBRARIES.items():
        assert (package in cure.split()) == (name in missing)


def test_it_says_that_the_models_are_missing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def missing() -> None:
        raise FileNotFoundError("no models/package.xml")

    monkeypatch.setattr(xray_drake.resources, "models_dir", missing)
    code, lines = doctor()
    assert code == 1
    assert line_about(lines, "models").startswith("LACK")


def test_graphviz_is_only_a_wish(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    code, lines = doctor()
    assert code == 0
    line = line_about(lines, "graphviz")
    assert line.startswith("note")
    assert "graphviz" in lines[lines.index(line) + 1]
