import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from tests.dataset.whole import flip_bit
from xray_drake.dataset import reader as reader_module
from xray_drake.dataset.augmentation import Augmentation
from xray_drake.dataset.manifest import DatasetError
from xray_drake.dataset.reader import OccupancyDataset, is_held_out
from xray_drake.dataset.shards import ForeignShardError, ShardError
from xray_drake.occupancy.learned.augmented_depth import augmented_depth


def _assert_same(a: dict[str, Any], b: dict[str, Any]) -> None:
    assert a.keys() == b.keys()
    for name, value in a.items():
        if isinstance(value, torch.Tensor):
            assert value.dtype == b[name].dtype
            assert torch.equal(value, b[name])
        else:
            assert value == b[name]


def test_an_item(dataset: Any) -> None:
    items = OccupancyDataset(dataset.folder)
    assert len(items) == 10
    for index, sample in enumerate(dataset.samples):
        item = items[index]
        np.testing.assert_array_equal(
            item["input"], augmented_depth(sample.depth, sample.target_modal)
        )
        np.testing.assert_allclose(
            item["occupancy"], sample.occupancy[None], atol=1 / 255
        )
        np.testing.assert_array_equal(item["modal"][0], sample.target_modal)
        np.testing.assert_array_equal(item["amodal"][0], sample.target_amodal)
        np.testing.assert_allclose(item["target_size"], sample.target_size)
        assert (item["index"], item["key"]) == (index, str(sample.key))
        assert items.keys[index] == items.sample(index).key == sample.key
    assert items[0]["occupancy"].dtype == torch.float32
    assert items[0]["modal"].dtype == torch.bool
    _assert_same(items[-1], items[9])
    for index in (10, -11):
        with pytest.raises(IndexError):
            items[index]


def test_splits_by_image_keep_heaps_together(dataset: Any) -> None:
    parts = [
        OccupancyDataset(dataset.folder, images=part, validation_share=0.5)
        for part in ("train", "validation")
    ]
    assert sum(map(len, parts)) == 10
    for part, held_out in zip(parts, (False, True), strict=True):
        assert part.keys
        for key in part.keys:
            assert is_held_out(key.heap_seed, 0.5) == held_out


@pytest.mark.parametrize(
    ("chosen", "count"),
    [
        ({"split": "train"}, 5),
        ({"split": "validation"}, 2),
        ({"split": "test"}, 3),
        ({"targets": ["lid"]}, 4),
    ],
)
def test_some_samples_only(
    dataset: Any, chosen: dict[str, Any], count: int
) -> None:
    items = OccupancyDataset(dataset.folder, **chosen)
    assert len(items) == count
    for index, key in enumerate(items.keys):
        assert key.target_name in chosen.get("targets", key.target_name)
        name = items.sample(index).object_names[0]
        assert name.startswith(chosen.get("split", name))


def test_the_share_of_heaps_held_out() -> None:
    held_out = [is_held_out(seed, 0.2) for seed in range(5000)]
    assert np.mean(held_out) == pytest.approx(0.2, abs=0.02)
    # The same for ever: a trained network depends on it.
    assert np.flatnonzero(held_out)[:5].tolist() == [2, 6, 17, 18, 23]
    # A larger share holds out the same and more.
    for seed in np.flatnonzero(held_out).tolist():
        assert is_held_out(seed, 0.3)
    assert not is_held_out(3, 0.0)
    assert is_held_out(3, 1.0)


def test_a_transform_draws_anew_each_epoch(dataset: Any) -> None:
    def items() -> OccupancyDataset:
        return OccupancyDataset(
            dataset.folder, transform=Augmentation(), seed=3
        )

    first = items()
    _assert_same(first[2], items()[2])
    before = first[2]["input"]
    first.set_epoch(1)
    assert not torch.equal(first[2]["input"], before)
    first.set_epoch(0)
    assert torch.equal(first[2]["input"], before)


def test_loader_workers_read_the_same(dataset: Any) -> None:
    items = OccupancyDataset(dataset.folder, transform=Augmentation())
    expected = [items[i]["input"] for i in range(10)]  # files are open here now
    loader = DataLoader(
        items,
        batch_size=5,
        num_workers=2,
        multiprocessing_context="fork",
        persistent_workers=True,
    )
    for epoch in (0, 1):
        items.set_epoch(epoch)
        batches = list(loader)
        found = [image for b in batches for image in b["input"]]
        same = list(map(torch.equal, expected, found))
        assert same == [epoch == 0] * 10
        keys = [key for b in batches for key in b["key"]]
        assert keys == [str(s.key) for s in dataset.samples]


