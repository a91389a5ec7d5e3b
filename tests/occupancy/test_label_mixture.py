import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from xray_drake.occupancy.geometric.label_mixture import (
    LEVELS,
    best_answer,
    label_histogram,
)

SHAPE = (9, 11)


@given(
    rasters=npst.arrays(bool, (3, 5, 5)),
    poses=st.lists(
        st.tuples(st.integers(0, 2), st.integers(-4, 8), st.integers(-4, 10)),
        min_size=1,
        max_size=12,
    ),
    cuts=st.lists(st.integers(1, 11), max_size=3),
    seed=st.integers(0, 99),
)
def test_it_is_what_labels_drawn_one_by_one_say(
    rasters: np.ndarray,
    poses: list[tuple[int, int, int]],
    cuts: list[int],
    seed: int,
) -> None:
    first = np.unique([0, *(c for c in cuts if c < len(poses)), len(poses)])
    weight = np.random.default_rng(seed).dirichlet(np.ones(len(first) - 1))
    raster, top, left = np.array(poses).T
    histogram = label_histogram(
        rasters, raster, np.stack([top, left], axis=1), first, weight, SHAPE
    )
    expected = np.zeros((*SHAPE, LEVELS + 1))
    for group, share in enumerate(weight):
        total = np.zeros(SHAPE)
        for k, i, j in poses[first[group] : first[group + 1]]:
            canvas = np.zeros((30, 30), bool)
            canvas[10 + i : 15 + i, 10 + j : 15 + j] = rasters[k]
            total += canvas[10 : 10 + SHAPE[0], 10 : 10 + SHAPE[1]]
        label = total / max(total.max(), 1)
        levels = np.floor(LEVELS * label + 0.5).astype(int)
        for pixel in np.ndindex(SHAPE):
            expected[(*pixel, levels[pixel])] += share
    np.testing.assert_allclose(histogram, expected, atol=1e-5)


def expected_gain(
    histogram: np.ndarray, answer: float, *, cost: float, slack: float
) -> float:
    """The mean over errors of an answer, one by one."""
    values = np.arange(LEVELS + 1) / LEVELS
    errors = np.linspace(-5, 5, 2001)
    chances = np.exp(-0.5 * errors**2)
    given = (answer + slack * errors)[:, None]
    close = np.abs(values - given) < 0.2
    positive = values > 0.1
    gain = (positive & close) - cost * (positive | (given > 0.1)) + 1e-3 * close
    return float(chances / chances.sum() @ gain @ histogram)


@settings(max_examples=30)
@given(
    histogram=npst.arrays(
        np.float32,
        (LEVELS + 1,),
        elements=st.floats(0, 1, width=32),
    ).filter(lambda weights: weights.sum() > 0.1),
    cost=st.floats(0, 1),
    slack=st.floats(0.003, 0.1),
)
def test_no_other_answer_is_expected_to_be_better(
    histogram: np.ndarray, cost: float, slack: float
) -> None:
    histogram = histogram / histogram.sum()
    (answer,) = best_answer(
        histogram[None, None], cost=cost, slack=slack
    ).ravel()
    gains = [
        expected_gain(histogram, level / LEVELS, cost=cost, slack=slack)
        for level in range(LEVELS + 1)
    ]
    # The errors are summed up in steps, two thousandths of them each.
    assert gains[round(LEVELS * float(answer))] >= max(gains) - 2e-3


def test_what_all_labels_agree_on_is_the_answer() -> None:
    histogram = np.zeros((1, 3, LEVELS + 1), np.float32)
    for column, level in enumerate((0, LEVELS // 2, LEVELS)):
        histogram[0, column, level] = 1.0
    answer = best_answer(histogram, cost=0.8, slack=0.05)[0]
    assert np.abs(answer - [0.0, 0.5, 1.0]).max() < 0.01
