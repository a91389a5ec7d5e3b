import dataclasses
import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.dataset.conftest import synthetic_sample
from tests.dataset.whole import flip_bit, tiny_dataset, write_dataset
from xray_drake.dataset.augmentation import DepthNoise
from xray_drake.dataset.manifest import (
    DatasetError,
    read_manifest,
)
from xray_drake.dataset.reader import is_held_out
from xray_drake.dataset.sample import Sample
from xray_drake.dataset.shards import (
    ShardError,
    read_shard,
)
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
from xray_drake.training.items import Item
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


def _named(item: Item) -> dict[str, np.ndarray]:
    """An item's images by their names."""
    names = (*FINE, *COARSE, "occupancy", "amodal")
    images = (*item.fine, *item.coarse, *item.labels)
    return dict(zip(names, images, strict=True))


def test_items_are_made_once(
    dataset: Path, tmp_path: Path, made: list[str]
) -> None:
    files = _prepare(dataset, tmp_path)
    names = [f"train-{i:05d}.h5" for i in range(3)]
    assert sorted(made) == names
    assert len(set(files)) == 3
    before = [path.read_bytes() for path in files]
    made.clear()
    assert _prepare(dataset, tmp_path) == files
    assert made == []
    files[1].unlink()
    assert _prepare(dataset, tmp_path) == files
    assert made == names[1:2]
    assert [path.read_bytes() for path in files] == before
    assert sorted(tmp_path.iterdir()) == sorted(files)


def test_what_was_begun_is_gone_on_with(
    dataset: Path, tmp_path: Path, made: list[str]
) -> None:
    jobs = plan([dataset], tmp_path, EXACT, SHARE)
    steps = prepare(jobs, EXACT, SHARE, workers=0)
    assert [next(steps), next(steps)] == [0, 1]
    steps.close()
    done = sum(path.is_file() for _, path in jobs)
    made.clear()
    assert next(prepare(jobs, EXACT, SHARE, workers=0)) == done >= 1
    _prepare(dataset, tmp_path)
    assert len(made) == 3 - done


@pytest.mark.parametrize("config", [EXACT, PrepareConfig()])
def test_the_bytes_of_items_do_not_depend_on_place_or_order(
    dataset: Path, tmp_path: Path, config: PrepareConfig
) -> None:
    shards = sorted(dataset.glob("*.h5"))[:2]
    for name, order in (("a", shards), ("b", shards[::-1])):
        (tmp_path / name).mkdir()
        for shard in order:
            path = tmp_path / name / f"{shard.stem}.npz"
            prepare_shard(shard, path, config, SHARE)
    for shard in shards:
        one, other = (
            (tmp_path / name / f"{shard.stem}.npz").read_bytes()
            for name in "ab"
        )
        assert one == other


def test_other_settings_are_other_files(dataset: Path, tmp_path: Path) -> None:
    def files(config: PrepareConfig, share: float) -> set[Path]:
        return {path for _, path in plan([dataset], tmp_path, config, share)}

    base = files(EXACT, SHARE)
    assert files(PrepareConfig(**dataclasses.asdict(EXACT)), SHARE) == base
    for config, share in (
        (dataclasses.replace(EXACT, seed=1), SHARE),
        (dataclasses.replace(EXACT, virtual=3), SHARE),
        (dataclasses.replace(EXACT, noise=DepthNoise(sigma=0.1)), SHARE),
        (EXACT, 0.3),
    ):
        assert not files(config, share) & base


def test_another_dataset_in_the_same_place_is_prepared_anew(
    dataset: Path, tmp_path: Path
) -> None:
    files = []
    manifest = read_manifest(dataset)
    for seed in (1, 2):
        other = dataclasses.replace(manifest, seed=seed)
        write_dataset(tmp_path, other, _sample)
        jobs = plan([tmp_path], tmp_path, EXACT, SHARE, incomplete=True)
        files.append(jobs[0][1])
    assert files[0] != files[1]


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
    assert items.packed.dtype == np.uint8
    assert items.packed.ndim == 1
    assert len(items.ends) == len(items.held_out) == count
    assert items.sizes.shape == (count, 5)
    assert items.sizes.dtype == np.float32
    assert items.real.tolist() == [not is_virtual(n) for n in items.targets]
    rows = np.flatnonzero(items.real)
    assert len(rows) == len(samples)
    for row, sample in zip(rows, samples, strict=True):
        assert items.targets[row] == sample.target_name
        item = items.item(row)
        inputs = geometry_input(
            sample.depth,
            sample.target_modal,
            sample.camera,
            float(sample.target_size[2]),
        )
        assert inputs.fine.any(axis=(1, 2)).tolist() == [
            True,
            sample.target_modal.any(),
        ]
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
        np.testing.assert_array_equal(
            items.sizes[row],
            size_features(
                sample.target_size, sample.target_modal, sample.camera
            ),
        )