def test_few_files_stay_open(
    dataset: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reader_module, "_MAX_OPEN", 2)
    items = OccupancyDataset(dataset.folder)
    expected = [s.target_amodal for s in dataset.samples]
    for index in np.random.default_rng(0).permutation(10).tolist() * 2:
        np.testing.assert_array_equal(
            items[index]["amodal"][0], expected[index]
        )
        paths = map(os.path.realpath, Path("/proc/self/fd").glob("*"))
        opened = [p for p in paths if p.startswith(str(dataset.folder))]
        assert len(opened) <= 2


def test_a_damaged_image_is_named(own_dataset: Any) -> None:
    items = OccupancyDataset(own_dataset.folder)
    flip_bit(own_dataset.folder / "test-00001.h5")
    items[0]
    with pytest.raises(ShardError, match=r"test-00001\.h5 is damaged"):
        items[9]


def test_a_missing_shard_is_named(own_dataset: Any) -> None:
    (own_dataset.folder / "train-00002.h5").unlink()
    with pytest.raises(DatasetError, match=r"train-00002\.h5 is missing"):
        OccupancyDataset(own_dataset.folder)
    assert len(OccupancyDataset(own_dataset.folder, split="test")) == 3
    assert len(OccupancyDataset(own_dataset.folder, incomplete=True)) == 9


@pytest.mark.parametrize("incomplete", [False, True])
@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"dataset": "0123"}, "belongs to another dataset, '0123'"),
        ({"split": "train"}, "belongs to split 'train'"),
        ({"index": 0}, "is number 0 of its split, renamed"),
        ({"format_version": 2}, "has format version 2"),
        ({}, "has 3 samples instead of 1"),
    ],
)
def test_a_shard_of_another_place_is_refused(
    own_dataset: Any, changes: Any, line: str, incomplete: bool
) -> None:
    samples = own_dataset.samples[-1 if changes else -3 :]
    own_dataset.write_shard("test-00001.h5", samples, **changes)
    OccupancyDataset(own_dataset.folder, split="train")
    error = ForeignShardError if changes else ShardError
    with pytest.raises(error, match=rf"test-00001\.h5 {line}"):
        OccupancyDataset(own_dataset.folder, incomplete=incomplete)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ({"split": "training"}, "no split is called 'training'"),
        ({"images": "test"}, "images are all, train or validation"),
        ({"validation_share": 1.5}, "validation_share is 1.5"),
        ({"targets": ["flute"]}, "holds no sample of what was asked for"),
    ],
)
def test_bad_arguments(dataset: Any, arguments: Any, line: str) -> None:
    with pytest.raises(ValueError, match=line):
        OccupancyDataset(dataset.folder, **arguments)


def test_a_process_without_drake_reads_the_same(
    dataset: Any, tmp_path: Path
) -> None:
    items = OccupancyDataset(dataset.folder, transform=Augmentation())
    expected = items[3]["input"]
    (tmp_path / "items").write_bytes(pickle.dumps(items))
    script = (
        "import pickle, sys\n"
        "sys.modules['pydrake'] = None\n"
        "import xray_drake.training.disturbance\n"
        "import xray_drake.training.evaluation\n"
        "assert 'torch' not in sys.modules\n"
        "import xray_drake.training.predictors\n"
        "from xray_drake.dataset.check import check_dataset\n"
        "from xray_drake.inspector.figures import sample_figure\n"
        "from xray_drake.inspector.dataset import sample_layers\n"
        "items = pickle.load(open(sys.argv[1], 'rb'))\n"
        "sample_figure([items.sample(0)])\n"
        "sample_layers(items.sample(0))\n"
        "items[3]['input'].numpy().tofile(sys.argv[2])\n"
    )
    subprocess.run(
        [sys.executable, "-c", script, tmp_path / "items", tmp_path / "out"],
        check=True,
    )
    found = np.fromfile(tmp_path / "out", np.float32)
    np.testing.assert_array_equal(found, expected.numpy().reshape(-1))
