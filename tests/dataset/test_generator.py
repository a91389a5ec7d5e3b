from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.dataset.whole import read_shard
from xray_drake.dataset import generator
from xray_drake.dataset.check import check_dataset
from xray_drake.dataset.generator import (
    SampleMaker,
    heap_seed,
    make_shard,
    plan_dataset,
    split_of_imported,
)
from xray_drake.dataset.manifest import Manifest, write_manifest
from xray_drake.dataset.sample import problems
from xray_drake.scene.heap import Heap
from xray_drake.scene.library import make_object, object_names, split_of
from xray_drake.splits import SPLITS
from xray_drake.station.scenario import Scenario, load_scenario


def small_scenario() -> Scenario:
    scenario = load_scenario("paper")
    scenario.scene.random_number.mean = 0.0
    scenario.scene.num_objects = 3
    return scenario


def plan(**changes: object) -> Manifest:
    options = {"splits": {"train": 4}, "views_per_heap": 2, "shard_size": 4}
    return plan_dataset(small_scenario(), **{**options, **changes})


@pytest.fixture(scope="module")
def samples() -> list:
    manifest = plan(snapshots=2, targets=("lid", "flute"), color=True)
    maker = SampleMaker(manifest, "train")
    return maker.make(0) + maker.make(1)


def test_a_dataset_holds_absolute_paths(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    scenario = small_scenario()
    scenario.scene.meshes = ["in"]
    manifest = plan_dataset(scenario, splits={"train": 4})
    assert manifest.meshes == (f"{tmp_path}/in",)
    assert f"{tmp_path}/in" in manifest.scenario


def test_each_state_is_seen_from_each_view(samples: list) -> None:
    keys = [(s.target_name, s.num_dropped, s.view) for s in samples]
    assert keys == [
        (target, dropped, view)
        for target in ("lid", "flute")
        for dropped in (2, 3)
        for view in (0, 1)
    ]
    assert len({s.key for s in samples}) == 8
    assert len({s.heap_seed for s in samples}) == 2
    # Cameras are drawn anew for each view, which states share.
    assert len({s.X_WC.tobytes() for s in samples}) == 4


def test_samples_are_sound_and_of_training_objects(samples: list) -> None:
    for sample in samples:
        assert problems(sample) == []
        assert sample.color.shape == (384, 512, 3)
        assert len(sample.object_names) <= sample.num_dropped
        assert {split_of(n) for n in sample.object_names} == {"train"}
        assert 0.7 <= np.linalg.norm(sample.X_WC[:3, 3]) <= 0.9
        assert 535 <= sample.intrinsics[0, 0] <= 560


def test_a_heap_gives_the_same_samples_wherever_it_is_made() -> None:
    """Exact labels of it are other ones, and hold the true place, too."""
    alone = SampleMaker(plan(), "train").make(1)
    maker = SampleMaker(plan(), "train")
    maker.make(0)
    exact = SampleMaker(plan(label="exact"), "train").make(1)
    for one, other, third in zip(alone, maker.make(1), exact, strict=True):
        assert one.key == other.key == third.key
        for name in ("depth", "occupancy", "instances", "X_WT", "X_WC"):
            np.testing.assert_array_equal(
                getattr(one, name), getattr(other, name)
            )
        assert problems(third) == []
        assert (third.occupancy != one.occupancy).any()


def test_a_shard_ends_where_it_should_and_reports(tmp_path) -> None:
    manifest = plan(splits={"validation": 3})
    write_manifest(tmp_path, manifest)
    (shard,) = manifest.expected_shards()
    *seen, report = make_shard(tmp_path, manifest, shard)
    assert (report.samples, report.heaps) == (3, 2)
    assert seen == [2, 3]
    assert set(report.seconds) == {"heap", "pictures", "label", "disk"}
    assert report.cpu == pytest.approx(sum(report.seconds.values()))
    samples = read_shard(tmp_path / shard.name)
    assert len({s.key for s in samples}) == 3
    for sample in samples:
        assert {split_of(n) for n in sample.object_names} == {"validation"}
    assert check_dataset(tmp_path).sound


def test_an_unsound_sample_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(generator, "problems", lambda sample: ["a", "b"])
    with pytest.raises(RuntimeError, match=r"is not sound: a; b"):
        SampleMaker(plan(), "train").make(0)


def test_failures_are_counted(
    monkeypatch: pytest.MonkeyPatch, tiny_heap: Heap
) -> None:
    failures = ("heap of seed 7, draw 1 failed: why",)
    heap = replace(tiny_heap, failures=failures)
    monkeypatch.setattr(generator, "make_heap", lambda *a, **k: heap)
    maker = SampleMaker(plan(), "train")
    maker.make(0)
    assert maker.failures == [*failures]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"label": "none"}, "no label is called"),
        ({"targets": ("cat",)}, "no target is called"),
        ({"views_per_heap": 0}, "views_per_heap"),
        ({"snapshots": 3}, "3 objects has no 3 different"),
    ],
)
def test_plans_that_cannot_be(changes: dict[str, Any], words: str) -> None:
    # A shard holds whole heaps.
    assert plan(shard_size=5, snapshots=2).shard_size == 8
    with pytest.raises(ValueError, match=words):
        plan(**changes)


def test_seeds_of_heaps_are_distinct_and_far_from_those_of_benchmarks() -> None:
    seeds = {
        heap_seed(seed, split, index)
        for seed in range(3)
        for split in SPLITS
        for index in (0, 1, 9_999_999)
    }
    assert len(seeds) == 27
    assert min(seeds) > 10_000_000
    with pytest.raises(ValueError, match="at most"):
        heap_seed(0, "train", 10**7)


def test_imported_objects_are_split_by_name() -> None:
    library = {n: make_object(n) for n in object_names("brick", "disc", "ring")}
    parts = [split_of_imported(library, split) for split in SPLITS]
    assert sum(map(len, parts)) == len(library)
    assert len(parts[0]) > 0.6 * len(library)
    names = [n for part in parts for n in part]
    assert len(set(names)) == len(names)
    with pytest.raises(ValueError, match="none of the 1 imported"):
        name = next(iter(parts[0]))
        split_of_imported({name: library[name]}, "test")
    assert split_of_imported({}, "test") == {}