def test_virtual_items_have_their_own_size_and_label(prepared: Path) -> None:
    items = open_prepared(prepared)
    real, virtual = (
        [items.item(row).labels for row in np.flatnonzero(rows)]
        for rows in (items.real, ~items.real)
    )
    for labels in virtual:
        assert labels.any(axis=(1, 2)).all()
        assert not any(np.array_equal(labels[1], other[1]) for other in real)
    assert len(np.unique(items.sizes[~items.real][:, :3], axis=0)) == len(
        virtual
    )


def test_no_virtual_items_are_made_if_none_are_wanted(
    dataset: Path, tmp_path: Path
) -> None:
    config = dataclasses.replace(EXACT, virtual=0)
    path = tmp_path / "items.npz"
    prepare_shard(dataset / "train-00000.h5", path, config, SHARE)
    assert open_prepared(path).real.tolist() == [True] * 4


def test_a_damaged_file_is_not_opened(prepared: Path, tmp_path: Path) -> None:
    data = prepared.read_bytes()
    path = tmp_path / "items.npz"
    path.write_bytes(data)
    assert len(open_prepared(path).ends) > 0
    changed = bytearray(data)
    changed[300] ^= 1  # in what is packed
    for damaged in (b"", b"rubbish", data[:1000], data[:-10], bytes(changed)):
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match="is damaged: remove") as error:
            open_prepared(path)
        assert str(error.value).startswith(str(path))
        assert "\n" not in str(error.value)
    path.unlink()
    with pytest.raises(OSError):
        open_prepared(path)


def test_no_heap_is_trained_on_and_held_out(
    dataset: Path, tmp_path: Path, made: list[str]
) -> None:
    files = _prepare(dataset, tmp_path)
    shards = [open_prepared(path) for path in files]
    seeds = [
        sample.heap_seed
        for shard in sorted(dataset.glob("*.h5"))
        for sample in read_shard(shard)
    ]
    heaps: list[int] = []
    before = 0
    for items in shards:
        # A sample, then its virtual ones.
        own = [seeds[i] for i in before + np.cumsum(items.real) - 1]
        before += np.count_nonzero(items.real)
        assert items.held_out.tolist() == [
            is_held_out(heap, SHARE) for heap in own
        ]
        heaps += own
    assert set(heaps) == set(range(HEAPS))
    out = {heap for heap in heaps if is_held_out(heap, SHARE)}
    assert 0 < len(out) < HEAPS
    count = {
        held_out: len(PreparedItems(shards, held_out=held_out))
        for held_out in (False, True)
    }
    assert count[True] == sum(heap in out for heap in heaps)
    assert count[False] == sum(heap not in out for heap in heaps)


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
        assert given != expected
        ours, theirs = open_prepared(given), open_prepared(expected)
        assert ours.targets == theirs.targets
        for row, held_out in enumerate(theirs.held_out):
            one, other = ours.item(row), theirs.item(row)
            np.testing.assert_array_equal(one.fine, other.fine)
            np.testing.assert_array_equal(one.labels[1], other.labels[1])
            same = np.array_equal(one.labels[0], other.labels[0])
            # A hidden target's label stays, too.
            if held_out or not one.fine[1].any():
                assert same
            changed += not same
    assert changed > 3


def _items(
    sample: Sample, **change: Any
) -> list[tuple[dict[str, np.ndarray], np.ndarray]]:
    config = dataclasses.replace(EXACT, **change)
    made = []
    for seed in range(8):
        item, size = sample_item(sample, config, np.random.default_rng(seed))
        made.append((_named(item), size))
    return made


