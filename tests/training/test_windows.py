from itertools import chain, pairwise

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from xray_drake.occupancy.learned.windowed import WindowedNet
from xray_drake.training.config import TrainConfig
from xray_drake.training.data import PreparedItems
from xray_drake.training.items import Item, pack
from xray_drake.training.prepare import Prepared
from xray_drake.training.windows import (
    WindowBatch,
    WindowedTraining,
    WindowItems,
    WindowSampler,
)

SHAPE = (192, 256)
# Length and width as log of pixels by 20, thickness by 10 mm, hidden, share.
FEATURES = (0.0, -0.5, 0.5, 0.0, 0.1)


def _item(corner: tuple[int, int] | None, rng: np.random.Generator) -> Item:
    """Of a target that is seen at a corner of its 4 × 6 pixels, or hidden."""
    fine = np.zeros((2, *SHAPE), np.uint8)
    fine[0] = 17 * rng.integers(0, 16, SHAPE)
    if corner is not None:
        fine[1, corner[0] : corner[0] + 4, corner[1] : corner[1] + 6] = 255
    labels = rng.integers(0, 256, (2, *SHAPE), np.uint8)
    labels[1] = 255 * (labels[1] > 127)
    coarse = rng.integers(0, 256, (3, SHAPE[0] // 4, SHAPE[1] // 4), np.uint8)
    return Item(fine, coarse, labels)


def _items(*corners: tuple[int, int] | None) -> PreparedItems:
    rng = np.random.default_rng(0)
    packed = [pack(_item(corner, rng)) for corner in corners]
    number = len(corners)
    shard = Prepared(
        packed=np.frombuffer(b"".join(packed), np.uint8),
        ends=np.cumsum([len(data) for data in packed]),
        shape=SHAPE,
        sizes=np.tile(np.float32(FEATURES), (number, 1)),
        real=np.arange(number) % 2 == 0,
        held_out=np.zeros(number, bool),
        targets=("lid",) * number,
    )
    return PreparedItems([shard], held_out=False)


def test_windows_are_of_what_is_seen() -> None:
    items = _items((98, 121), None, (3, 250), None, (82, 93))
    windows = WindowItems(items)
    assert len(windows) == 3
    assert windows.num_real == 3
    assert windows.sides == [(64, 64)] * 3
    for i, index in enumerate((0, 2, 4)):
        fine, coarse, labels, size, real, outside = windows[i]
        all_fine, all_coarse, all_labels, told, _ = items[index]
        assert bool(real)
        torch.testing.assert_close(size, told)
        # All of what is seen, in the middle unless the image ends.
        assert fine[1].sum() == all_fine[1].sum()
        (top, left) = _place(fine[0].numpy(), all_fine[0].numpy())
        assert (top, left) == [(68, 92), (0, 192), (52, 64)][i]
        part = slice(top, top + 64), slice(left, left + 64)
        assert torch.equal(fine, all_fine[:, *part])
        assert torch.equal(labels, all_labels[:, *part])
        quarter = (
            slice(top // 4, top // 4 + 16),
            slice(left // 4, left // 4 + 16),
        )
        assert torch.equal(coarse, all_coarse[:, *quarter])
        inside = int((labels[0] > 25.5).sum())
        assert outside[0] + inside == (all_labels[0] > 25.5).sum()
        assert outside.sum() == SHAPE[0] * SHAPE[1] - 64 * 64


def _place(part: np.ndarray, image: np.ndarray) -> tuple[int, int]:
    """Where a part with noise in it is in the image."""
    height, width = part.shape
    for top in range(image.shape[0] - height + 1):
        for left in range(image.shape[1] - width + 1):
            if np.array_equal(image[top, left : left + width], part[0]):
                return top, left
    raise AssertionError("no such part")


_sides = st.lists(
    st.sampled_from([(96, 96), (128, 128), (192, 256)]),
    min_size=3,
    max_size=40,
)


@settings(deadline=None, max_examples=50)
@given(
    sides=_sides,
    devices=st.integers(1, 3),
    epoch=st.integers(0, 4),
    seed=st.integers(0, 3),
)
def test_batches_are_of_one_size_and_shared_out(
    sides: list[tuple[int, int]], devices: int, epoch: int, seed: int
) -> None:
    config = TrainConfig(items_per_epoch=16, batch_size=2, seed=seed)
    batches = []
    for rank in range(devices):
        sampler = WindowSampler(sides, config, rank=rank, devices=devices)
        sampler.set_epoch(epoch)
        batches.append(list(sampler))
        assert len(batches[-1]) == len(sampler) == 8 // devices
        assert batches[-1] == list(sampler)
    for together in zip(*batches, strict=True):
        of_all = [index for batch in together for index in batch]
        assert all(len(batch) == 2 for batch in together)
        assert len({sides[index] for index in of_all}) == 1


@settings(deadline=None, max_examples=30)
@given(sides=_sides, devices=st.integers(1, 3), seed=st.integers(0, 3))
def test_a_pass_has_windows_of_rare_sizes_as_well(
    sides: list[tuple[int, int]], devices: int, seed: int
) -> None:
    """Epochs end anywhere in a pass."""
    config = TrainConfig(items_per_epoch=16, batch_size=4, seed=seed)
    drawn: list[list[int]] = []  # of each step, on all devices
    for epoch in range(12):
        ranks = []
        for rank in range(devices):
            sampler = WindowSampler(sides, config, rank=rank, devices=devices)
            sampler.set_epoch(epoch)
            ranks.append(list(sampler))
        drawn += [[*chain(*step)] for step in zip(*ranks, strict=True)]
    steps = sampler.steps_per_pass
    assert len(drawn) >= steps
    for begin in range(0, len(drawn) - steps + 1, steps):
        one = [*chain(*drawn[begin : begin + steps])]
        assert set(one) == set(range(len(sides)))
        # None twice, but to give all devices as many, two at least.
        most = 3 * (2 * devices - 1)  # of three sizes
        assert len(one) <= len(sides) + most


def test_every_pass_has_every_window_about_once() -> None:
    sides = [(96, 96)] * 40 + [(128, 128)] * 24
    config = TrainConfig(items_per_epoch=64, batch_size=4)
    sampler = WindowSampler(sides, config)
    orders = []
    for epoch in range(3):
        sampler.set_epoch(epoch)
        order = [index for batch in sampler for index in batch]
        assert sorted(order) == list(range(64))
        orders.append(order)
    assert all(one != other for one, other in pairwise(orders))


def _batch(side: int = 96, batch: int = 4) -> WindowBatch:
    generator = torch.Generator().manual_seed(0)

    def images(channels: int, side: int) -> torch.Tensor:
        shape = (batch, channels, side, side)
        return torch.randint(
            0, 256, shape, dtype=torch.uint8, generator=generator
        )

    return (
        images(2, side),
        images(3, side // 4),
        images(2, side),
        torch.rand(batch, 5, generator=generator),
        torch.ones(batch, dtype=torch.bool),
        torch.tensor([[10, 200]] * batch),
    )


def _training(steps: int, **change: float) -> WindowedTraining:
    torch.manual_seed(0)
    small = {"widths": (8, 8, 8, 8), "depths": (1, 1, 1, 1)}
    config = TrainConfig(**change)  # type: ignore[arg-type]
    training = WindowedTraining(WindowedNet(small, small), config, steps)
    training.log_dict = lambda *_, **__: None  # type: ignore[method-assign]
    return training


@pytest.mark.parametrize(("share", "stay"), [(0.0, True), (1.0, False)])
def test_means_and_variances_stay_from_a_share_of_the_steps_on(
    share: float, stay: bool
) -> None:
    training = _training(10, freeze_norm=share).train()
    net = training.net
    assert isinstance(net, WindowedNet)
    before = {name: b.clone() for name, b in net.named_buffers()}
    training.training_step(_batch(), 0).backward()
    after = dict(net.named_buffers())
    same = {name for name in before if torch.equal(before[name], after[name])}
    near = {name for name in before if name.startswith("near.")}
    assert {name for name in before if name.startswith("whole.")} <= same
    assert (near <= same) == stay
    # The other part has no gradients.
    assert all(p.grad is None for p in net.whole.parameters())
    assert all(p.grad is not None for p in net.near.parameters())


def test_pixels_beyond_the_windows_are_counted() -> None:
    training = _training(10).eval()
    with torch.no_grad():
        training.validation_step(_batch(batch=3), 0)
    _, _, positives, negatives, union = training.metrics.counts.tolist()
    labels = _batch(batch=3)[2]
    inside = int((labels[:, 0] > 25.5).sum())
    assert positives == inside + 30
    assert positives + negatives == 3 * (96 * 96 + 210)
    assert union >= positives


def test_a_single_window_of_its_size_can_be_trained_on() -> None:
    sides = [(32, 32)] + [(64, 64)] * 8
    config = TrainConfig(items_per_epoch=12, batch_size=4)
    batches = [b for b in WindowSampler(sides, config) if b[0] == 0]
    assert batches == [[0, 0]]
    loss = _training(10).train().training_step(_batch(32, batch=2), 0)
    assert torch.isfinite(loss)
