"""The oracle: X-Ray that is told the truth."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from xray_drake.messages import InstanceMasks, OccupancyDistribution
from xray_drake.policy.beyond.oracle import oracle
from xray_drake.policy.ranking import SearchView, order

SHAPE = (12, 16)
NAMES = ("a", "b", "c", "d")


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def random_view(seed: int) -> SearchView:
    generator = rng(seed)
    return SearchView(
        OccupancyDistribution(generator.random(SHAPE)),
        InstanceMasks(generator.integers(-1, 4, SHAPE), NAMES),
        NAMES,
        true_mask=generator.random(SHAPE) < 0.2,
    )


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_it_ranks_by_overlap_with_the_true_mask(seed: int) -> None:
    view = random_view(seed)
    assert view.true_mask is not None
    ranked = order(view, oracle, rng())
    for name, score, *_ in ranked:
        overlap = view.instances.mask(name) & view.true_mask
        assert score == np.count_nonzero(overlap)
    scores = [c.score for c in ranked]
    assert scores == sorted(scores, reverse=True)


def test_the_distribution_does_not_matter() -> None:
    view = random_view(1)
    other = replace(view, occupancy=random_view(2).occupancy)
    np.testing.assert_array_equal(
        oracle(view, rng()).values, oracle(other, rng()).values
    )


def test_where_nothing_overlaps_the_nearest_is_next() -> None:
    labels = np.full(SHAPE, -1)
    labels[2, 2], labels[2, 9] = 0, 1
    mask = np.zeros(SHAPE, bool)
    mask[2, 12] = True
    view = SearchView(
        OccupancyDistribution(np.zeros(SHAPE)),
        InstanceMasks(labels, ("far", "near")),
        ("far", "near"),
        true_mask=mask,
    )
    assert [c.name for c in order(view, oracle, rng())] == ["near", "far"]


def test_it_cannot_do_without_the_truth() -> None:
    with pytest.raises(ValueError, match="true mask"):
        oracle(replace(random_view(3), true_mask=None), rng())
