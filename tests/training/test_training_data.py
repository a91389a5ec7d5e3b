from itertools import islice

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from xray_drake.training.config import TrainConfig
from xray_drake.training.data import PassSampler, PreparedItems, TrainingData
from xray_drake.training.prepare import Prepared

TARGETS = ("lid", "flute", "virtual_box_60x30x5")


def shard(first: int, *rows: tuple[str, bool]) -> Prepared:
    """Items that are told apart by their first pixel: first, first + 1, …

    Args:
        first: of the first item.
        rows: each item's target, and whether it is held out.
    """
    images = np.zeros((len(rows), 7, 4, 6), np.uint8)
    images[:, 0, 0, 0] = first + np.arange(len(rows))
    names = tuple(name for name, _ in rows)
    return Prepared(
        images=images,
        sizes=np.tile(images[:, 0, 0, :1], 5).astype(np.float32),
        real=np.array([not name.startswith("virtual_") for name in names]),
        held_out=np.array([held_out for _, held_out in rows]),
        targets=names,
    )


_row = st.tuples(st.sampled_from(TARGETS), st.booleans())
_shards = st.lists(
    st.lists(_row, min_size=1, max_size=6), min_size=1, max_size=4
)


def numbers(items: PreparedItems) -> list[int]:
    return [int(items[i][0][0, 0, 0]) for i in range(len(items))]


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


def test_an_item_is_an_image_its_size_and_whether_it_is_real() -> None:
    shards = [
        shard(10, ("lid", False), ("lid", True)),
        shard(20, ("virtual_box_60x30x5", False), ("flute", False)),
    ]
    items = PreparedItems(shards, held_out=False)
    assert numbers(items) == [10, 20, 21]
    for i, real in enumerate((True, False, True)):
        image, size, told = items[i]
        assert image.dtype == torch.uint8
        assert image.shape == (7, 4, 6)
        assert size.dtype == torch.float32
        assert size.tolist() == [image[0, 0, 0]] * 5
        assert told.dtype == torch.bool
        assert bool(told) is real
    # A copy: what is changed in a batch is not changed on disk.
    items[0][0].zero_()
    assert numbers(items) == [10, 20, 21]


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
    ("passes", "epochs_"), [(0.1, 1), (1.0, 2), (2.5, 5), (3.2, 6)]
)
def test_epochs_are_parts_of_passes(passes: float, epochs_: int) -> None:
    config = TrainConfig(passes=passes, items_per_epoch=10, batch_size=3)
    items = PreparedItems([shard(0, *[("lid", False)] * 20)], held_out=False)
    data = TrainingData(items, items, config, num_images=40, workers=0)
    assert data.epochs == epochs_
    assert data.steps_per_epoch == 3
    loader = data.train_dataloader()
    batches = list(loader)
    assert len(batches) == data.steps_per_epoch
    assert all(len(images) == 3 for images, _, _ in batches)
    assert sum(len(images) for images, _, _ in data.val_dataloader()) == 20
