from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from xray_drake.messages import (
    InstanceMasks,
    OccupancyDistribution,
    RankedCandidate,
)
from xray_drake.policy.beyond.oracle import oracle
from xray_drake.policy.ranking import (
    Ranking,
    Scores,
    SearchView,
    candidates,
    highest_first,
    largest,
    order,
    random,
    xray,
)

SHAPE = (12, 16)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def view(
    labels: np.ndarray,
    rho: np.ndarray | None = None,
    *,
    threshold: float = 0.0,
    names: tuple[str, ...] = ("a", "b", "c", "d"),
) -> SearchView:
    rho = np.zeros(np.shape(labels)) if rho is None else rho
    return SearchView(
        OccupancyDistribution(rho, support_threshold=threshold),
        InstanceMasks(labels, names),
        names,
    )


def random_view(seed: int, threshold: float) -> SearchView:
    generator = rng(seed)
    labels = generator.integers(-1, 4, SHAPE)
    rho = generator.random(SHAPE) * (generator.random(SHAPE) < 0.3)
    return view(labels, rho, threshold=threshold)


def names_of(ranked: list[RankedCandidate]) -> list[str]:
    return [c.name for c in ranked]


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.4]))
def test_xray_sums_mask_times_distribution(seed: int, threshold: float) -> None:
    seen = random_view(seed, threshold)
    expected = dict.fromkeys(seen.candidates, 0.0)
    rho = seen.occupancy.data
    for row in range(SHAPE[0]):
        for column in range(SHAPE[1]):
            label = seen.instances.labels[row, column]
            if label >= 0 and rho[row, column] > threshold:
                name = seen.instances.names[label]
                expected[name] += float(rho[row, column])
    scores = xray(seen, rng()).values[:, 0]
    np.testing.assert_allclose(scores, list(expected.values()), rtol=1e-12)
    assert names_of(order(seen, xray, rng())) == sorted(
        expected, key=lambda name: -expected[name]
    )


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_the_oracle_ranks_by_overlap_with_the_true_mask(seed: int) -> None:
    """It is X-Ray that is told the truth."""
    seen = replace(random_view(seed, 0.0), target="b")
    with pytest.raises(ValueError, match="true mask"):
        oracle(seen, rng())
    truth = rng(seed).random(SHAPE) < 0.2
    ranked = order(replace(seen, true_mask=truth), oracle, rng())
    overlaps = {
        name: np.count_nonzero(seen.instances.mask(name) & truth)
        for name in seen.candidates
    }
    assert {c.name: c.score for c in ranked} == overlaps
    assert [c.score for c in ranked] == sorted(overlaps.values(), reverse=True)
    told = replace(seen, occupancy=OccupancyDistribution(truth))
    assert ranked == order(told, xray, rng())


def test_only_the_candidates_are_scored_in_their_order() -> None:
    seen = random_view(3, 0.0)
    areas = seen.instances.areas()
    np.testing.assert_array_equal(largest(seen, rng()).values[:, 0], areas)
    for ranking in (xray, largest):
        full = ranking(seen, rng()).values
        some = replace(seen, candidates=("d", "b"))
        np.testing.assert_array_equal(ranking(some, rng()).values, full[[3, 1]])
        nobody = replace(seen, candidates=())
        assert len(ranking(nobody, rng()).values) == 0
        assert order(nobody, ranking, rng()) == []


def row_of_objects(rho: np.ndarray) -> SearchView:
    """Objects of 1, 2, 3 and 4 columns side by side, background between."""
    labels = np.full((1, 16), -1)
    labels[0, [0, *(2, 3), *(5, 6, 7), *(9, 10, 11, 12)]] = [
        *(0,),
        *(1, 1),
        *(2, 2, 2),
        *(3, 3, 3, 3),
    ]
    return view(labels, rho)


@pytest.mark.parametrize(
    ("columns", "first"),
    [
        ([4], "cbad"),  # between b and c, which touch it, and c is larger
        ([15], "dcba"),
        ([], "dcba"),  # no support: the largest
    ],
)
def test_where_all_products_are_zero_the_nearest_is_next(
    columns: list[int], first: str
) -> None:
    rho = np.zeros((1, 16))
    rho[0, columns] = 1.0
    ranked = order(row_of_objects(rho), xray, rng())
    assert names_of(ranked) == list(first)
    assert [c.score for c in ranked] == [0.0] * 4


