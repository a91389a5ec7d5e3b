import logging
import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from xray_drake import kernels
from xray_drake.caches import VARIABLE, cache_folder
from xray_drake.kernels import kernel


@pytest.fixture(autouse=True)
def no_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither a home nor a folder for caches; the environment is restored."""

    def home() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", home)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    for name in (VARIABLE, kernels.VARIABLE, "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, "")
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")


@pytest.fixture
def kernels_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """There is a folder for compiled kernels."""
    monkeypatch.setenv(kernels.VARIABLE, str(tmp_path))
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))


def test_a_folder_that_exists_or_can_be_made_is_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "new"))
    assert cache_folder() == tmp_path / "new" / "xray_drake"
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    assert cache_folder() == tmp_path
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("lack", ["home", "folder"])
def test_without_a_place_for_a_cache_there_is_one_while_the_program_runs(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    lack: str,
) -> None:
    if lack == "folder":
        (tmp_path / "file").touch()
        monkeypatch.setenv(VARIABLE, str(tmp_path / "file" / "cache"))
    folder = cache_folder()
    assert folder.parent == tmp_path
    # Other processes find it, and it is said once.
    assert os.environ[VARIABLE] == str(folder)
    assert cache_folder() == folder
    (record,) = caplog.records
    assert record.levelno == logging.WARNING
    assert VARIABLE in record.getMessage()


def test_the_temporary_folder_goes_with_the_program(tmp_path: Path) -> None:
    script = "from xray_drake.caches import cache_folder; print(cache_folder())"
    made = subprocess.run(
        [sys.executable, "-c", script],
        env={
            **os.environ,
            VARIABLE: "/dev/null/cache",
            "TMPDIR": str(tmp_path),
        },
        capture_output=True,
        text=True,
        check=True,
    )
    assert Path(made.stdout.strip()).parent == tmp_path
    assert not list(tmp_path.iterdir())


def add(a: int, b: int) -> int:
    return a + b


def test_without_a_writable_package_kernels_are_compiled(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Numba can write neither beside a file nor into a user's cache."""
    for name in ("InTreeCacheLocator", "UserWideCacheLocator"):
        found = getattr(numba.core.caching, f"_{name}", None) or getattr(
            numba.core.caching, name
        )
        monkeypatch.setattr(found, "from_function", lambda *_: None)
    with pytest.raises(RuntimeError, match="cannot cache"):
        numba.njit(cache=True)(add)
    assert kernel(add)(1, 2) == 3
    assert kernel(add)(3, 2) == 5
    (record,) = caplog.records
    assert kernels.VARIABLE in record.getMessage()
    (folder,) = tmp_path.iterdir()
    assert list(folder.rglob("*.nbc"))  # kept for other processes


@pytest.mark.usefixtures("kernels_at")
@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
@pytest.mark.parametrize("content", [b"", b"not a pickle"])
def test_a_damaged_cache_of_kernels_is_made_anew(
    tmp_path: Path, suffix: str, content: bytes
) -> None:
    assert kernel(add)(1, 2) == 3
    (path,) = tmp_path.rglob(f"*{suffix}")
    whole = path.stat().st_size
    path.write_bytes(content)
    assert kernel(add)(1, 2) == 3
    assert path.stat().st_size == whole


@pytest.mark.usefixtures("kernels_at")
def test_a_full_disk_costs_only_the_cache(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(
        numba.core.caching.IndexDataCacheFile, "_save_data", full
    )
    assert kernel(add)(1, 2) == 3
