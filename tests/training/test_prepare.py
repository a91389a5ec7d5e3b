import dataclasses
import os
import shutil
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.dataset.conftest import synthetic_sample
from tests.dataset.whole import (
    flip_bit,
    read_shard,
    tiny_dataset,
    write_dataset,
)
from xray_drake.dataset.augmentation import DepthNoise
from xray_drake.dataset.manifest import (
    DatasetError,
    read_manifest,
)
from xray_drake.dataset.reader import is_held_out
from xray_drake.dataset.sample import Sample
from xray_drake.dataset.shards import ShardError
from xray_drake.dataset.virtual import is_virtual
from xray_drake.files import InUseError, sole_writer
from xray_drake.occupancy.learned.inputs import (
    COARSE,
    FINE,
    geometry_input,
    size_features,
)
from xray_drake.training import prepare as module
from xray_drake.training.data import PreparedItems
from xray_drake.training.prepare import (
    PrepareConfig,
    open_prepared,
    plan,
    prepare,
    prepare_shard,
    sample_item,
)

SHAPE = (64, 96)
SHARE = 0.4
HEAPS, VIEWS = 6, 2

EXACT = PrepareConfig(noisy=0.0, miscalibrated=0.0, mask_errors=0.0)
"""No sensor, no errors."""


def _sample(index: int) -> Sample:
    """Views of a heap follow one another."""
    heap, view = divmod(index, VIEWS)
    return synthetic_sample(
        heap,
        view=view,
        cover=(0.0, 0.4, 1.0)[index % 3],
        shape=SHAPE,
        target_name=("box_2to1", "lid")[heap % 2],
    )


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny_dataset(
        tmp_path_factory.mktemp("dataset"),
        _sample,
        HEAPS * VIEWS,
        shard_size=4,
        targets=("box_2to1", "lid"),
        views=VIEWS,
    )


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What is prepared, in this process; names of shards."""
    names: list[str] = []

    def counted(shard: Path, *arguments: Any) -> None:
        names.append(shard.name)
        prepare_shard(shard, *arguments)

    monkeypatch.setattr(module, "prepare_shard", counted)
    return names


def _prepare(
    dataset: Path,
    folder: Path,
    config: PrepareConfig = EXACT,
    workers: int = 0,
) -> list[Path]:
    jobs = plan([dataset], folder, config, SHARE)
    told = list(prepare(jobs, config, SHARE, workers=workers))
    assert told[-1] == len(jobs)
    assert told == sorted(told)
    return [path for _, path in jobs]


def test_items_are_made_once(
    dataset: Path, tmp_path: Path, made: list[str]
) -> None:
    """What was begun is gone on with, by one writer."""
    jobs = plan([dataset], tmp_path, EXACT, SHARE)
    steps = prepare(jobs, EXACT, SHARE, workers=0)
    assert [next(steps), next(steps)] == [0, 1]
    steps.close()
    assert len(made) == 1
    with sole_writer(tmp_path), pytest.raises(InUseError):
        _prepare(dataset, tmp_path)
    files = _prepare(dataset, tmp_path)
    assert sorted(made) == [f"train-{i:05d}.h5" for i in range(3)]
    before = {path: path.read_bytes() for path in files}
    made.clear()
    with sole_writer(tmp_path):  # who finds all there writes nothing
        assert _prepare(dataset, tmp_path) == files
    assert made == []
    files[1].unlink()
    _prepare(dataset, tmp_path)
    assert made == ["train-00001.h5"]
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_the_bytes_of_items_do_not_depend_on_place_or_order(
    dataset: Path, tmp_path: Path
) -> None:
    """In processes, or in this one, from the last to the first."""
    config = PrepareConfig()
    files = _prepare(dataset, tmp_path, config, workers=1)
    for number in (1, 0):
        path = tmp_path / f"{number}.npz"
        shard = dataset / f"train-{number:05d}.h5"
        prepare_shard(shard, path, config, SHARE)
        assert path.read_bytes() == files[number].read_bytes()


def test_other_settings_are_other_files(dataset: Path, tmp_path: Path) -> None:
    """So is another dataset in the same place."""

    def files(config: PrepareConfig, share: float) -> set[Path]:
        jobs = plan([tmp_path], tmp_path, config, share, incomplete=True)
        return {path for _, path in jobs}

    manifest = read_manifest(dataset)
    write_dataset(tmp_path, manifest, _sample)
    base = files(EXACT, SHARE)
    assert files(PrepareConfig(**dataclasses.asdict(EXACT)), SHARE) == base
    for change in (
        {"seed": 1},
        {"virtual": 3},
        {"virtual_size": [0.03, 0.03, 0.005]},
        {"noise": DepthNoise(sigma=0.1)},
        {"labels": "expected"},
    ):
        assert not files(dataclasses.replace(EXACT, **change), SHARE) & base
    assert not files(EXACT, 0.3) & base
    write_dataset(tmp_path, dataclasses.replace(manifest, seed=1), _sample)
    assert not files(EXACT, SHARE) & base


@pytest.fixture(scope="module")
def prepared(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Items of the first shard, without errors; two virtual ones each."""
    path = tmp_path_factory.mktemp("items") / "items.npz"
    prepare_shard(dataset / "train-00000.h5", path, EXACT, SHARE)
    return path


