"""What the gripper's tests share: systems with fixed inputs, and objects."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from xray_drake.gripper.controller import GripperController
from xray_drake.gripper.grip_surfaces import add_grip_surfaces
from xray_drake.gripper.suction_cup import SuctionCup
from xray_drake.gripper.yumi import add_gripper
from xray_drake.messages import GripperMode
from xray_drake.scene.cameras import add_camera, nominal_camera
from xray_drake.scene.object_model import object_from_pieces
from xray_drake.scene.plant import (
    TOTE_POSITION,
    TOTE_SIZE,
    add_bin,
    add_object,
    add_objects,
    add_plant,
    default_plant_config,
)
from xray_drake.scene.shapes import box

STEP = 0.005


def block(size, mass, name="brick"):
    """A box of this size, m, and mass, kg."""
    return object_from_pieces(
        name, list(box(*size).surfaces), density=mass / float(np.prod(size))
    )


def downwards(*p_WG):
    """A pose at a point whose z axis points down."""
    X_WG = np.diag([1.0, -1.0, -1.0, 1.0])
    X_WG[:3, 3] = p_WG
    return X_WG


def in_tote(p_W):
    away = np.abs(p_W[:2] - TOTE_POSITION[:2])
    return bool((away < TOTE_SIZE[0] / 2).all() and 0 < p_W[2] < TOTE_SIZE[2])


def make_gripper(carrier="wrist"):
    """The gripper in a plant of its own."""
    plant = MultibodyPlant(0.005)
    gripper = add_gripper(plant, carrier=carrier)
    plant.Finalize()
    return gripper


class Alone:
    """A system with fixed inputs."""

    def __init__(self, system, **inputs):
        self.system = system
        self.simulator = Simulator(system)
        self.context = self.simulator.get_mutable_context()
        for port, value in inputs.items():
            self.fix(port, value)

    def fix(self, port, value):
        plain = isinstance(value, np.ndarray)
        self.system.GetInputPort(port).FixValue(
            self.context, value if plain else AbstractValue.Make(value)
        )

    def get(self, port):
        return self.system.GetOutputPort(port).Eval(self.context)

    def advance_to(self, time):
        """Advances, and handles the events that are due at ``time``.

        Returns:
            The first output.
        """
        self.simulator.AdvanceTo(time)
        self.simulator.AdvancePendingEvents()
        return self.system.get_output_port(0).Eval(self.context)


def connect_body(builder, plant, system):
    """Connects what looks at bodies and pulls at them to its plant."""
    for name in ("body_poses", "body_spatial_velocities"):
        builder.Connect(plant.GetOutputPort(name), system.GetInputPort(name))
    builder.Connect(
        system.GetOutputPort("applied_spatial_force"),
        plant.get_applied_spatial_force_input_port(),
    )


class TransferCell:
    """A bin, a tote, objects, and a gripper that moves them.

    Subclasses add a gripper to ``builder``, and then :meth:`build`.
    """

    def __init__(self, poses, *models):
        self.builder = DiagramBuilder()
        self.plant, self.scene_graph = add_plant(
            self.builder, default_plant_config()
        )
        add_bin(self.plant, with_tote=True)
        items = add_objects(self.plant, models)
        for item in items:
            item.joint.SetDefaultPose(RigidTransform(poses[item.name]))
        self.items = {item.name: item for item in items}
        self.bodies = {item.name: int(item.body.index()) for item in items}

    def build(self, gripper):
        self.gripper = gripper
        self.builder.ExportInput(gripper.GetInputPort("action"), "action")
        self.diagram = self.builder.Build()
        self.simulator = Simulator(self.diagram)
        self.context = self.simulator.get_mutable_context()

    def command(self, action):
        self.diagram.GetInputPort("action").FixValue(
            self.context, AbstractValue.Make(action)
        )

    def pose(self, name):
        context = self.plant.GetMyContextFromRoot(self.context)
        return self.items[name].body.EvalPoseInWorld(context).GetAsMatrix4()

    @property
    def status(self):
        return self.gripper.GetOutputPort("status").Eval(
            self.gripper.GetMyContextFromRoot(self.context)
        )

    def advance(self, time):
        self.simulator.AdvanceTo(self.context.get_time() + time)
        return self.status

    def run(self, action, limit=8.0):
        """Runs an action to its end; returns the object's way, (n, 3)."""
        self.command(action)
        way = []
        end = self.context.get_time() + limit
        while True:
            status = self.advance(0.05)
            way.append(self.pose(action.grasp.object)[:3, 3])
            done = status.mode is GripperMode.IDLE
            if done and status.number == action.number:
                return np.array(way)
            assert self.context.get_time() < end


