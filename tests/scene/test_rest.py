from itertools import product

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from xray_drake.scene.rest import RestTest, box_corners
from xray_drake.scene.targets import target_model

START = np.array([[0.0, 0.0, 0.1], [0.2, 0.0, 0.0]])


def moved(distance: float) -> np.ndarray:
    """The points, the second of which has gone sideways."""
    return START + [[0.0, 0.0, 0.0], [0.0, distance, 0.0]]


def begun() -> RestTest:
    return RestTest(motion=0.001, round_time=0.3).update(1.0, START)


def test_the_first_look_begins_a_round() -> None:
    assert (begun().at_rest, begun().since) == (False, 1.0)


@pytest.mark.parametrize(
    ("time", "distance", "at_rest"),
    [
        (1.3, 0.0, True),
        (1.3, 0.0009, True),
        (1.3, 0.0011, False),  # one point that moves too far is enough
        (1.3, np.nan, False),
        (1.3 - 1e-12, 0.0, True),  # rounding does not cost a look
        (1.29, 0.0, False),  # too early
    ],
)
def test_nothing_moves_for_a_round(
    time: float, distance: float, at_rest: bool
) -> None:
    assert begun().update(time, moved(distance)).at_rest is at_rest


def test_looks_within_a_round_change_nothing() -> None:
    test = begun()
    assert test.update(1.29, moved(0.5)) is test


def test_what_creeps_is_compared_round_by_round() -> None:
    test, results = begun(), []
    for i in range(1, 5):
        test = test.update(1.0 + 0.3 * i, moved(0.0007 * i))
        results.append(test.at_rest)
    assert results == [True] * 4  # slower than 1 mm per round, though far
    test = test.update(2.5, moved(0.01))
    assert not test.at_rest
    assert test.update(2.8, moved(0.01)).at_rest


def test_another_number_of_points_begins_a_new_round() -> None:
    test = begun().update(1.3, START)
    assert test.at_rest
    fewer = test.update(1.35, START[:1])
    assert not fewer.at_rest
    assert fewer.since == 1.35
    assert not fewer.update(1.6, START[:1]).at_rest
    assert fewer.update(1.65, START[:1]).at_rest


def test_where_there_is_nothing_all_is_at_rest() -> None:
    nothing = np.zeros((0, 3))
    assert RestTest(0.001, 0.3).update(0.1, nothing).at_rest


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_corners_of_a_bounding_box(seed: int) -> None:
    model = target_model("flute")
    X_WO = trimesh.transformations.random_rotation_matrix(
        np.random.default_rng(seed).random(3)
    )
    X_WO[:3, 3] = np.random.default_rng(seed).normal(size=3)
    back = (box_corners(model, X_WO) - X_WO[:3, 3]) @ X_WO[:3, :3]
    expected = product(*model.visual.bounds.T)
    np.testing.assert_allclose(sorted(back.round(9).tolist()), sorted(expected))