def test_items_are_the_samples_and_virtual_ones(
    dataset: Path, prepared: Path
) -> None:
    items = open_prepared(prepared)
    samples = read_shard(dataset / "train-00000.h5")
    count = len(items.targets)
    assert len(samples) < count <= 3 * len(samples)
    assert items.shape == SHAPE
    assert len(items.ends) == len(items.held_out) == count
    assert items.sizes.shape == (count, 5)
    assert items.sizes.dtype == np.float32
    assert items.real.tolist() == [not is_virtual(n) for n in items.targets]
    rows = np.flatnonzero(items.real)
    for row, sample in zip(rows, samples, strict=True):
        assert items.targets[row] == sample.target_name
        item, size = items.item(row), sample.target_size
        inputs = geometry_input(
            sample.depth,
            sample.target_modal,
            sample.camera,
            float(size[2]),
            sample.floor,
        )
        assert inputs.fine[0].any()
        for found, expected, levels in (
            (item.fine[0], inputs.fine[0], 15),
            (item.fine[1], sample.target_modal, np.inf),
            (item.coarse, inputs.coarse, 255),
            (item.labels[0], sample.occupancy, 255),
            (item.labels[1], sample.target_amodal, np.inf),
        ):
            np.testing.assert_allclose(
                found / 255, expected, rtol=0, atol=0.5 / levels + 1e-6
            )
        features = size_features(size, sample.target_modal, sample.camera)
        np.testing.assert_array_equal(items.sizes[row], features)


def test_virtual_items_have_their_own_size_and_label(
    dataset: Path, prepared: Path, tmp_path: Path
) -> None:
    items = open_prepared(prepared)
    real, virtual = (
        [items.item(row).labels for row in np.flatnonzero(rows)]
        for rows in (items.real, ~items.real)
    )
    for labels in virtual:
        assert labels.any(axis=(1, 2)).all()
        assert not any(np.array_equal(labels[1], other[1]) for other in real)
    sizes = np.unique(items.sizes[~items.real][:, :3], axis=0)
    assert len(sizes) == len(virtual)
    # None are made if none are wanted.
    config = dataclasses.replace(EXACT, virtual=0)
    path = tmp_path / "items.npz"
    prepare_shard(dataset / "train-00000.h5", path, config, SHARE)
    assert open_prepared(path).real.tolist() == [True] * 4


def test_a_damaged_file_is_not_opened(prepared: Path, tmp_path: Path) -> None:
    data = prepared.read_bytes()
    path = tmp_path / "items.npz"
    with pytest.raises(OSError):
        open_prepared(path)
    changed = bytearray(data)
    changed[300] ^= 1  # in what is packed
    for damaged in (b"", b"rubbish", data[:1000], data[:-10], bytes(changed)):
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match="is damaged: remove") as error:
            open_prepared(path)
        assert str(error.value).startswith(str(path))
        assert "\n" not in str(error.value)


def test_no_heap_is_trained_on_and_held_out(
    dataset: Path, tmp_path: Path, made: list[str]
) -> None:
    shards = [open_prepared(path) for path in _prepare(dataset, tmp_path)]
    heaps = []
    for number, items in enumerate(shards):
        samples = read_shard(dataset / f"train-{number:05d}.h5")
        # A sample, then its virtual ones.
        own = [samples[i].heap_seed for i in np.cumsum(items.real) - 1]
        held_out = [is_held_out(heap, SHARE) for heap in own]
        assert items.held_out.tolist() == held_out
        heaps += own
    assert set(heaps) == set(range(HEAPS))
    out = sum(is_held_out(heap, SHARE) for heap in heaps)
    assert 0 < out < len(heaps)
    assert len(PreparedItems(shards, held_out=True)) == out
    assert len(PreparedItems(shards, held_out=False)) == len(heaps) - out


def test_what_is_learned_may_be_what_can_be_known(
    dataset: Path, tmp_path: Path, made: list[str]
) -> None:
    known = dataclasses.replace(EXACT, labels="expected")
    changed = 0
    for given, expected in zip(
        _prepare(dataset, tmp_path),
        _prepare(dataset, tmp_path, known),
        strict=True,
    ):
        ours, theirs = open_prepared(given), open_prepared(expected)
        assert ours.targets == theirs.targets
        for row, held_out in enumerate(theirs.held_out):
            one, other = ours.item(row), theirs.item(row)
            np.testing.assert_array_equal(one.fine, other.fine)
            np.testing.assert_array_equal(one.labels[1], other.labels[1])
            same = np.array_equal(one.labels[0], other.labels[0])
            # A hidden target's label stays, too.
            assert same or (not held_out and one.fine[1].any())
            changed += not same
    assert changed > 3


