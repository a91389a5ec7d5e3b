from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from xray_drake.gripper.carriers.carrier import ReachError
from xray_drake.gripper.carriers.paths import Leg, stay
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
def joints(draw):
    turns = [draw(st.floats(-3, 3)), draw(st.floats(-np.pi / 2, np.pi / 2))]
    return np.array([0.1, -0.2, 0.3, *turns, draw(st.floats(-3, 3))])


@given(joints(), joints())
def test_joints_give_the_pose_they_are_asked_for(q, near):
    X_WT = WRIST.pose(q)
    found = WRIST.joints(X_WT, near=near)
    np.testing.assert_allclose(WRIST.pose(found), X_WT, atol=1e-6)
    assert np.all(np.abs(found - near)[[3, 5]] <= np.pi + 1e-6)


@pytest.mark.parametrize("pitch", [-np.pi / 2, np.pi / 2])
def test_yaw_stays_where_it_says_nothing(pitch):
    q = np.array([0.0, 0.0, 0.5, 0.4, pitch, 0.7])
    found = WRIST.joints(WRIST.pose(q), near=np.array([0, 0, 0, 1.1, 0, 0]))
    assert found[3] == pytest.approx(1.1)
    np.testing.assert_allclose(WRIST.pose(found), WRIST.pose(q), atol=1e-9)


def test_out_of_reach_says_which_way():
    X_WT = np.eye(4)
    X_WT[:3, 3] = 2.0, 0.0, -0.1
    with pytest.raises(ReachError, match=r"reach: x, z$"):
        WRIST.joints(X_WT, near=np.zeros(6))


FAST = replace(
    WRIST,
    limits=replace(
        WRIST.limits,
        velocity=np.array([1.5, 1.5, 1.0, 3.0, 2.0, 3.0]),
        acceleration=np.array([4.0, 4.0, 4.0, 20.0, 10.0, 20.0]),
    ),
)

points = st.lists(st.floats(-2, 2), min_size=6, max_size=6).map(np.array)
legs = st.lists(
    st.tuples(points, st.sampled_from([0.05, 0.5, np.inf])),
    min_size=1,
    max_size=3,
).map(lambda found: [Leg(end, speed) for end, speed in found])


@settings(max_examples=50)
@given(points, legs, st.floats(0, 100))
def test_it_goes_along_its_legs_within_the_limits(start, legs, begin):
    path, end = FAST.path(start, legs, begin), legs[-1].end
    np.testing.assert_allclose(path.end, end, atol=1e-9)
    times = begin - 1.0, begin, path.end_time, path.end_time + 99.0
    for time, there in zip(times, (start, start, end, end), strict=True):
        q, v = path.sample(time)
        np.testing.assert_allclose(q, there, atol=1e-9)
        np.testing.assert_allclose(v, 0, atol=1e-6)
    bends = path.trajectory.MakeDerivative(2)
    for time in np.linspace(begin, path.end_time, 60):
        _, v = path.sample(time)
        assert np.all(np.abs(v) <= FAST.limits.velocity * (1 + 1e-6))
        assert np.linalg.norm(v[:3]) <= max(leg.speed for leg in legs) + 1e-6
        a = bends.value(time)[:, 0]
        assert np.all(np.abs(a) <= FAST.limits.acceleration * (1 + 1e-6))
    before = start
    for index, leg in enumerate(legs):
        curve = path.trajectory.segment(index)
        times = np.linspace(curve.start_time(), curve.end_time(), 9)
        way = leg.end - before
        done = np.array([curve.value(time)[:, 0] - before for time in times])
        share = done @ way / max(way @ way, 1e-12)
        np.testing.assert_allclose(done, np.outer(share, way), atol=1e-6)
        assert np.all(np.diff(share) >= -1e-9)
        before = leg.end


def test_the_limits_are_used():
    far = np.array([1.0, 0, 0, 0, 0, 0])
    path = FAST.path(np.zeros(6), [Leg(far, 0.5)], 0.0)
    assert path.end_time == pytest.approx(1.875 / 0.5)
    path = FAST.path(np.zeros(6), [Leg(0.01 * far)], 0.0)
    bend = path.trajectory.MakeDerivative(2)
    times = np.linspace(0, path.end_time, 500)
    fastest = max(abs(bend.value(t)[0, 0]) for t in times)
    assert fastest == pytest.approx(4.0, rel=0.01)


def test_it_stays_for_a_time():
    end = np.full(6, 0.1)
    path = stay(end, 1.0, 0.5)
    assert path.end_time == pytest.approx(1.5)
    np.testing.assert_allclose(path.sample(1.2)[0], end)
