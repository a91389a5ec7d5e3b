"""The controller as a system, and a whole grasp by contact of each kind."""

import numpy as np
import pytest

from tests.gripper.cells import (
    Alone,
    ContactCell,
    block,
    downwards,
    in_tote,
    make_gripper,
)
from tests.ports import inputs_of, outputs_of
from xray_drake.gripper.controller import GripperController
from xray_drake.gripper.suction import CupState
from xray_drake.messages import (
    Grasp,
    GraspKind,
    GripperMode,
    Outcome,
    SearchAction,
)
from xray_drake.scene.plant import BIN_WALL_HEIGHT
from xray_drake.scene.targets import target_model

BRICK = block((0.08, 0.04, 0.03), 0.1)


def take(kind, name, p_WG, width):
    X_WG = downwards(*p_WG)
    return SearchAction(
        number=1, grasp=Grasp(kind, name, X_WG, X_WG, width=width)
    )


TAKE = take(GraspKind.JAW, "brick", (0.0, 0.0, 0.02), 0.02)


@pytest.fixture(scope="module")
def gripper():
    return make_gripper()


def alone(gripper, action):
    """The controller of a gripper that does not move."""
    home = gripper.carrier.home
    return Alone(
        GripperController(gripper=gripper),
        carrier_state=np.r_[home, np.zeros(len(home))],
        finger_state=np.zeros(4),
        cup_state=CupState(),
        action=action,
    )


def test_ports_are_named(gripper):
    system = GripperController(gripper=gripper)
    assert inputs_of(system) == [
        "action",
        "carrier_state",
        "finger_state",
        "cup_state",
        "at_rest",
    ]
    assert outputs_of(system) == [
        "status",
        "carrier_desired_state",
        "finger_desired_state",
        "suction",
    ]
    assert system.get_name() == "gripper_controller"
    # Or policy and gripper would make an algebraic loop.
    assert not system.HasAnyDirectFeedthrough()


def test_idle_it_stays_at_home(gripper):
    controller = alone(gripper, SearchAction())
    status = controller.advance_to(0.2)
    assert (status.mode, status.number) == (GripperMode.IDLE, 0)
    np.testing.assert_allclose(
        controller.get("carrier_desired_state"),
        [*gripper.carrier.home, *np.zeros(6)],
        atol=1e-9,
    )
    np.testing.assert_array_equal(controller.get("finger_desired_state"), 0)
    np.testing.assert_array_equal(controller.get("suction"), [0])


def test_a_command_is_taken_up_once(gripper):
    controller = alone(gripper, TAKE)
    assert controller.get("status").mode is GripperMode.IDLE
    status = controller.advance_to(0.02)
    assert (status.mode, status.number) == (GripperMode.BUSY, 1)
    controller.advance_to(0.2)
    desired = controller.get("carrier_desired_state")
    assert desired[1] < gripper.carrier.home[1] - 0.001  # from home to the bin
    assert desired[7] < 0
    fingers = controller.get("finger_desired_state")
    assert 0.003 < fingers[0] == fingers[1]


def test_a_wrist_that_does_not_follow_is_told_of(gripper):
    controller = alone(gripper, TAKE)
    time = 0.1
    while (status := controller.advance_to(time)).mode is GripperMode.BUSY:
        time += 0.1
        assert time < 10.0
    assert status.outcome is Outcome.FAILED
    assert status.reason == "the wrist is stuck"


@pytest.mark.parametrize(
    ("model", "kind", "z", "width"),
    [
        (target_model("box_2to1"), GraspKind.JAW, 0.0035, 0.0212),
        (BRICK, GraspKind.SUCTION, 0.03, 0.0),
    ],
)
def test_by_contact_it_brings_an_object_to_the_tote(model, kind, z, width):
    cell = ContactCell(model)
    action = take(kind, model.name, (0.05, 0.02, z), width)
    way = cell.run(action, limit=15.0)
    assert (cell.status.outcome, cell.status.reason) == (Outcome.LIFTED, "")
    assert in_tote(way[-1])
    assert way[-1, 2] == pytest.approx(model.extents[2] / 2, abs=2e-3)
    over = (way[:, 0] > 0.23) & (way[:, 0] < 0.29)
    assert over.any()
    assert way[over, 2].min() > BIN_WALL_HEIGHT + 0.05


def test_by_contact_a_miss_is_felt():
    cell = ContactCell(BRICK)
    start = cell.pose("brick")[:3, 3]
    action = take(GraspKind.JAW, "brick", (-0.1, -0.05, 0.02), 0.02)
    way = cell.run(action, limit=20.0)
    assert cell.status.outcome is Outcome.FAILED
    assert cell.status.reason == "the jaw closed on nothing"
    np.testing.assert_allclose(way[-1], start, atol=5e-4)