def _items(
    sample: Sample, **change: Any
) -> list[tuple[dict[str, np.ndarray], np.ndarray]]:
    """Eight draws of an item's images, by their names, and of its size."""
    config = dataclasses.replace(EXACT, **change)
    names = (*FINE, *COARSE, "occupancy", "amodal")
    made = []
    for seed in range(8):
        item, size = sample_item(sample, config, np.random.default_rng(seed))
        images = (*item.fine, *item.coarse, *item.labels)
        made.append((dict(zip(names, images, strict=True)), size))
    return made


@pytest.mark.parametrize(
    ("change", "surely", "perhaps"),
    [
        ({}, set(), set()),
        ({"noisy": 1.0}, {"reading", "cover"}, {"height"}),
        ({"mask_errors": 1.0}, {"modal"}, set()),
        (
            {"miscalibrated": 1.0, "height_error": 0.003},
            {"cover", "height"},
            {"floor"},
        ),
    ],
)
def test_each_error_changes_what_it_should_and_no_label(
    change: dict[str, float], surely: set[str], perhaps: set[str]
) -> None:
    sample = _sample(1)
    exact, size = _items(sample)[0]
    found, errors = set(), []
    for images, features in _items(sample, **change):
        errors.append(features - size)
        found |= {
            name
            for name, image in images.items()
            if not np.array_equal(image, exact[name])
        }
    assert surely <= found <= surely | perhaps
    if "mask_errors" in change:
        assert np.min(errors, axis=0)[4] < 0 < np.max(errors, axis=0)[4]
    elif "miscalibrated" in change:
        assert 1e-4 < np.abs(errors)[:, :2].max() < 0.05
    else:
        assert not np.any(errors)


@pytest.mark.parametrize("key", ["height_error", "tilt_error"])
def test_wrong_calibration_lifts_or_tilts_the_floor(key: str) -> None:
    sample = _sample(0)
    quiet = {"height_error": 0.0, "tilt_error": 0.0, "focal_error": 0.0}
    quiet[key] = 0.02
    ((exact, _), *_) = _items(sample)
    seen = exact["modal"].reshape(16, 4, 24, 4).any(axis=(1, 3))
    floor = ~seen & (exact["reading"] == 255) & (exact["height"] < 40)
    assert floor.mean() > 0.5
    for images, _ in _items(sample, miscalibrated=1.0, **quiet):
        change = images["height"].astype(int) - exact["height"]
        spread = np.ptp(change[floor])
        if key == "height_error":
            assert spread <= 2
        else:
            assert spread > 2


def test_a_small_mask_is_not_eroded_away() -> None:
    sample = _sample(1)
    modal = np.zeros(SHAPE, bool)
    modal[10:14, 10:20] = True  # 40 pixels
    small = dataclasses.replace(sample, target_modal=modal)
    for images, _ in _items(small, mask_errors=1.0):
        np.testing.assert_array_equal(images["modal"], 255 * modal)


def test_shards_that_are_still_to_come_are_left_out_if_told_so(
    dataset: Path, tmp_path: Path
) -> None:
    for name in ("dataset.json", "train-00001.h5"):
        with pytest.raises(
            DatasetError, match=r"is no data|no shard in .*: run"
        ):
            plan([tmp_path], tmp_path, EXACT, SHARE, incomplete=True)
        (tmp_path / name).write_bytes((dataset / name).read_bytes())
    with pytest.raises(DatasetError, match=r"00000\.h5 is missing: resume"):
        plan([tmp_path], tmp_path, EXACT, SHARE)
    ((shard, _),) = plan([tmp_path], tmp_path, EXACT, SHARE, incomplete=True)
    assert shard == tmp_path / "train-00001.h5"
    jobs = plan([tmp_path, dataset], tmp_path, EXACT, SHARE, incomplete=True)
    # A copy of a dataset has the same items.
    assert len(jobs) == 4
    assert len({path for _, path in jobs}) == 3


def test_a_damaged_shard_is_named_and_leaves_nothing(
    dataset: Path, tmp_path: Path
) -> None:
    """Cut short, before anything is made; changed within, when it is read."""
    folder, cache = tmp_path / "damaged", tmp_path / "cache"
    shutil.copytree(dataset, folder)
    bad = folder / "train-00001.h5"
    flip_bit(bad)
    jobs = plan([folder], cache, EXACT, SHARE)
    with pytest.raises(ShardError, match=r"train-00001\.h5 is damaged"):
        list(prepare(jobs, EXACT, SHARE, workers=0))
    assert not [path for path in cache.iterdir() if "00001" in path.name]
    bad.write_bytes(bad.read_bytes()[:-100])
    with pytest.raises(ShardError, match=r"train-00001\.h5 is damaged"):
        plan([folder], cache, EXACT, SHARE)


def die_in_native_code(*_: object) -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def test_a_process_that_dies_is_one_line_with_its_shard(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_prepare_job", die_in_native_code)
    with pytest.raises(
        RuntimeError, match=r"train-0000\d\.h5: its process .* SIGSEGV"
    ):
        _prepare(dataset, tmp_path, workers=1)
