import numpy as np
import pytest
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
    test = begun()
    assert not test.at_rest
    assert test.since == 1.0


@pytest.mark.parametrize(
    ("distance", "at_rest"), [(0.0, True), (0.0009, True), (0.0011, False)]
)
def test_one_point_that_moves_too_far_is_enough(
    distance: float, at_rest: bool
) -> None:
    assert begun().update(1.3, moved(distance)).at_rest is at_rest


def test_looks_within_a_round_change_nothing() -> None:
    test = begun()
    assert test.update(1.29, moved(0.5)) is test
    assert test.update(1.3, moved(0.0)).at_rest


def test_rounding_of_time_does_not_cost_a_look() -> None:
    assert begun().update(1.0 + 0.3 - 1e-12, START).at_rest


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


def test_nan_is_not_rest() -> None:
    assert not begun().update(1.3, moved(np.nan)).at_rest


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_corners_of_a_bounding_box(seed: int) -> None:
    model = target_model("flute")
    rng = np.random.default_rng(seed)
    R, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    X_WO = np.eye(4)
    X_WO[:3, :3] = R * np.sign(np.linalg.det(R))
    X_WO[:3, 3] = rng.normal(size=3)
    corners = box_corners(model, X_WO)
    back = (corners - X_WO[:3, 3]) @ X_WO[:3, :3]
    expected = {
        tuple(model.visual.bounds[[i, j, k], [0, 1, 2]].round(9))
        for i in (0, 1)
        for j in (0, 1)
        for k in (0, 1)
    }
    assert {tuple(corner.round(9)) for corner in back} == expected
