"""The model files of gripper, wrist and arm, and what they say of joints."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, ModelInstanceIndex

from xray_drake.resources import PACKAGE_NAME
from xray_drake.scene.parsing import configure_parser


def add_model(plant: MultibodyPlant, file: str) -> ModelInstanceIndex:
    """Adds the one model of a file in ``models/gripper`` to a plant."""
    parser = Parser(plant)
    configure_parser(parser)
    (instance,) = parser.AddModelsFromUrl(
        f"package://{PACKAGE_NAME}/gripper/{file}"
    )
    return instance


def add_hand(plant: MultibodyPlant, tool: Frame) -> ModelInstanceIndex:
    """Adds the gripper to a plant, welded by its base to a tool frame."""
    hand = add_model(plant, "yumi_gripper.sdf")
    plant.WeldFrames(tool, plant.GetFrameByName("gripper_base", hand))
    return hand


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


def joint_limits(
    plant: MultibodyPlant, names: Sequence[str], instance: ModelInstanceIndex
) -> JointLimits:
    """Returns the limits of actuated joints of one degree of freedom.

    Args:
        plant: holds them.
        names: of the joints, which are their actuators', too.
        instance: of which they are.
    """
    joints = [plant.GetJointByName(name, instance) for name in names]
    gains = [
        plant.GetJointActuatorByName(name, instance).get_controller_gains()
        for name in names
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
