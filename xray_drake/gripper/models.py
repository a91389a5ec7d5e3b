"""The model files of gripper, wrist and arm, and what they say of joints."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, Joint, ModelInstanceIndex

from xray_drake.resources import models_dir
from xray_drake.scene.parsing import configure_parser


def add_model(plant: MultibodyPlant, file: Path) -> ModelInstanceIndex:
    """Adds the one model of a file to a plant."""
    parser = Parser(plant)
    configure_parser(parser)
    (instance,) = parser.AddModels(file)
    return instance


def add_hand(
    plant: MultibodyPlant, tool: Frame, file: Path
) -> ModelInstanceIndex:
    """Adds a gripper to a plant, welded by its base to a tool frame."""
    hand = add_model(plant, file)
    plant.WeldFrames(tool, plant.GetFrameByName("gripper_base", hand))
    return hand


def add_carrier(
    plant: MultibodyPlant, file: str, base: str, X_WA: np.ndarray
) -> tuple[ModelInstanceIndex, Frame]:
    """Adds a carrier to a plant; returns it and its tool frame.

    Args:
        plant: not finalized.
        file: in ``models/gripper``.
        base: frame of the model that is welded to the world.
        X_WA: 4×4 pose of that frame, m.
    """
    carrier = add_model(plant, models_dir() / "gripper" / file)
    plant.WeldFrames(
        plant.world_frame(),
        plant.GetFrameByName(base, carrier),
        RigidTransform(X_WA),
    )
    return carrier, plant.GetFrameByName("tool", carrier)


@dataclass(frozen=True, eq=False)
class JointLimits:
    """What joints can do, m and rad, and the gains of their control.

    Attributes:
        lower: (n,) lowest positions.
        upper: (n,) highest positions.
        velocity: (n,) highest speeds, per s.
        acceleration: (n,) highest accelerations, per s².
        stiffness: (n,) of the position control, N/m and N·m/rad.
        damping: (n,) of the position control, N·s/m and N·m·s/rad.
    """

    lower: np.ndarray
    upper: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray


def moving_joints(
    plant: MultibodyPlant, instance: ModelInstanceIndex
) -> list[Joint]:
    """Returns a model's joints that move, in the order of its file."""
    joints = map(plant.get_joint, plant.GetJointIndices(instance))
    return [joint for joint in joints if joint.num_positions()]


def joint_limits(
    plant: MultibodyPlant, instance: ModelInstanceIndex
) -> JointLimits:
    """Returns the limits of a model's joints.

    Args:
        plant: holds them.
        instance: the model; its joints are of one degree of freedom, and their
            actuators have their names.
    """
    joints = moving_joints(plant, instance)
    gains = [
        plant.GetJointActuatorByName(
            joint.name(), instance
        ).get_controller_gains()
        for joint in joints
    ]
    return JointLimits(
        lower=np.concatenate([j.position_lower_limits() for j in joints]),
        upper=np.concatenate([j.position_upper_limits() for j in joints]),
        velocity=np.concatenate([j.velocity_upper_limits() for j in joints]),
        acceleration=np.concatenate(
            [j.acceleration_upper_limits() for j in joints]
        ),
        stiffness=np.array([gain.p for gain in gains]),
        damping=np.array([gain.d for gain in gains]),
    )