def test_each_error_changes_what_it_should_and_no_label() -> None:
    sample = _sample(1)
    ((exact, size), *rest) = _items(sample)
    for images, _ in rest:
        for name, image in images.items():
            np.testing.assert_array_equal(image, exact[name])

    def changed(**change: Any) -> tuple[set[str], list[np.ndarray]]:
        found, sizes = set(), []
        for images, features in _items(sample, **change):
            sizes.append(features)
            found |= {
                name
                for name, image in images.items()
                if not np.array_equal(image, exact[name])
            }
        return found, sizes

    found, sizes = changed(noisy=1.0)
    assert {"reading", "cover", "height"} >= found >= {"reading", "cover"}
    assert all(np.array_equal(s, size) for s in sizes)

    found, sizes = changed(mask_errors=1.0)
    assert found == {"modal"}
    shares = [s[4] for s in sizes]
    assert min(shares) < size[4] < max(shares)

    found, sizes = changed(miscalibrated=1.0, height_error=0.003)
    assert {"cover", "height"} <= found <= {"cover", "height", "floor"}
    error = [s[:2] - size[:2] for s in sizes]
    assert 1e-4 < np.abs(error).max() < 0.05


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
    folder = tmp_path / "growing"
    folder.mkdir()
    for name in ("dataset.json", "train-00001.h5"):
        (folder / name).write_bytes((dataset / name).read_bytes())
    with pytest.raises(DatasetError, match=r"00000\.h5 is missing: resume"):
        plan([folder], tmp_path, EXACT, SHARE)
    ((shard, _),) = plan([folder], tmp_path, EXACT, SHARE, incomplete=True)
    assert shard == folder / "train-00001.h5"
    jobs = plan([folder, dataset], tmp_path, EXACT, SHARE, incomplete=True)
    # A copy of a dataset has the same items.
    assert len(jobs) == 4
    assert len({path for _, path in jobs}) == 3


def test_no_dataset_and_no_shard_are_one_line(
    dataset: Path, tmp_path: Path
) -> None:
    (tmp_path / "dataset.json").write_bytes(
        (dataset / "dataset.json").read_bytes()
    )
    for folder, words in (
        (tmp_path, f"no shard in {tmp_path}: run 'xray-drake generate'"),
        (tmp_path / "gone", "gone is no dataset"),
    ):
        with pytest.raises(DatasetError, match=words) as error:
            plan([folder], tmp_path, EXACT, SHARE, incomplete=True)
        assert "\n" not in str(error.value)


def test_a_damaged_shard_is_named_and_leaves_nothing(
    dataset: Path, tmp_path: Path, made: list[str]
) -> None:
    folder = tmp_path / "damaged"
    folder.mkdir()
    for path in dataset.iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    bad = folder / "train-00001.h5"
    bad.write_bytes(bad.read_bytes()[:-100])
    # Cut short, it is found before anything is made.
    cache = tmp_path / "cache"
    with pytest.raises(ShardError, match=r"train-00001\.h5 is damaged"):
        plan([folder], cache, EXACT, SHARE)
    assert not cache.exists()
    # Changed within, when it is read.
    bad.write_bytes((dataset / bad.name).read_bytes())
    flip_bit(bad)
    jobs = plan([folder], cache, EXACT, SHARE)
    with pytest.raises(ShardError, match=r"train-00001\.h5 is damaged"):
        list(prepare(jobs, EXACT, SHARE, workers=0))
    left = [path for path in cache.iterdir() if "00001" in path.name]
    assert left == []


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


def test_processes_make_the_same_items(dataset: Path, tmp_path: Path) -> None:
    files = _prepare(dataset, tmp_path, PrepareConfig(), workers=1)
    path = tmp_path / "here.npz"
    prepare_shard(dataset / "train-00000.h5", path, PrepareConfig(), SHARE)
    assert files[0].read_bytes() == path.read_bytes()


def test_items_have_one_writer(
    dataset: Path, tmp_path: Path, made: list[str]
) -> None:
    with sole_writer(tmp_path):
        with pytest.raises(InUseError):
            _prepare(dataset, tmp_path)
        assert not made
    _prepare(dataset, tmp_path)
    # Who finds all there writes nothing.
    with sole_writer(tmp_path):
        _prepare(dataset, tmp_path)
