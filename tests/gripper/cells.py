"""What the gripper's tests share: systems with fixed inputs, and a bin."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from tests.alone import Alone
from tests.nominal import BIN, CELL, TOTE
from tests.poses import at, downwards
from xray_drake.cell.cameras import nominal_camera
from xray_drake.gripper.controller import GripperController
from xray_drake.gripper.grip_surfaces import add_grip_surfaces
from xray_drake.gripper.mounted import add_gripper
from xray_drake.gripper.suction import CupState
from xray_drake.gripper.suction_cup import SuctionCup
from xray_drake.messages import Grasp, GraspKind, GripperMode, SearchAction
from xray_drake.scene.cameras import add_camera
from xray_drake.scene.object_model import object_from_pieces
from xray_drake.scene.plant import (
    add_cell,
    add_objects,
    add_plant,
    default_plant_config,
)
from xray_drake.scene.shapes import box

STEP = 0.005
"""Of the plant, s."""


def block(size, mass, name="brick"):
    """A box of this size, m, and mass, kg."""
    return object_from_pieces(
        name, list(box(*size).surfaces), density=mass / float(np.prod(size))
    )


def take(kind, name, p_WG, width=0.0, number=1):
    """An action: grasp an object from above at a point."""
    X_WG = downwards(*p_WG)
    grasp = Grasp(kind, name, X_WG, X_WG, width)
    return SearchAction(number=number, grasp=grasp)


def take_brick(kind=GraspKind.JAW, number=1, z=0.02):
    width = 0.03 if kind is GraspKind.JAW else 0.0
    return take(kind, "brick", (0.05, -0.03, z), width, number)


def make_gripper(carrier="wrist"):
    """The gripper in a plant of its own."""
    plant = MultibodyPlant(STEP)
    gripper = add_gripper(plant, carrier=carrier)
    plant.Finalize()
    return gripper


def controller_alone(gripper, action):
    """The controller of a gripper that does not move."""
    return Alone(
        GripperController(gripper=gripper),
        carrier_state=np.r_[gripper.carrier.home, 0 * gripper.carrier.home],
        finger_state=np.zeros(4),
        cup_state=CupState(),
        action=action,
    )


class BinCell:
    """A bin, a tote, objects, and the gripper on a carrier, if there is one.

    Objects lie at (0.05, 0.02) m, or where ``poses`` says. Subclasses add to
    ``builder``, and then :meth:`build`.
    """

    def __init__(self, *models, poses=None, carrier="", **config):
        self.builder = DiagramBuilder()
        plant_config = default_plant_config()
        for name, value in config.items():
            setattr(plant_config, name, value)
        self.plant, self.scene_graph = add_plant(self.builder, plant_config)
        add_cell(self.plant, CELL)
        items = add_objects(self.plant, models)
        for item in items:
            X_WO = at(0.05, 0.02, item.model.extents[2] / 2)
            X_WO = (poses or {}).get(item.name, X_WO)
            item.joint.SetDefaultPose(RigidTransform(X_WO))
        self.items = {item.name: item for item in items}
        self.bodies = {item.name: int(item.body.index()) for item in items}
        if carrier:
            self.gripper = add_gripper(self.plant, carrier=carrier)
            add_grip_surfaces(self.plant, self.scene_graph, self.gripper, items)
        self.plant.Finalize()

    def connect(self, system):
        """Connects what looks at bodies and pulls at them to the plant."""
        builder, plant = self.builder, self.plant
        for name in ("body_poses", "body_spatial_velocities"):
            source = plant.GetOutputPort(name)
            builder.Connect(source, system.GetInputPort(name))
        builder.Connect(
            system.GetOutputPort("applied_spatial_force"),
            plant.get_applied_spatial_force_input_port(),
        )

    def add_cup(self):
        cup = self.builder.AddSystem(
            SuctionCup(
                objects=[item.model for item in self.items.values()],
                bodies=self.bodies,
                gripper=int(self.gripper.base.index()),
                X_BC=self.gripper.X_BC,
            )
        )
        self.connect(cup)
        return cup

    def build(self):
        self.diagram = self.builder.Build()
        self.simulator = Simulator(self.diagram)
        self.context = self.simulator.get_mutable_context()

    def fix(self, **inputs):
        for port, value in inputs.items():
            plain = isinstance(value, np.ndarray)
            self.diagram.GetInputPort(port).FixValue(
                self.context, value if plain else AbstractValue.Make(value)
            )

    def advance(self, time):
        self.simulator.AdvanceTo(self.context.get_time() + time)

    @property
    def plant_context(self):
        return self.plant.GetMyMutableContextFromRoot(self.context)

    def pose(self, name):
        body = self.items[name].body
        return body.EvalPoseInWorld(self.plant_context).GetAsMatrix4()

    def height(self, name):
        return float(self.pose(name)[2, 3])


class TransferCell(BinCell):
    """A cell in which a system moves objects; see :meth:`build`."""

    def build(self, system):
        self.system = system
        self.builder.ExportInput(system.GetInputPort("action"), "action")
        super().build()

    @property
    def status(self):
        return self.system.GetOutputPort("status").Eval(
            self.system.GetMyContextFromRoot(self.context)
        )

    def run(self, action, limit=8.0):
        """Runs an action to its end; returns the object's way, (n, 3)."""
        self.fix(action=action)
        way = []
        end = self.context.get_time() + limit
        while True:
            self.advance(0.05)
            way.append(self.pose(action.grasp.object)[:3, 3])
            done = self.status.mode is GripperMode.IDLE
            if done and self.status.number == action.number:
                return np.array(way)
            assert self.context.get_time() < end


