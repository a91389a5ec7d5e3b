"""The controller as a system, and a whole grasp by contact of each kind."""

import numpy as np
import pytest

from tests.gripper.cells import (
    ContactCell,
    assert_brought_to_the_tote,
    block,
    controller_alone,
    make_gripper,
    take,
)
from tests.ports import ports
from xray_drake.gripper.controller import GripperController
from xray_drake.messages import GraspKind, GripperMode, Outcome, SearchAction
from xray_drake.scene.targets import target_model

BRICK = block((0.08, 0.04, 0.03), 0.1)
TARGET = target_model("box_2to1")


@pytest.fixture(scope="module")
def gripper():
    return make_gripper()


def test_ports_are_named(gripper):
    system = GripperController(gripper=gripper)
    assert ports(system) == (
        ["action", "carrier_state", "finger_state", "cup_state", "at_rest"],
        [
            "status",
            "carrier_desired_state",
            "finger_desired_state",
            "suction",
        ],
    )
    assert system.get_name() == "gripper_controller"
    # Or policy and gripper would make an algebraic loop.
    assert not system.HasAnyDirectFeedthrough()


def test_idle_it_stays_at_home(gripper):
    controller = controller_alone(gripper, SearchAction())
    status = controller.advance_to(0.2)
    assert (status.mode, status.number) == (GripperMode.IDLE, 0)
    np.testing.assert_allclose(
        controller.output("carrier_desired_state"),
        [*gripper.carrier.home, *np.zeros(6)],
        atol=1e-9,
    )
    np.testing.assert_array_equal(controller.output("finger_desired_state"), 0)
    np.testing.assert_array_equal(controller.output("suction"), [0])


def test_it_sets_out_and_tells_of_a_wrist_that_does_not_follow(gripper):
    action = take(GraspKind.JAW, "brick", (0.0, 0.0, 0.02), 0.02)
    controller = controller_alone(gripper, action)
    assert controller.output("status").mode is GripperMode.IDLE
    status = controller.advance_to(0.02)
    assert (status.mode, status.number) == (GripperMode.BUSY, 1)
    controller.advance_to(0.2)
    desired = controller.output("carrier_desired_state")
    assert desired[1] < gripper.carrier.home[1] - 0.001  # from home to the bin
    assert desired[7] < 0
    fingers = controller.output("finger_desired_state")
    assert 0.003 < fingers[0] == fingers[1]
    time = 0.2
    while (status := controller.advance_to(time)).mode is GripperMode.BUSY:
        time += 0.1
        assert time < 10.0
    assert status.outcome is Outcome.FAILED
    assert status.reason == "the wrist is stuck"


@pytest.mark.parametrize(
    ("carrier", "model", "kind", "z", "width"),
    [
        ("wrist", TARGET, GraspKind.JAW, 0.0035, 0.0212),
        ("wrist", BRICK, GraspKind.SUCTION, 0.03, 0.0),
        ("arm", TARGET, GraspKind.JAW, 0.0035, 0.0212),
    ],
)
def test_by_contact_it_brings_an_object_to_the_tote(
    carrier, model, kind, z, width
):
    cell = ContactCell(model, carrier)
    action = take(kind, model.name, (0.05, 0.02, z), width)
    way = cell.run(action, limit=20.0)
    assert (cell.status.outcome, cell.status.reason) == (Outcome.LIFTED, "")
    assert_brought_to_the_tote(way)
    assert way[-1, 2] == pytest.approx(model.extents[2] / 2, abs=2e-3)


def test_by_contact_a_miss_is_felt():
    cell = ContactCell(BRICK)
    start = cell.pose("brick")[:3, 3]
    action = take(GraspKind.JAW, "brick", (-0.1, -0.05, 0.02), 0.02)
    way = cell.run(action, limit=20.0)
    assert cell.status.outcome is Outcome.FAILED
    assert cell.status.reason == "the jaw closed on nothing"
    np.testing.assert_allclose(way[-1], start, atol=5e-4)