class ContactCell(TransferCell):
    """Gripper, cup and controller on a plant with one object."""

    def __init__(self, model, carrier="wrist"):
        X_WO = np.eye(4)
        X_WO[:3, 3] = 0.05, 0.02, model.extents[2] / 2
        super().__init__({model.name: X_WO}, model)
        builder, plant = self.builder, self.plant
        gripper = add_gripper(plant, carrier=carrier)
        add_grip_surfaces(plant, self.scene_graph, gripper, self.items.values())
        plant.Finalize()
        cup = builder.AddSystem(
            SuctionCup(
                objects=[model],
                bodies=self.bodies,
                gripper=int(gripper.base.index()),
                X_BC=gripper.X_BC,
            )
        )
        connect_body(builder, plant, cup)
        controller = builder.AddSystem(GripperController(gripper=gripper))
        for name, instance in (
            ("carrier", gripper.carrier_instance),
            ("finger", gripper.finger_instance),
        ):
            builder.Connect(
                plant.get_state_output_port(instance),
                controller.GetInputPort(f"{name}_state"),
            )
            builder.Connect(
                controller.GetOutputPort(f"{name}_desired_state"),
                plant.get_desired_state_input_port(instance),
            )
        for source, output, drain, name in (
            (cup, "state", controller, "cup_state"),
            (controller, "suction", cup, "suction"),
        ):
            builder.Connect(
                source.GetOutputPort(output), drain.GetInputPort(name)
            )
        self.build(controller)


class DrivenCell:
    """The gripper over the bin, its desired state given by hand.

    Inputs are ``wrist``, ``fingers`` and ``force``, or, with a cup,
    ``suction``. Objects lie at (0.05, 0.02) m.
    """

    def __init__(
        self,
        *models,
        cup=False,
        camera=False,
        carrier="wrist",
        time_step=STEP,
        sampled_ports=True,
    ):
        builder = DiagramBuilder()
        config = default_plant_config()
        config.time_step = time_step
        config.use_sampled_output_ports = sampled_ports
        plant, scene_graph = add_plant(builder, config)
        add_bin(plant)
        gripper = add_gripper(plant, carrier=carrier)
        self.items = {model.name: add_object(plant, model) for model in models}
        for item in self.items.values():
            height = item.model.extents[2] / 2
            item.joint.SetDefaultPose(RigidTransform([0.05, 0.02, height]))
        add_grip_surfaces(plant, scene_graph, gripper, self.items.values())
        plant.Finalize()
        if camera:
            sensor, _ = add_camera(builder, scene_graph, nominal_camera())
            builder.ExportOutput(sensor.label_image_output_port(), "label")
        for name, instance in (
            ("wrist", gripper.carrier_instance),
            ("fingers", gripper.finger_instance),
        ):
            builder.ExportInput(
                plant.get_desired_state_input_port(instance), name
            )
            builder.ExportOutput(
                plant.get_net_actuation_output_port(instance), f"{name}_effort"
            )
        if cup:
            bodies = {n: int(i.body.index()) for n, i in self.items.items()}
            self.cup = builder.AddSystem(
                SuctionCup(
                    objects=models,
                    bodies=bodies,
                    gripper=int(gripper.base.index()),
                    X_BC=gripper.X_BC,
                )
            )
            connect_body(builder, plant, self.cup)
            builder.ExportInput(self.cup.GetInputPort("suction"), "suction")
        else:
            builder.ExportInput(
                plant.get_applied_spatial_force_input_port(), "force"
            )
        self.plant, self.scene_graph = plant, scene_graph
        self.gripper = gripper
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        self.context = self.simulator.get_mutable_context()
        self.want(gripper.carrier.home)
        self.fix("fingers", np.zeros(4))

    def fix(self, port, value):
        self.diagram.GetInputPort(port).FixValue(self.context, value)

    def want(self, q, v=None):
        """Sets the wrist's desired state."""
        self.q = q
        self.fix("wrist", np.r_[q, np.zeros(len(q)) if v is None else v])

    def at(self, X_WG, X_BG=None):
        """Puts a frame of the gripper, by default the jaw, at a pose."""
        gripper = self.gripper
        X_GB = np.linalg.inv(gripper.X_BJ if X_BG is None else X_BG)
        carrier = gripper.carrier
        self.want(carrier.along([X_WG @ X_GB], near=carrier.home)[0])
        self.plant.SetPositions(
            self.plant.GetMyMutableContextFromRoot(self.context),
            gripper.carrier_instance,
            self.q,
        )

    def advance(self, time):
        self.simulator.AdvanceTo(self.context.get_time() + time)

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

    @property
    def plant_context(self):
        return self.plant.GetMyContextFromRoot(self.context)

    def positions(self, instance):
        return self.plant.GetPositions(self.plant_context, instance)

    def height(self, name):
        body = self.items[name].body
        pose = self.plant.EvalBodyPoseInWorld(self.plant_context, body)
        return float(pose.translation()[2])