def assert_brought_to_the_tote(way):
    """It lies there, and over the walls it was 5 cm clear of them."""
    assert TOTE.holds(way[-1])
    over = (way[:, 0] > 0.23) & (way[:, 0] < 0.29)
    assert over.any()
    assert way[over, 2].min() > BIN.wall_height + 0.05


class ContactCell(TransferCell):
    """Gripper, cup and controller on a plant with one object."""

    def __init__(self, model, carrier="wrist"):
        super().__init__(model, carrier=carrier)
        gripper, connect = self.gripper, self.builder.Connect
        cup = self.add_cup()
        controller = self.builder.AddSystem(GripperController(gripper=gripper))
        for name, instance in (
            ("carrier", gripper.carrier_instance),
            ("finger", gripper.finger_instance),
        ):
            connect(
                self.plant.get_state_output_port(instance),
                controller.GetInputPort(f"{name}_state"),
            )
            connect(
                controller.GetOutputPort(f"{name}_desired_state"),
                self.plant.get_desired_state_input_port(instance),
            )
        for source, output, drain, name in (
            (cup, "state", controller, "cup_state"),
            (controller, "suction", cup, "suction"),
        ):
            connect(source.GetOutputPort(output), drain.GetInputPort(name))
        self.build(controller)


class DrivenCell(BinCell):
    """The gripper over the bin, its desired state given by hand.

    Inputs are ``wrist``, ``fingers`` and ``force``, or, with a cup,
    ``suction``; with a camera there is an output ``label``.
    """

    def __init__(
        self, *models, cup=False, camera=False, carrier="wrist", **config
    ):
        super().__init__(*models, carrier=carrier, **config)
        builder, plant, gripper = self.builder, self.plant, self.gripper
        for name, instance in (
            ("wrist", gripper.carrier_instance),
            ("fingers", gripper.finger_instance),
        ):
            desired = plant.get_desired_state_input_port(instance)
            effort = plant.get_net_actuation_output_port(instance)
            builder.ExportInput(desired, name)
            builder.ExportOutput(effort, f"{name}_effort")
        if camera:
            sensor, _ = add_camera(builder, self.scene_graph, nominal_camera())
            builder.ExportOutput(sensor.label_image_output_port(), "label")
        if cup:
            self.cup = self.add_cup()
            builder.ExportInput(self.cup.GetInputPort("suction"), "suction")
        else:
            builder.ExportInput(
                plant.get_applied_spatial_force_input_port(), "force"
            )
        self.build()
        self.want(gripper.carrier.home)
        self.fix(fingers=np.zeros(4))

    def want(self, q, v=None):
        """Sets the wrist's desired state."""
        self.q = q
        self.fix(wrist=np.r_[q, np.zeros(len(q)) if v is None else v])

    def at(self, X_WG, X_BG=None):
        """Puts a frame of the gripper, by default the jaw, at a pose."""
        gripper, carrier = self.gripper, self.gripper.carrier
        X_GB = np.linalg.inv(gripper.X_BJ if X_BG is None else X_BG)
        self.want(carrier.along([X_WG @ X_GB], near=carrier.home)[0])
        self.plant.SetPositions(
            self.plant_context, gripper.carrier_instance, self.q
        )

    def move(self, way, duration):
        """Moves the wrist's joints, smoothly, and waits a moment."""
        start, begin = self.q, self.context.get_time()
        while (elapsed := self.context.get_time() - begin) < duration:
            s = elapsed / duration
            v = way * 30 * s**2 * (1 - s) ** 2 / duration
            self.want(start + way * (10 * s**3 - 15 * s**4 + 6 * s**5), v)
            self.advance(STEP)
        self.want(start + way)
        self.advance(0.2)

    def positions(self, instance):
        return self.plant.GetPositions(self.plant_context, instance)
