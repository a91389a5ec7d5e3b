from itertools import islice
from typing import Any

import lightning
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor, nn
from torch.utils.data import TensorDataset

from tests.training.making import shard_of
from xray_drake.training.config import TrainConfig, TrainingError
from xray_drake.training.data import (
    PassSampler,
    PreparedItems,
    TrainingData,
)
from xray_drake.training.items import Item
from xray_drake.training.prepare import Prepared

TARGETS = ("lid", "flute", "virtual_box_60x30x5")


def item(number: int) -> Item:
    """One that is told by its coarse pixels, and by its label's first."""
    fine, labels = np.zeros((2, 2, 8, 12), np.uint8)
    fine[0] = 17 * (number % 16)
    labels[0, 0, 0] = number
    return Item(
        fine=fine,
        coarse=np.full((3, 2, 3), number, np.uint8),
        labels=labels,
    )


def shard(first: int, *rows: tuple[str, bool]) -> Prepared:
    """Items first, first + 1, …

    Args:
        first: of the first item.
        rows: each item's target, and whether it is held out.
    """
    numbers = range(first, first + len(rows))
    names, held_out = zip(*rows, strict=True)
    sizes = np.tile(np.array(numbers)[:, None], 5)
    return shard_of([*map(item, numbers)], sizes, names, held_out)


_row = st.tuples(st.sampled_from(TARGETS), st.booleans())
_shards = st.lists(
    st.lists(_row, min_size=1, max_size=6), min_size=1, max_size=4
)


def numbers(items: PreparedItems) -> list[int]:
    return [int(items[i][2][0, 0, 0]) for i in range(len(items))]


@given(
    rows=_shards,
    targets=st.lists(st.sampled_from(["lid", "flute", "domino"])),
    virtual=st.booleans(),
)
@settings(deadline=None, max_examples=100)
def test_items_are_those_that_were_asked_for(
    rows: list[list[tuple[str, bool]]], targets: list[str], virtual: bool
) -> None:
    firsts = np.cumsum([0, *(len(part) for part in rows)]).tolist()
    shards = [
        shard(first, *part) for first, part in zip(firsts, rows, strict=False)
    ]
    everything = [row for part in rows for row in part]
    found = []
    for held_out in (False, True):
        items = PreparedItems(
            shards, held_out=held_out, targets=targets, virtual=virtual
        )
        wanted = [
            number
            for number, (name, out) in enumerate(everything)
            if out == held_out
            and (
                virtual
                if name.startswith("virtual_")
                else not targets or name in targets
            )
        ]
        assert numbers(items) == wanted
        assert items.num_real == sum(
            not everything[number][0].startswith("virtual_")
            for number in wanted
        )
        found += wanted
    assert len(set(found)) == len(found)


def test_an_item_is_its_images_its_size_and_whether_it_is_real() -> None:
    shards = [
        shard(10, ("lid", False), ("lid", True)),
        shard(20, ("virtual_box_60x30x5", False), ("flute", False)),
    ]
    items = PreparedItems(shards, held_out=False)
    for i, (number, real) in enumerate(((10, True), (20, False), (21, True))):
        *images, size, told = items[i]
        expected = item(number)
        for image, other in zip(
            images,
            (expected.fine, expected.coarse, expected.labels),
            strict=True,
        ):
            np.testing.assert_array_equal(image, other, strict=True)
            image.zero_()  # a copy: nothing changes in the shard
        assert size.dtype == torch.float32
        assert size.tolist() == [number] * 5
        assert told.dtype == torch.bool
        assert bool(told) is real
    assert numbers(items) == [10, 20, 21]


