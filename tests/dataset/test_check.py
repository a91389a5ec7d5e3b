import dataclasses
import os
import shutil
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.dataset.whole import flip_bit
from xray_drake.dataset import check
from xray_drake.dataset.check import CheckReport, check_dataset
from xray_drake.dataset.manifest import (
    ExpectedShard,
    Manifest,
    write_manifest,
)


def _lines(report: CheckReport) -> list[str]:
    return [str(defect) for defect in report.defects]


@pytest.mark.parametrize("deep", [True, False])
def test_a_sound_dataset(dataset: Any, deep: bool) -> None:
    seen: list[tuple[int, int]] = []
    report = check_dataset(
        dataset.folder, deep=deep, progress=lambda *told: seen.append(told)
    )
    assert _lines(report) == []
    assert report.sound
    assert report.num_found == 10
    assert seen == [(i, 6) for i in range(1, 7)]
    assert report.versions == {("0.1.0", "1.51.1"): 6}
    assert report.num_bytes == sum(
        p.stat().st_size for p in dataset.folder.glob("*.h5")
    )


def test_what_is_counted(own_dataset: Any) -> None:
    angle = np.radians(6)
    c, s = np.cos(angle), np.sin(angle)
    first, second = own_dataset.samples[:2]
    X_WT = np.array(first.X_WT)
    X_WT[:3, :3] = [[1, 0, 0], [0, -c, s], [0, -s, -c]]  # upside down, too
    tilted = dataclasses.replace(first, X_WT=X_WT)
    own_dataset.write_shard("train-00000.h5", [tilted, second])
    report = check_dataset(own_dataset.folder)
    assert report.sound
    statistics = report.to_dict()["statistics"]
    assert statistics == report.statistics()
    assert statistics["splits"] == {"test": 3, "train": 5, "validation": 2}
    assert statistics["targets"] == {"box_2to1": 6, "lid": 4}
    assert statistics["hidden"] == 0.2
    for name in ("fully", "partly", "more_than_90_percent"):
        assert statistics[f"{name}_visible"] == 0.4
    assert statistics["tilted_by_more_than_5_degrees"] == 0.1
    assert statistics["objects_mean"] == 2.0


def test_several_processes_find_the_same(own_dataset: Any) -> None:
    (own_dataset.folder / "train-00001.h5").unlink()
    alone = check_dataset(own_dataset.folder)
    together = check_dataset(own_dataset.folder, workers=2)
    assert together.to_dict() == alone.to_dict()
    assert not together.sound


check_shard = check._check_shard


def dying_check(
    folder: Path, manifest: Manifest, deep: bool, expected: ExpectedShard
) -> check._ShardResult:
    if expected.name == "train-00001.h5":
        os.kill(os.getpid(), signal.SIGSEGV)
    return check_shard(folder, manifest, deep, expected)


def test_a_shard_whose_check_crashes_is_a_defect(
    own_dataset: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(check, "_check_shard", dying_check)
    report = check_dataset(own_dataset.folder, workers=2)
    (line,) = _lines(report)
    assert line.startswith("train-00001.h5: its process was killed by SIGSEGV")


@pytest.mark.parametrize("deep", [True, False])
def test_files_that_are_not_as_they_should_be(
    own_dataset: Any, deep: bool
) -> None:
    folder = own_dataset.folder
    (folder / "train-00001.h5").unlink()
    flip_bit(folder / "train-00002.h5")
    shutil.copy(folder / "test-00000.h5", folder / "test-00007.h5")
    os.truncate(folder / "test-00001.h5", 3000)
    (folder / "validation-00000.h5").write_bytes(b"")
    (folder / "notes.txt").touch()
    report = check_dataset(folder, deep=deep)
    for line, begin in zip(
        _lines(report),
        [
            "test-00001.h5: damaged",
            "test-00007.h5: dataset.json knows no such shard",
            "train-00001.h5: missing",
            *(["train-00002.h5: damaged"] if deep else []),
            "validation-00000.h5: damaged",
        ],
        strict=True,
    ):
        assert line.startswith(begin)
    # Of what can be opened; a bit is found in looking at the images.
    assert report.num_found == 5


@pytest.mark.parametrize("deep", [True, False])
def test_a_sample_twice_is_found(own_dataset: Any, deep: bool) -> None:
    first, _, third, *_ = own_dataset.samples
    own_dataset.write_shard("train-00001.h5", [third, first])
    (line,) = _lines(check_dataset(own_dataset.folder, deep=deep))
    assert line == (
        f"train-00001.h5: sample 1 ({first.key}): also in train-00000.h5"
    )


@pytest.mark.parametrize("deep", [True, False])
def test_a_shard_of_another_place_is_found(
    own_dataset: Any, deep: bool
) -> None:
    samples = own_dataset.samples
    own_dataset.write_shard("train-00000.h5", samples[:1])
    own_dataset.write_shard("train-00001.h5", samples[2:4], split="test")
    own_dataset.write_shard("test-00001.h5", samples[-1:], dataset="other")
    own_dataset.write_shard("train-00002.h5", samples[4:5], index=1)
    assert _lines(check_dataset(own_dataset.folder, deep=deep)) == [
        "test-00001.h5: belongs to another dataset, 'other'",
        "train-00000.h5: has 1 samples instead of 2",
        "train-00001.h5: belongs to split 'test'",
        "train-00002.h5: is number 1 of its split, renamed",
    ]


def test_an_object_in_two_splits_is_found(own_dataset: Any) -> None:
    sample = dataclasses.replace(
        own_dataset.samples[-1], object_names=("train_a", "test_b")
    )
    own_dataset.write_shard("test-00001.h5", [sample])
    lines = _lines(check_dataset(own_dataset.folder))
    # Told once, where it is met second.
    assert len(lines) == 1
    assert "object 'train_a' is also in split 'train'" in lines[0]


def test_images_of_another_size_are_found(own_dataset: Any) -> None:
    manifest = dataclasses.replace(own_dataset.manifest, width=40, color=True)
    write_manifest(own_dataset.folder, manifest)
    lines = _lines(check_dataset(own_dataset.folder))
    assert len(lines) == 3 * 6  # they belong to another dataset, too
    assert "train-00000.h5: has images of (24, 32), not (24, 40)" in lines
    assert "train-00000.h5: lacks colour images" in lines


def test_a_sample_that_cannot_be_is_found(own_dataset: Any) -> None:
    first, second = own_dataset.samples[:2]
    bad = dataclasses.replace(
        second, occupancy=np.zeros(second.shape), target_name="flute"
    )
    own_dataset.write_shard("train-00000.h5", [first, bad])
    lines = _lines(check_dataset(own_dataset.folder))
    begin = f"train-00000.h5: sample 1 ({bad.key}): "
    assert f"{begin}occupancy has the maximum 0, not 1" in lines
    assert f"{begin}dataset.json knows no target 'flute'" in lines
    assert all(line.startswith(begin) for line in lines)
