from itertools import chain, pairwise

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.training.making import SMALL, shard_of
from xray_drake.occupancy.learned.windowed import WindowedNet
from xray_drake.training.config import TrainConfig
from xray_drake.training.data import PreparedItems
from xray_drake.training.items import Item
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
    names = [
        "lid" if i % 2 == 0 else "virtual_box" for i in range(len(corners))
    ]
    shard = shard_of(
        [_item(corner, rng) for corner in corners],
        np.tile(FEATURES, (len(corners), 1)),
        names,
        [False] * len(corners),
    )
    return PreparedItems([shard], held_out=False)


def test_windows_are_of_what_is_seen() -> None:
    items = _items((98, 121), None, (3, 250), None, (82, 93))
    windows = WindowItems(items)
    assert len(windows) == windows.num_real == 3
    assert windows.sides == [(64, 64)] * 3
    places = {0: (68, 92), 2: (0, 192), 4: (52, 64)}
    for i, (index, (top, left)) in enumerate(places.items()):
        fine, coarse, labels, size, real, outside = windows[i]
        all_fine, all_coarse, all_labels, told, _ = items[index]
        assert bool(real)
        torch.testing.assert_close(size, told)
        # All of what is seen, in the middle unless the image ends.
        assert fine[1].sum() == all_fine[1].sum()
        part = slice(top, top + 64), slice(left, left + 64)
        assert torch.equal(fine, all_fine[:, *part])
        assert torch.equal(labels, all_labels[:, *part])
        quarter = [slice(s.start // 4, s.stop // 4) for s in part]
        assert torch.equal(coarse, all_coarse[:, *quarter])
        inside = int((labels[0] > 25.5).sum())
        assert outside[0] + inside == (all_labels[0] > 25.5).sum()
        assert outside.sum() == SHAPE[0] * SHAPE[1] - 64 * 64


_sides = st.lists(
    st.sampled_from([(96, 96), (128, 128), (192, 256)]),
    min_size=3,
    max_size=40,
)


def _epoch(
    sides: list[tuple[int, int]], config: TrainConfig, devices: int, epoch: int
) -> list[tuple[list[int], ...]]:
    """Returns the batches of each step, one of each device."""
    ranks = []
    for rank in range(devices):
        sampler = WindowSampler(sides, config, rank=rank, devices=devices)
        sampler.set_epoch(epoch)
        ranks.append(list(sampler))
        assert len(ranks[-1]) == len(sampler)
        assert ranks[-1] == list(sampler)
    return list(zip(*ranks, strict=True))


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
    steps = _epoch(sides, config, devices, epoch)
    assert len(steps) == 8 // devices
    for together in steps:
        assert all(len(batch) == 2 for batch in together)
        assert len({sides[index] for index in chain(*together)}) == 1


@settings(deadline=None, max_examples=30)
@given(sides=_sides, devices=st.integers(1, 3), seed=st.integers(0, 3))
def test_a_pass_has_windows_of_rare_sizes_as_well(
    sides: list[tuple[int, int]], devices: int, seed: int
) -> None:
    """Epochs end anywhere in a pass."""
    config = TrainConfig(items_per_epoch=16, batch_size=4, seed=seed)
    drawn = [
        [*chain(*together)]  # of a step, on all devices
        for epoch in range(12)
        for together in _epoch(sides, config, devices, epoch)
    ]
    steps = WindowSampler(sides, config, devices=devices).steps_per_pass
    assert len(drawn) >= steps
    passes = []
    for begin in range(0, len(drawn) - steps + 1, steps):
        one = [*chain(*drawn[begin : begin + steps])]
        passes.append(one)
        assert set(one) == set(range(len(sides)))
        # None twice, but to give all devices as many, two at least.
        most = 3 * (2 * devices - 1)  # of three sizes
        assert len(one) <= len(sides) + most
    if len(sides) > 20:
        assert all(one != other for one, other in pairwise(passes))


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
    config = TrainConfig(**change)  # type: ignore[arg-type]
    training = WindowedTraining(WindowedNet(SMALL, SMALL), config, steps)
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
