"""The arm's joint positions and paths, and the gripper on it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.gripper.cells import (
    controller_alone,
    make_gripper,
    take,
)
from tests.nominal import TOTE
from tests.poses import at, downwards
from xray_drake.gripper.carriers.arm import Arm
from xray_drake.gripper.carriers.arm_cell import YUMI_ARM
from xray_drake.gripper.carriers.carrier import ReachError, Tracking
from xray_drake.gripper.carriers.paths import Leg
from xray_drake.messages import GraspKind


@pytest.fixture(scope="module")
def gripper():
    return make_gripper("arm")


@pytest.fixture(scope="module")
def arm():
    return Arm()


def grasps(number):
    """Poses of the tool over the middle of the bin."""
    rng = np.random.default_rng(3)
    low, high = [-0.15, -0.1, 0.13, -3.0], [0.1, 0.1, 0.18, 3.0]
    return [downwards(*rng.uniform(low, high)) for _ in range(number)]


LOW = grasps(1)[0]


def higher(X_WT, by=0.2):
    return at(0, 0, by) @ X_WT


@pytest.mark.parametrize("X_WT", grasps(6))
def test_it_lifts_straight_up_from_a_pose_asked_for(arm, X_WT):
    low, high = arm.along([X_WT, higher(X_WT)], near=arm.home)
    np.testing.assert_allclose(arm.pose(low), X_WT, atol=1e-6)
    np.testing.assert_allclose(arm.pose(high), higher(X_WT), atol=1e-6)
    assert np.all((arm.limits.lower <= low) & (low <= arm.limits.upper))
    assert arm.cell.is_clear(low)
    path = arm.path(low, [Leg(high, 0.3)], 2.0)
    np.testing.assert_allclose(path.end, high, atol=1e-9)
    heights = []
    for time in np.linspace(2.0, path.end_time, 80):
        X = arm.pose(path.sample(time)[0])
        np.testing.assert_allclose(X[:2, 3], X_WT[:2, 3], atol=5e-4)
        turn = Rotation.from_matrix(X[:3, :3].T @ X_WT[:3, :3]).magnitude()
        assert turn < np.deg2rad(0.2)
        heights.append(X[2, 3])
    assert np.all(np.diff(heights) > -1e-6)


def test_paths_keep_the_limits_and_do_not_jump(arm):
    low, high = arm.along([LOW, higher(LOW)], near=arm.home)
    legs = [
        Leg(high, 0.8, free=True),
        Leg(low, 0.15),
        Leg(high, 0.3),
        Leg(arm.home, 0.8, free=True),
    ]
    path = arm.path(arm.home, legs, 0.0, acceleration=4.0)
    times = np.arange(0, path.end_time, 0.01)
    q, v = (np.array(x) for x in zip(*map(path.sample, times), strict=True))
    a = np.array([path.acceleration(time) for time in times])
    assert np.all(np.abs(v) <= arm.limits.velocity)
    assert np.all(np.abs(a) <= arm.limits.acceleration)
    assert np.all((arm.limits.lower <= q) & (q <= arm.limits.upper))
    # Positions and velocities belong together, from leg to leg, too.
    way = 0.01 * (v[1:] + v[:-1]) / 2
    np.testing.assert_allclose(np.diff(q, axis=0), way, atol=5e-4)
    tool = np.array([arm.pose(position)[:3, 3] for position in q])
    speed = np.linalg.norm(np.diff(tool, axis=0), axis=1) / 0.01
    assert speed.max() <= 0.8
    bend = np.linalg.norm(np.diff(tool, 2, axis=0), axis=1) / 0.01**2
    assert bend.max() <= 1.05 * 4.0
    for time in (0.0, path.end_time):
        np.testing.assert_allclose(path.sample(time)[1], 0, atol=1e-6)
    assert all(map(arm.cell.is_clear, q[::10]))


def test_it_carries_level_and_round_its_base(arm):
    _, high = arm.along([LOW, higher(LOW)], near=arm.home)
    place = np.array(TOTE.position[:2])
    there = arm.over(high, np.array([0, 0, 0.1142]), place, lowest=0.15)
    np.testing.assert_allclose(arm.pose(there)[:2, 3], place, atol=1e-6)
    path = arm.path(high, [Leg(there, 0.8, free=True)], 0.0)
    for time in np.linspace(0, path.end_time, 40):
        X = arm.pose(path.sample(time)[0])
        assert X[2, 2] < -np.cos(np.deg2rad(1.0))
        assert X[2, 3] == pytest.approx(arm.pose(high)[2, 3], abs=2e-3)
        assert np.linalg.norm(X[:2, 3] - YUMI_ARM.X_WA[:2, 3]) > 0.1


def test_out_of_reach_is_said_in_a_line(arm):
    with pytest.raises(ReachError, match=r"^out of the arm's reach: tool at"):
        arm.along([downwards(-0.6, 0.0, 0.2)], near=arm.home)
    with pytest.raises(ReachError, match="straight on from the tool at"):
        arm.along([LOW, higher(LOW, 0.8)], near=arm.home)
    with pytest.raises(ReachError, match=r"carry it over \(2\.00, 0\.00\) m"):
        arm.over(
            arm.home, np.zeros(3), np.array([2.0, 0.0]), lowest=arm.highest
        )


def test_it_goes_as_high_as_it_can(arm):
    q = arm.at_height(arm.home, 0.25)
    assert arm.pose(q)[2, 3] == pytest.approx(0.25)
    assert arm.pose(arm.at_height(q, 2.0))[2, 3] < 1.5


def test_force_is_without_what_accelerates_the_arm(arm):
    q = arm.along([LOW], near=arm.home)[0]
    press = np.array([0.0, 0.0, -5.0])
    torque = arm.cell.jacobian(q)[3:].T @ press
    acceleration = np.full(7, 0.7)
    v = np.full(7, 0.5)
    held = torque + arm.cell.inertial_torque(q, v, acceleration)
    desired = q + held / arm.limits.stiffness
    tracking = Tracking(q, v, desired, v, acceleration)
    np.testing.assert_allclose(arm.force(tracking), press, atol=1e-6)


def test_two_contexts_of_one_controller_take_turns(gripper):
    """Their ways are found with one model of the arm."""
    actions = [
        take(GraspKind.JAW, "brick", (x, y, 0.02), 0.02)
        for x, y in ((0.05, 0.02), (-0.05, -0.04))
    ]

    def desired(controller, time):
        controller.advance_to(time)
        return np.array(controller.output("carrier_desired_state"))

    # Without an arm that follows it aborts soon, and finds its way home.
    times = 0.1 * np.arange(1, 8)
    singly = []
    for action in actions:
        controller = controller_alone(gripper, action)
        singly.append([desired(controller, time) for time in times])
    both = [controller_alone(gripper, action) for action in actions]
    turns = [[desired(one, time) for one in both] for time in times]
    np.testing.assert_array_equal(np.swapaxes(turns, 0, 1), singly)
    assert not np.array_equal(singly[0], singly[1])
