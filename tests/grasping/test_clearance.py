import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.poses import at
from xray_drake.grasping.evidence.clearance import clearance

LOWER = np.array([[-0.02, -0.01, -0.01]])
UPPER = np.array([[0.02, 0.01, 0.01]])


@pytest.mark.parametrize(
    ("point", "round_", "expected"),
    [
        ((0, 0.01, 0.01), False, 0.0),
        ((0, 0.01, 0.01), True, 0.01 * (np.sqrt(2) - 1)),
        ((0.025, 0.01, 0.01), True, 0.005),
        ((0.019, 0, 0), True, -0.001),
    ],
)
def test_one_point_and_one_box(point, round_, expected):
    X_WB = at(0.1, -0.2, 0.3, 0.4, -0.5, 0.6)
    p_W = X_WB[:3, :3] @ point + X_WB[:3, 3]
    found = clearance(p_W[None], X_WB[None], LOWER, UPPER, np.array([round_]))
    assert found[0] == pytest.approx(expected, abs=1e-7)


def test_many_poses_boxes_and_points():
    rng = np.random.default_rng(0)
    n = 150
    X_WB = np.tile(np.eye(4), (n, 1, 1))
    X_WB[:, :3, :3] = Rotation.random(n, random_state=2).as_matrix()
    X_WB[:, :3, 3] = rng.normal(scale=0.1, size=(n, 3))
    points = rng.normal(scale=0.1, size=(40, 3))
    lower = rng.uniform(-0.05, 0, (n, 3, 3))
    upper = lower + rng.uniform(0.01, 0.05, (n, 3, 3))
    found = clearance(points, X_WB, lower, upper, np.zeros(3, bool))
    for i in range(n):
        p_B = (points - X_WB[i, :3, 3]) @ X_WB[i, :3, :3]
        gap = np.maximum(lower[i][:, None] - p_B, p_B - upper[i][:, None])
        assert found[i] == pytest.approx(gap.max(axis=-1).min(), abs=1e-6)


def test_nothing_is_infinitely_far():
    box = LOWER, UPPER, np.zeros(1, bool)
    assert np.isinf(clearance(np.zeros((0, 3)), np.eye(4)[None], *box)[0])
    assert clearance(np.zeros((5, 3)), np.zeros((0, 4, 4)), *box).shape == (0,)