def test_random_is_uniform_and_follows_its_generator() -> None:
    seen = random_view(6, 0.0)
    np.testing.assert_array_equal(
        random(seen, rng(1)).values, random(seen, rng(1)).values
    )
    generator = rng(2)
    first = [names_of(order(seen, random, generator))[0] for _ in range(2000)]
    for name in seen.candidates:
        assert first.count(name) / 2000 == pytest.approx(0.25, abs=0.05)


@pytest.mark.parametrize("ranking", [xray, largest])
def test_the_deterministic_rankings_draw_nothing(ranking: Ranking) -> None:
    generator = rng(3)
    before = generator.bit_generator.state
    ranking(random_view(7, 0.0), generator)
    assert generator.bit_generator.state == before


def test_later_columns_break_ties_only() -> None:
    table = {"a": (1, 9, 0), "b": (2, 0, 0), "c": (1, 9, 5), "d": (2, 1, 0)}

    def ranking(seen: SearchView, generator: np.random.Generator) -> Scores:
        values = np.array([table[name] for name in seen.candidates], float)
        return Scores(values, values[:, 1] > 0)

    ranked = order(random_view(8, 0.0), ranking, rng())
    assert [tuple(c[:3]) for c in ranked] == [
        ("d", 2.0, True),
        ("b", 2.0, False),
        ("c", 1.0, True),
        ("a", 1.0, True),
    ]


def test_what_hides_the_target() -> None:
    """For X-Ray a pixel of the distribution; the others cannot tell."""
    rho = np.zeros((1, 16))
    rho[0, [0, 2, 5, 6]] = 0.9, 1.0, 0.5, 0.5
    seen = row_of_objects(rho)
    assert xray(seen, rng()).hides.tolist() == [False, True, True, False]
    as_target = replace(seen, target="d")
    assert xray(as_target, rng()).hides.tolist() == [False, True, True, True]
    faint = replace(
        seen, occupancy=OccupancyDistribution(rho, support_threshold=0.5)
    )
    assert xray(faint, rng()).hides.tolist() == [False, True, False, False]
    for ranking in (largest, random):
        assert ranking(seen, rng()).hides.all()


def test_the_target_goes_first_with_the_score_it_has() -> None:
    seen = row_of_objects(np.zeros((1, 16)))
    ranked = order(seen, largest, rng(), target="b")
    assert [(c.name, c.score) for c in ranked] == [
        *(("b", 2.0), ("d", 4.0), ("c", 3.0), ("a", 1.0)),
    ]
    for absent in ("", "nobody"):
        ranked = order(seen, largest, rng(), target=absent)
        assert names_of(ranked) == list("dcba")
    some = replace(seen, candidates=("a", "c"))
    assert names_of(order(some, largest, rng(), target="b")) == ["c", "a"]


def test_candidates_are_seen_well_enough() -> None:
    instances = row_of_objects(np.zeros((1, 16))).instances
    assert candidates(instances, min_pixels=3) == ("c", "d")
    assert candidates(instances, min_pixels=1) == ("a", "b", "c", "d")
    assert candidates(instances, min_pixels=5) == ()


def test_distribution_and_masks_of_two_images() -> None:
    seen = random_view(9, 0.0)
    small = replace(seen, occupancy=OccupancyDistribution(np.zeros((3, 4))))
    with pytest.raises(ValueError, match=r"\(3, 4\) .* \(12, 16\): .*one im"):
        order(small, xray, rng())


def test_what_differs_by_rounding_alone_is_ranked_by_the_next_score() -> None:
    scores = np.array([[0.3, 1.0], [0.1 + 0.2, 2.0], [1e6, 0.0], [0.0, 9.0]])
    assert highest_first(scores).tolist() == [2, 1, 0, 3]
    assert highest_first(np.zeros((0, 2))).tolist() == []
