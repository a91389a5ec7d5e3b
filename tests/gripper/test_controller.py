"""The controller as a system, and a whole grasp by contact of each kind."""

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from tests.ports import inputs_of, outputs_of
from xray_drake.gripper.controller import GripperController
from xray_drake.gripper.grip_surfaces import add_grip_surfaces
from xray_drake.gripper.suction import CupState
from xray_drake.gripper.suction_cup import SuctionCup
from xray_drake.gripper.yumi import YumiGripper, add_gripper
from xray_drake.messages import (
    Grasp,
    GraspKind,
    GripperMode,
    GripperStatus,
    Outcome,
    SearchAction,
)
from xray_drake.scene.object_model import ObjectModel, object_from_pieces
from xray_drake.scene.plant import (
    BIN_WALL_HEIGHT,
    TOTE_POSITION,
    add_bin,
    add_object,
    add_plant,
    default_plant_config,
)
from xray_drake.scene.shapes import box
from xray_drake.scene.targets import target_model


def take(
    kind: GraspKind, name: str, p_WG: tuple[float, float, float], width: float
) -> SearchAction:
    X_WG = np.diag([1.0, -1.0, -1.0, 1.0])
    X_WG[:3, 3] = p_WG
    return SearchAction(
        number=1, grasp=Grasp(kind, name, X_WG, X_WG, width=width)
    )


@pytest.fixture(scope="module")
def gripper() -> YumiGripper:
    plant = MultibodyPlant(0.005)
    gripper = add_gripper(plant)
    plant.Finalize()
    return gripper


class Alone:
    """The controller with fixed inputs: a gripper that does not move."""

    def __init__(self, gripper: YumiGripper) -> None:
        self.system = GripperController(gripper=gripper)
        self.simulator = Simulator(self.system)
        self.context = self.simulator.get_mutable_context()
        state = np.concatenate([gripper.carrier.home, np.zeros(6)])
        self.system.GetInputPort("carrier_state").FixValue(self.context, state)
        self.system.GetInputPort("finger_state").FixValue(
            self.context, np.zeros(4)
        )
        self.fix("cup_state", CupState())
        self.fix("action", SearchAction())

    def fix(self, port: str, value: object) -> None:
        self.system.GetInputPort(port).FixValue(
            self.context, AbstractValue.Make(value)
        )

    def advance_to(self, time: float) -> GripperStatus:
        self.simulator.AdvanceTo(time)
        self.simulator.AdvancePendingEvents()
        return self.get("status")

    def get(self, port: str) -> object:
        return self.system.GetOutputPort(port).Eval(self.context)


def test_ports_are_named(gripper: YumiGripper) -> None:
    system = Alone(gripper).system
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


def test_its_outputs_read_state_alone(gripper: YumiGripper) -> None:
    """Or policy and gripper would make an algebraic loop."""
    system = Alone(gripper).system
    assert not system.HasAnyDirectFeedthrough()


def test_idle_it_stays_at_home(gripper: YumiGripper) -> None:
    controller = Alone(gripper)
    status = controller.advance_to(0.2)
    assert (status.mode, status.number) == (GripperMode.IDLE, 0)
    np.testing.assert_allclose(
        controller.get("carrier_desired_state"),
        [*gripper.carrier.home, *np.zeros(6)],
        atol=1e-9,
    )
    np.testing.assert_array_equal(controller.get("finger_desired_state"), 0)
    np.testing.assert_array_equal(controller.get("suction"), [0])


def test_a_command_is_taken_up_once(gripper: YumiGripper) -> None:
    controller = Alone(gripper)
    action = take(GraspKind.JAW, "brick", (0.0, 0.0, 0.02), 0.02)
    controller.fix("action", action)
    assert controller.get("status").mode is GripperMode.IDLE
    status = controller.advance_to(0.02)
    assert (status.mode, status.number) == (GripperMode.BUSY, 1)
    controller.advance_to(0.2)
    desired = controller.get("carrier_desired_state")
    assert desired[1] < gripper.carrier.home[1] - 0.001  # from home to the bin
    assert desired[7] < 0
    fingers = controller.get("finger_desired_state")
    assert 0.003 < fingers[0] == fingers[1]


def test_a_wrist_that_does_not_follow_is_told_of(gripper: YumiGripper) -> None:
    controller = Alone(gripper)
    action = take(GraspKind.JAW, "brick", (0.0, 0.0, 0.02), 0.02)
    controller.fix("action", action)
    time = 0.0
    while True:
        time += 0.1
        status = controller.advance_to(time)
        if status.mode is GripperMode.IDLE:
            break
        assert time < 10.0
    assert status.outcome is Outcome.FAILED
    assert status.reason == "the wrist is stuck"


