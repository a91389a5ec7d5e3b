import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from xray_drake.gripper.carriers.carrier import ReachError
from xray_drake.gripper.carriers.wrist import Wrist
from xray_drake.gripper.models import JointLimits

WRIST = Wrist(
    R_FT=Rotation.from_euler("YX", [45, 180], degrees=True).as_matrix(),
    limits=JointLimits(
        lower=np.array([-0.5, -0.5, 0.0, -6.3, -np.pi / 2, -6.3]),
        upper=np.array([1.0, 0.6, 0.9, 6.3, np.pi / 2, 6.3]),
        velocity=np.ones(6),
        acceleration=np.ones(6),
        stiffness=np.ones(6),
        damping=np.ones(6),
    ),
    mass=np.ones(3),
)


@st.composite
def joints(draw: st.DrawFn) -> np.ndarray:
    turns = [draw(st.floats(-3, 3)), draw(st.floats(-np.pi / 2, np.pi / 2))]
    return np.array([0.1, -0.2, 0.3, *turns, draw(st.floats(-3, 3))])


@given(joints(), joints())
def test_joints_give_the_pose_they_are_asked_for(
    q: np.ndarray, near: np.ndarray
) -> None:
    X_WT = WRIST.pose(q)
    found = WRIST.joints(X_WT, near=near)
    np.testing.assert_allclose(WRIST.pose(found), X_WT, atol=1e-6)
    assert np.all(np.abs(found - near)[[3, 5]] <= np.pi + 1e-6)


@pytest.mark.parametrize("pitch", [-np.pi / 2, np.pi / 2])
def test_yaw_stays_where_it_says_nothing(pitch: float) -> None:
    q = np.array([0.0, 0.0, 0.5, 0.4, pitch, 0.7])
    found = WRIST.joints(WRIST.pose(q), near=np.array([0, 0, 0, 1.1, 0, 0]))
    assert found[3] == pytest.approx(1.1)
    np.testing.assert_allclose(WRIST.pose(found), WRIST.pose(q), atol=1e-9)


def test_jaw_down_and_cup_down_are_alike_in_reach() -> None:
    for pitch, axis in ((-np.pi / 4, 2), (np.pi / 4, 0)):
        X_WT = WRIST.pose(np.array([0, 0, 0.5, 0.3, pitch, 0]))
        np.testing.assert_allclose(X_WT[:3, axis], [0, 0, -1], atol=1e-12)


def test_out_of_reach_says_which_way() -> None:
    X_WT = np.eye(4)
    X_WT[:3, 3] = 2.0, 0.0, -0.1
    with pytest.raises(ReachError, match=r"reach: x, z$"):
        WRIST.joints(X_WT, near=np.zeros(6))
