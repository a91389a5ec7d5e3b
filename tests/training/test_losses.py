import dataclasses

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from torch import Tensor

from xray_drake.occupancy.metrics import PixelCounts
from xray_drake.occupancy.metrics import pixel_counts as reference
from xray_drake.training.losses import (
    OccupancyMetrics,
    posterior_loss,
    robust_loss,
)

SHAPE = (3, 8, 10)


def random(seed: int) -> Tensor:
    return torch.rand(SHAPE, generator=torch.Generator().manual_seed(seed))


def mask(seed: int = 0) -> Tensor:
    return (random(seed) < 0.2).float()


def sure(label: Tensor) -> Tensor:
    """The logits of a label of zeros and ones."""
    return 40 * label - 20


def test_a_perfect_answer_has_no_loss() -> None:
    label, real = mask(), torch.ones(3, dtype=torch.bool)
    for each in (label, torch.zeros(SHAPE)):
        assert robust_loss(sure(each), each) < 1e-6
    assert posterior_loss(sure(label), label, real) < 1e-6


@pytest.mark.parametrize("miss_weight", [0.0, 1.0])
def test_no_answer_is_better_than_the_label(miss_weight: float) -> None:
    def loss(logits: Tensor) -> Tensor:
        return robust_loss(logits, label, miss_weight=miss_weight)

    label = random(3) * 0.9 + 0.05
    logits = torch.logit(label)
    least = loss(logits)
    for seed in range(5):
        other = logits + 0.3 * (random(seed) - 0.5)
        assert loss(other) > least
    logits = logits.clone().requires_grad_()
    loss(logits).backward()
    assert logits.grad is not None
    assert logits.grad.abs().max() < 1e-6


def test_misses_ask_for_one_of_two_answers_not_for_one_between() -> None:
    # Either is as likely as the other; the metrics count 0.5 as two misses.
    one = torch.tensor([0.2, 0.8]).repeat(8, 4)
    labels = torch.stack([one, 1 - one])

    def best(miss_weight: float) -> float:
        losses = {}
        for share in (0.0, 0.25, 0.5):
            answer = torch.lerp(one, 1 - one, share).expand(2, 8, 8)
            losses[share] = robust_loss(
                torch.logit(answer),
                labels,
                entropy_weight=0.1,
                miss_weight=miss_weight,
            )
        return min(losses, key=losses.__getitem__)

    assert best(0.0) == 0.5
    assert best(1.0) == 0.0


@given(wrong=st.integers(1, 40), right=st.integers(0, 200))
@settings(deadline=None, max_examples=30)
def test_more_wrong_pixels_are_worse(wrong: int, right: int) -> None:
    """In any image of a batch."""
    label = mask()
    off = torch.zeros(label.numel())
    off[:right] = 1

    def loss(flipped: Tensor) -> Tensor:
        answer = (label - flipped.view(SHAPE)).abs()
        return robust_loss(sure(answer), label)

    fewer = loss(off)
    off[right : right + wrong] = 1
    assert loss(off) > fewer


def test_missing_a_small_label_costs_more_than_its_share_of_pixels() -> None:
    small, large = torch.zeros(2, 1, 64, 64)
    small[0, :4, :4] = 1
    large[0, :, :] = 1
    empty = sure(torch.zeros(1, 64, 64))
    ratio = robust_loss(empty, large) / robust_loss(empty, small)
    assert 1 < ratio < 100  # of 256 times as many pixels


@given(
    real=st.lists(st.booleans(), min_size=3, max_size=3),
    seed=st.integers(0, 99),
)
@settings(deadline=None, max_examples=30)
def test_the_posterior_learns_nothing_from_virtual_targets(
    real: list[bool], seed: int
) -> None:
    amodal = mask(seed)
    chosen = torch.tensor(real)
    logits = (4 * random(seed) - 2).requires_grad_()
    loss = posterior_loss(logits, amodal, chosen)
    loss.backward()
    assert logits.grad is not None
    moved = logits.grad.abs().amax(dim=(1, 2)) > 0
    assert moved.tolist() == real
    other = torch.where(chosen[:, None, None], amodal, 1 - amodal)
    assert posterior_loss(logits, other, chosen) == loss
    if any(real):
        alone = posterior_loss(
            logits[chosen], amodal[chosen], torch.ones(sum(real)).bool()
        )
        assert alone.item() == pytest.approx(loss.item(), rel=1e-5)
    else:
        assert loss == 0


@pytest.mark.parametrize("probability", [0.02, 0.3, 0.9])
def test_the_posterior_is_least_at_the_true_probability(
    probability: float,
) -> None:
    generator = torch.Generator().manual_seed(0)
    amodal = (torch.rand(4, 50, 50, generator=generator) < probability).float()
    share = amodal.mean()
    real = torch.ones(4, dtype=torch.bool)

    def loss(value: Tensor) -> float:
        logits = torch.logit(value).expand(amodal.shape)
        return posterior_loss(logits, amodal, real).item()

    assert loss(share) < loss(share * 0.8)
    assert loss(share) < loss(1 - (1 - share) * 0.8)


# Odd multiples of 1/1024: no value is 0.1, no two differ by 0.2.
_images = arrays(
    np.float32,
    SHAPE,
    elements=st.integers(0, 511).map(lambda i: (2 * i + 1) / 1024),
)


@given(output=_images, label=_images, exact=st.booleans())
@example(np.zeros(SHAPE), np.zeros(SHAPE), False)
@example(np.ones(SHAPE), np.ones(SHAPE), False)
@settings(deadline=None, max_examples=25)
def test_pixels_are_counted_as_the_evaluation_does(
    output: np.ndarray, label: np.ndarray, exact: bool
) -> None:
    """What is not defined is NaN."""
    if exact:
        output = label
    metrics = OccupancyMetrics()
    for g, p in zip(label, output, strict=True):
        metrics.update(torch.from_numpy(p)[None], torch.from_numpy(g)[None])
    expected = sum(map(reference, label, output), PixelCounts())
    assert metrics.counts.tolist() == list(dataclasses.astuple(expected))
    told = metrics.compute()
    assert set(told) == {"balanced_accuracy", "iou"}
    for name, value in told.items():
        assert value == pytest.approx(getattr(expected, name), nan_ok=True)
    metrics.reset()
    assert not metrics.counts.any()