@given(
    items=st.integers(1, 40),
    steps=st.integers(1, 20),
    devices=st.integers(1, 3),
    seed=st.integers(0, 99),
)
@settings(deadline=None, max_examples=100)
def test_in_every_pass_each_device_has_items_of_its_own(
    items: int, steps: int, devices: int, seed: int
) -> None:
    """Epochs are parts of passes; each sampler knows its epoch alone."""
    per_epoch = steps * devices
    count = -(-3 * items // per_epoch)
    drawn: list[int] = []
    for epoch in range(count):
        shares = []
        for rank in range(devices):
            # What does not divide is the next epoch's.
            sampler = PassSampler(
                items, per_epoch, seed, rank=rank, devices=devices
            )
            sampler.set_epoch(epoch)
            shares.append(list(sampler))
            assert len(shares[-1]) == len(sampler) == steps
        drawn += [item for step in zip(*shares, strict=True) for item in step]
    rest = iter(drawn)
    passes = [list(islice(rest, items)) for _ in range(3)]
    for one in passes:
        assert sorted(one) == list(range(items))
    assert items < 20 or passes[0] != passes[1] != sorted(passes[1])
    other = PassSampler(items, per_epoch, seed + 1)
    assert items < 20 or steps < 20 or list(other) != drawn[:per_epoch]


@pytest.mark.parametrize(
    ("passes", "epochs_"), [(0.1, 1), (1.0, 2), (2.5, 6), (3.2, 7)]
)
def test_epochs_are_parts_of_passes(passes: float, epochs_: int) -> None:
    config = TrainConfig(passes=passes, items_per_epoch=10, batch_size=3)
    items = PreparedItems([shard(0, *[("lid", False)] * 20)], held_out=False)
    data = TrainingData(items, items, config, workers=0)
    assert data.num_images == 40
    assert data.epochs == epochs_
    assert data.steps_per_epoch == 3
    loader = data.train_dataloader()
    batches = list(loader)
    assert len(batches) == data.steps_per_epoch
    # What makes no whole batch is the next epoch's.
    assert loader.sampler is not None
    assert len(loader.sampler) == 9  # type: ignore[arg-type]
    assert all(len(tensor) == 3 for batch in batches for tensor in batch)
    validation = list(data.val_dataloader())
    assert sum(len(real) for *_, real in validation) == 20
    for fine, coarse, labels, sizes, real in batches + validation:
        assert fine.shape[1:] == labels.shape[1:] == (2, 8, 12)
        assert coarse.shape[1:] == (3, 2, 3)
        assert real.shape == (len(fine),)
        # What is of an item stays together.
        of = labels[:, 0, 0, 0]
        assert (coarse == of[:, None, None, None]).all()
        assert (sizes == of[:, None]).all()


class Notes(lightning.LightningModule):
    """Notes the numbers that it is trained and validated on."""

    def __init__(self) -> None:
        super().__init__()
        self.layer = nn.Linear(1, 1)
        self.trained: list[int] = []
        self.validated: list[int] = []

    def training_step(self, batch: list[Tensor], index: int) -> Tensor:
        self.trained += batch[0].tolist()
        return self.layer(batch[0][:, None].float()).sum()

    def validation_step(self, batch: list[Tensor], index: int) -> None:
        self.validated += batch[0].tolist()

    def configure_optimizers(self) -> Any:
        return torch.optim.SGD(self.parameters(), 1e-9)


def counted(train: int, held_out: int, devices: int) -> TrainingData:
    return TrainingData(
        TensorDataset(torch.arange(train)),
        TensorDataset(torch.arange(held_out)),
        TrainConfig(passes=1, items_per_epoch=8, batch_size=2),
        workers=0,
        devices=devices,
    )


@pytest.mark.filterwarnings("ignore:.*does not have many workers")
@pytest.mark.filterwarnings("ignore:The number of training batches")
@pytest.mark.filterwarnings("ignore:.*treespec, LeafSpec")
@pytest.mark.parametrize("devices", [1, 2])
def test_in_a_pass_the_trainers_devices_see_every_item_once(
    monkeypatch: pytest.MonkeyPatch, devices: int
) -> None:
    """One after the other here: no device sees what another does."""
    trained, validated = [], []
    for rank in range(devices):
        monkeypatch.setattr(TrainingData, "_rank", lambda data, r=rank: r)
        data = counted(24, 7, devices)
        trainer = lightning.Trainer(
            max_epochs=data.epochs,
            accelerator="cpu",
            logger=False,
            enable_checkpointing=False,
            enable_progress_bar=False,
            enable_model_summary=False,
            num_sanity_val_steps=0,
            use_distributed_sampler=False,
        )
        notes = Notes()
        trainer.fit(notes, data)
        assert trainer.global_step == data.epochs * data.steps_per_epoch
        assert len(notes.validated) % data.epochs == 0
        trained += notes.trained
        validated += notes.validated[: len(notes.validated) // data.epochs]
    assert sorted(trained) == list(range(24))
    # None is repeated, so metrics are those of one device.
    assert sorted(validated) == list(range(7))


@pytest.mark.parametrize(
    ("train", "held_out", "devices", "words"),
    [
        (24, 0, 1, "no sample is held out for validation, for 1 device:"),
        (24, 1, 2, "1 sample is held out for validation, for 2 devices:"),
        (1, 7, 2, "1 sample is to train on, for 2 devices:"),
        (24, 7, 5, "items_per_epoch is 8: 5 devices need a batch of 2"),
    ],
)
def test_every_device_needs_an_item_and_a_batch(
    train: int, held_out: int, devices: int, words: str
) -> None:
    with pytest.raises(TrainingError, match=words):
        assert counted(train, held_out, devices).steps
    assert counted(24, 7, 4).steps_per_epoch == 1