class Cell:
    """Gripper, cup and controller on a plant with one object."""

    def __init__(self, model: ObjectModel, carrier: str = "wrist") -> None:
        builder = DiagramBuilder()
        plant, scene_graph = add_plant(builder, default_plant_config())
        add_bin(plant, with_tote=True)
        gripper = add_gripper(plant, carrier=carrier)
        self.item = add_object(plant, model)
        height = model.extents[2] / 2
        self.item.joint.SetDefaultPose(RigidTransform([0.05, 0.02, height]))
        add_grip_surfaces(plant, scene_graph, gripper, [self.item])
        plant.Finalize()
        cup = builder.AddSystem(
            SuctionCup(
                objects=[model],
                bodies={model.name: int(self.item.body.index())},
                gripper=int(gripper.base.index()),
                X_BC=gripper.X_BC,
            )
        )
        self.controller = builder.AddSystem(GripperController(gripper=gripper))
        arm, hand = gripper.carrier_instance, gripper.finger_instance
        desired = plant.get_desired_state_input_port
        state = plant.get_state_output_port
        get, take_in = (
            self.controller.GetOutputPort,
            self.controller.GetInputPort,
        )
        for source, target in (
            (
                plant.get_body_poses_output_port(),
                cup.GetInputPort("body_poses"),
            ),
            (
                plant.get_body_spatial_velocities_output_port(),
                cup.GetInputPort("body_spatial_velocities"),
            ),
            (
                cup.GetOutputPort("applied_spatial_force"),
                plant.get_applied_spatial_force_input_port(),
            ),
            (cup.GetOutputPort("state"), take_in("cup_state")),
            (get("suction"), cup.GetInputPort("suction")),
            (state(arm), take_in("carrier_state")),
            (state(hand), take_in("finger_state")),
            (get("carrier_desired_state"), desired(arm)),
            (get("finger_desired_state"), desired(hand)),
        ):
            builder.Connect(source, target)
        builder.ExportInput(take_in("action"), "action")
        self.plant = plant
        self.diagram: Diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        self.context: Context = self.simulator.get_mutable_context()

    @property
    def position(self) -> np.ndarray:
        context = self.plant.GetMyContextFromRoot(self.context)
        pose = self.plant.EvalBodyPoseInWorld(context, self.item.body)
        return np.array(pose.translation())

    def run(self, action: SearchAction) -> tuple[GripperStatus, np.ndarray]:
        """Runs an action to its end; returns the object's way, (n, 3)."""
        self.diagram.GetInputPort("action").FixValue(
            self.context, AbstractValue.Make(action)
        )
        way = []
        while True:
            self.simulator.AdvanceTo(self.context.get_time() + 0.05)
            way.append(self.position)
            status: GripperStatus = self.controller.GetOutputPort(
                "status"
            ).Eval(self.controller.GetMyContextFromRoot(self.context))
            if status.mode is GripperMode.IDLE:
                return status, np.array(way)
            assert self.context.get_time() < 20.0


def brick(mass: float = 0.1) -> ObjectModel:
    size = (0.08, 0.04, 0.03)
    return object_from_pieces(
        "brick", list(box(*size).surfaces), density=mass / np.prod(size)
    )


@pytest.mark.parametrize(
    ("model", "kind", "z", "width"),
    [
        (target_model("box_2to1"), GraspKind.JAW, 0.0035, 0.0212),
        (brick(), GraspKind.SUCTION, 0.03, 0.0),
    ],
)
def test_by_contact_it_brings_an_object_to_the_tote(
    model: ObjectModel, kind: GraspKind, z: float, width: float
) -> None:
    cell = Cell(model)
    status, way = cell.run(take(kind, model.name, (0.05, 0.02, z), width))
    assert (status.outcome, status.reason) == (Outcome.LIFTED, "")
    assert cell.context.get_time() < 15.0
    away = np.abs(way[-1, :2] - TOTE_POSITION[:2])
    assert np.all(away < 0.18)
    assert way[-1, 2] == pytest.approx(model.extents[2] / 2, abs=2e-3)
    over = (way[:, 0] > 0.23) & (way[:, 0] < 0.29)
    assert over.any()
    assert way[over, 2].min() > BIN_WALL_HEIGHT + 0.05


def test_by_contact_a_miss_is_felt() -> None:
    cell = Cell(brick())
    start = cell.position
    status, way = cell.run(
        take(GraspKind.JAW, "brick", (-0.1, -0.05, 0.02), 0.02)
    )
    assert status.outcome is Outcome.FAILED
    assert status.reason == "the jaw closed on nothing"
    np.testing.assert_allclose(way[-1], start, atol=5e-4)
