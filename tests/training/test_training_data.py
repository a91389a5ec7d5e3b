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

from xray_drake.training.config import TrainConfig, TrainingError
from xray_drake.training.data import (
    PassSampler,
    PreparedItems,
    TrainingData,
    steps_per_epoch,
)
from xray_drake.training.items import Item, pack
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
    numbers = first + np.arange(len(rows))
    packed = [pack(item(number)) for number in numbers.tolist()]
    names = tuple(name for name, _ in rows)
    return Prepared(
        packed=np.frombuffer(b"".join(packed), np.uint8),
        ends=np.cumsum([len(data) for data in packed]),
        shape=(8, 12),
        sizes=np.tile(numbers[:, None], 5).astype(np.float32),
        real=np.array([not name.startswith("virtual_") for name in names]),
        held_out=np.array([held_out for _, held_out in rows]),
        targets=names,
    )


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
    assert numbers(items) == [10, 20, 21]
    for i, real in enumerate((True, False, True)):
        *images, size, told = items[i]
        number = numbers(items)[i]
        expected = item(number)
        for image, other in zip(
            images,
            (expected.fine, expected.coarse, expected.labels),
            strict=True,
        ):
            assert image.dtype == torch.uint8
            np.testing.assert_array_equal(image, other)
        assert size.dtype == torch.float32
        assert size.tolist() == [number] * 5
        assert told.dtype == torch.bool
        assert bool(told) is real
    # Copies: what is changed in a batch is not changed in the shard.
    for image in items[0][:3]:
        image.zero_()
    fine, coarse, labels, *_ = items[0]
    assert (fine[0] == 170).all()
    assert (coarse == 10).all()
    assert labels[0, 0, 0] == 10


def epochs(sampler: PassSampler, *numbers: int) -> list[int]:
    drawn: list[int] = []
    for number in numbers:
        sampler.set_epoch(number)
        part = list(sampler)
        assert len(part) == len(sampler)
        drawn += part
    return drawn


_sampler = {
    "items": st.integers(1, 40),
    "per_epoch": st.integers(1, 60),
    "seed": st.integers(0, 99),
}


@given(**_sampler)
@settings(deadline=None, max_examples=100)
def test_every_pass_has_every_item_once(
    items: int, per_epoch: int, seed: int
) -> None:
    count = -(-3 * items // per_epoch)
    drawn = epochs(PassSampler(items, per_epoch, seed), *range(count))
    assert len(drawn) == count * per_epoch >= 3 * items
    rest = iter(drawn)
    passes = [list(islice(rest, items)) for _ in range(3)]
    for one in passes:
        assert sorted(one) == list(range(items))


@given(**_sampler, gone=st.integers(0, 9))
@settings(deadline=None, max_examples=100)
def test_a_resumed_sampler_goes_on_as_it_would_have_gone(
    items: int, per_epoch: int, seed: int, gone: int
) -> None:
    whole = epochs(PassSampler(items, per_epoch, seed), *range(gone + 3))
    resumed = PassSampler(items, per_epoch, seed)
    rest = epochs(resumed, gone, gone + 1, gone + 2)
    assert whole[gone * per_epoch :] == rest
    # The same epoch is the same, whatever was before.
    assert epochs(resumed, gone) == rest[:per_epoch]


@given(**_sampler, devices=st.integers(1, 3))
@settings(deadline=None, max_examples=50)
def test_devices_share_an_epoch(
    items: int, per_epoch: int, seed: int, devices: int
) -> None:
    for number in range(3):
        whole = epochs(PassSampler(items, per_epoch, seed), number)
        shares = [
            epochs(
                PassSampler(items, per_epoch, seed, rank=rank, devices=devices),
                number,
            )
            for rank in range(devices)
        ]
        together = [item for step in zip(*shares, strict=True) for item in step]
        assert together == whole[: len(together)]
        assert len(whole) - len(together) < devices


def test_passes_and_seeds_differ() -> None:
    drawn = epochs(PassSampler(50, 50, 0), 0, 1)
    assert drawn[:50] != drawn[50:]
    assert drawn[:50] != epochs(PassSampler(50, 50, 1), 0)
    assert drawn[:50] != list(range(50))


def test_what_is_asked_for_may_be_nowhere() -> None:
    shards = [shard(0, ("lid", False))]
    assert len(PreparedItems(shards, held_out=True)) == 0
    assert len(PreparedItems(shards, held_out=False, targets=["flute"])) == 0


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
    ],
)
def test_every_device_needs_an_item(
    train: int, held_out: int, devices: int, words: str
) -> None:
    with pytest.raises(TrainingError, match=words):
        counted(train, held_out, devices)


def test_every_device_needs_a_batch() -> None:
    config = TrainConfig(items_per_epoch=7, batch_size=2)
    assert steps_per_epoch(config, 3) == 1
    with pytest.raises(TrainingError, match="items_per_epoch is 7: 4 devices"):
        steps_per_epoch(config, 4)
