import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pytest import MonkeyPatch

from tests.dataset.test_generator import plan
from tests.dataset.whole import flip_bit
from tests.test_files import dead_pid
from xray_drake.dataset import engine
from xray_drake.dataset.check import check_dataset
from xray_drake.dataset.engine import open_dataset, run_processes, run_ray
from xray_drake.dataset.manifest import ExpectedShard, Manifest
from xray_drake.provenance import current


def small(images: int = 3) -> Manifest:
    return plan(splits={"train": images}, views_per_heap=1, shard_size=1)


def make(folder: Path, shards: Sequence[ExpectedShard], **how: Any) -> None:
    """Makes shards of the small dataset in processes."""
    made = list(run_processes(folder, small(), shards, **how))
    assert {report.name for report in made} == {s.name for s in shards}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dataset")
    missing = open_dataset(folder, small(), resume=False)
    progress: list[tuple[str, int]] = []
    make(folder, missing, workers=2, progress=lambda *p: progress.append(p))
    assert sorted(progress) == [(shard.name, 1) for shard in missing]
    return folder


def test_the_number_of_workers_changes_nothing(
    made: Path, tmp_path: Path
) -> None:
    missing = open_dataset(tmp_path, small(), resume=False)
    make(tmp_path, missing[::-1], workers=1)
    for shard in missing:
        one, other = (folder / shard.name for folder in (made, tmp_path))
        assert one.read_bytes() == other.read_bytes()
    assert check_dataset(tmp_path).sound


def test_only_what_is_missing_or_damaged_is_made_again(
    made: Path, tmp_path: Path
) -> None:
    manifest, folder = small(), tmp_path / "own"
    shutil.copytree(made, folder)
    assert open_dataset(folder, manifest, resume=True) == ()
    shards = manifest.expected_shards()
    first, second = folder / shards[0].name, folder / shards[1].name
    flip_bit(first)
    second.unlink()
    (folder / f".train-00002.h5.{dead_pid()}.part").write_bytes(b"begun")
    told: list[tuple[Path, str]] = []
    missing = open_dataset(
        folder, manifest, resume=True, damaged=lambda *t: told.append(t)
    )
    assert missing == shards[:2]
    ((path, reason),) = told
    assert path == first
    assert first.name in reason
    assert not list(folder.glob(".*"))


def test_a_folder_that_is_something_else(made: Path, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    for folder, images, resume, words in (
        (made, 3, False, "give --resume"),
        (made, 4, True, "resume with the same arguments"),
        (tmp_path, 3, True, "holds other files"),
    ):
        with pytest.raises(ValueError, match=words):
            open_dataset(folder, small(images), resume=resume)


def test_a_killed_process_is_tried_again_then_named(
    tmp_path: Path, monkeypatch: MonkeyPatch
) -> None:
    """A shard whose process dies is made by another, once."""
    manifest = small(1)
    missing = open_dataset(tmp_path, manifest, resume=False)
    monkeypatch.setattr(engine, "make_shard", _die)
    with pytest.raises(
        RuntimeError,
        match=r"train-00000.h5: its process .* SIGKILL.* \(2 times",
    ):
        list(run_processes(tmp_path, manifest, missing, workers=1))


def _die(*args: object) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_nothing_is_lost_to_kill_9(tmp_path: Path) -> None:
    """The command itself, killed in the middle of its work."""
    command = [
        *(sys.executable, "-m", "xray_drake.cli.main", "generate"),
        *(str(tmp_path), "--images", "2", "--shard-size", "1"),
        *("--num-objects", "2", "--workers", "1"),
    ]
    process = subprocess.Popen(command, start_new_session=True)
    first = tmp_path / "train-00000.h5"
    deadline = time.monotonic() + 120
    while not first.is_file() and time.monotonic() < deadline:
        assert process.poll() is None
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    before = first.stat().st_mtime_ns
    again = subprocess.run(
        [*command, "--resume"], capture_output=True, text=True, check=True
    )
    assert "2 images in" in again.stdout
    assert first.stat().st_mtime_ns == before
    report = check_dataset(tmp_path)
    assert report.sound
    assert len(report.samples) == 2


def test_a_machine_of_other_code_makes_nothing() -> None:
    manifest = small(1)
    other = replace(current(), code="0123")
    with pytest.raises(RuntimeError, match="of the cluster differs: code 0123"):
        engine._make_remotely(manifest, manifest.expected_shards()[0], other)


def test_ray_is_an_extra(tmp_path: Path, monkeypatch: MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(RuntimeError, match=r"pip install 'xray-drake\[cluster"):
        list(run_ray(tmp_path, small(), (), address="auto"))
