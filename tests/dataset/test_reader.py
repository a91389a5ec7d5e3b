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
            item["occupancy"][0], sample.occupancy, atol=1 / 255
        )
        np.testing.assert_array_equal(item["modal"][0], sample.target_modal)
        np.testing.assert_array_equal(item["amodal"][0], sample.target_amodal)
        np.testing.assert_allclose(item["target_size"], sample.target_size)
        assert item["index"] == index
        assert item["key"] == str(sample.key)
        assert items.keys[index] == sample.key
        assert items.sample(index).key == sample.key
    assert items[0]["input"].shape == (3, 24, 32)
    assert items[0]["occupancy"].shape == (1, 24, 32)
    assert items[0]["occupancy"].dtype == torch.float32
    assert items[0]["modal"].dtype == torch.bool
    _assert_same(items[-1], items[9])
    for index in (10, -11):
        with pytest.raises(IndexError):
            items[index]


def test_splits_by_object(dataset: Any) -> None:
    counts = [
        len(OccupancyDataset(dataset.folder, split=split))
        for split in ("train", "validation", "test")
    ]
    assert counts == [5, 2, 3]


def test_splits_by_image_keep_heaps_together(dataset: Any) -> None:
    parts = [
        OccupancyDataset(dataset.folder, images=part, validation_share=0.5)
        for part in ("train", "validation")
    ]
    seeds = [{key.heap_seed for key in part.keys} for part in parts]
    assert seeds[0] & seeds[1] == set()
    assert sum(map(len, parts)) == 10
    for key in parts[1].keys:
        assert is_held_out(key.heap_seed, 0.5)


def test_the_share_of_heaps_held_out() -> None:
    held_out = [is_held_out(seed, 0.2) for seed in range(5000)]
    assert np.mean(held_out) == pytest.approx(0.2, abs=0.02)
    # The same for ever: a trained network depends on it.
    assert [i for i, out in enumerate(held_out) if out][:5] == [
        2,
        6,
        17,
        18,
        23,
    ]
    # A larger share holds out the same and more.
    assert all(
        is_held_out(seed, 0.3) for seed, out in enumerate(held_out) if out
    )
    assert not is_held_out(3, 0.0)
    assert is_held_out(3, 1.0)


def test_some_targets_only(dataset: Any) -> None:
    items = OccupancyDataset(dataset.folder, targets=["lid"])
    assert {key.target_name for key in items.keys} == {"lid"}
    assert len(items) == 4


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
    expected = [items[i] for i in range(10)]  # files are open here now
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
        assert [b["input"].shape for b in batches] == [(5, 3, 24, 32)] * 2
        found = torch.cat([b["input"] for b in batches])
        same = [
            torch.equal(e["input"], f)
            for e, f in zip(expected, found, strict=True)
        ]
        assert all(same) if epoch == 0 else not any(same)
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
        assert len(_open_files(dataset.folder)) <= 2


def _open_files(folder: Any) -> list[str]:
    if not os.path.isdir("/proc/self/fd"):
        return []
    links = []
    for number in os.listdir("/proc/self/fd"):
        try:
            link = os.readlink(f"/proc/self/fd/{number}")
        except OSError:
            continue
        if link.startswith(str(folder)):
            links.append(link)
    return links


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


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"dataset": "0123"}, "belongs to another dataset, '0123'"),
        ({"split": "train"}, "belongs to split 'train'"),
        ({"index": 0}, "is number 0 of its split, renamed"),
        ({"format_version": 2}, "has format version 2"),
    ],
)
@pytest.mark.parametrize("incomplete", [False, True])
def test_a_shard_of_another_place_is_refused(
    own_dataset: Any, changes: Any, line: str, incomplete: bool
) -> None:
    own_dataset.write_shard(
        "test-00001.h5", own_dataset.samples[-1:], **changes
    )
    OccupancyDataset(own_dataset.folder, split="train")
    with pytest.raises(ForeignShardError, match=rf"test-00001\.h5 {line}"):
        OccupancyDataset(own_dataset.folder, incomplete=incomplete)


def test_a_shard_of_another_size_is_refused(own_dataset: Any) -> None:
    own_dataset.write_shard("test-00000.h5", own_dataset.samples[-3:])
    with pytest.raises(ShardError, match="has 3 samples instead of 2"):
        OccupancyDataset(own_dataset.folder)
    assert not _open_files(own_dataset.folder)


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
