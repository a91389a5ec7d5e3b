"""Puts the YuMi-like gripper on its carrier into a MultibodyPlant."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, ModelInstanceIndex, RigidBody

from xray_drake.choices import CARRIERS
from xray_drake.gripper.carriers import arm_cell
from xray_drake.gripper.carriers.arm import Arm
from xray_drake.gripper.carriers.arm_cell import ArmCell, add_arm_model
from xray_drake.gripper.carriers.carrier import Carrier
from xray_drake.gripper.carriers.wrist import JOINTS, Wrist
from xray_drake.gripper.models import add_hand, add_model, joint_limits
from xray_drake.gripper.transfer import HOME

FINGER_JOINTS = ("left_finger_joint", "right_finger_joint")


@dataclass(frozen=True, eq=False)
class YumiGripper:
    """The gripper and its carrier as they stand in a plant.

    Each model instance has the plant's own ports: the state is positions, then
    velocities; the desired state, which must be connected, is the same.

    Attributes:
        plant: in which they stand.
        carrier_instance: the joints of the wrist, see
            :data:`xray_drake.gripper.carriers.wrist.JOINTS`, or of the arm, see
            :data:`xray_drake.gripper.carriers.arm_cell.JOINTS`.
        finger_instance: the joints of the left and of the right finger, each
            from open (0) to closed (25 mm).
        base_index: of ``base``.
        carrier: its kinematics, limits and paths.
        home: (n,) positions of the carrier's joints at home.
        X_BJ: 4×4 pose of the jaw frame in B, m.
        X_BC: 4×4 pose of the cup frame in B, m.
        finger_travel: of each finger, m.
        finger_speed: highest speed of each finger, m/s.
        finger_force: largest force of each finger, N.
        finger_stiffness: of the position control of each finger, N/m.
    """

    plant: MultibodyPlant
    carrier_instance: ModelInstanceIndex
    finger_instance: ModelInstanceIndex
    base_index: BodyIndex
    carrier: Carrier
    home: np.ndarray
    X_BJ: np.ndarray
    X_BC: np.ndarray
    finger_travel: float
    finger_speed: float
    finger_force: float
    finger_stiffness: float

    @property
    def base(self) -> RigidBody:
        """The gripper's body, whose frame B is the carrier's tool frame."""
        return self.plant.get_body(self.base_index)

    def bodies(self, plant: MultibodyPlant) -> list[RigidBody]:
        """Returns the bodies that can touch something: base and fingers."""
        return [
            plant.get_body(index)
            for index in plant.GetBodyIndices(self.finger_instance)
        ]


def add_gripper(
    plant: MultibodyPlant,
    *,
    home: np.ndarray = HOME,
    carrier: str = CARRIERS[0],
) -> YumiGripper:
    """Adds the gripper to a plant, at home and open in the default context.

    Its position control is the plant's own: PD gains that the solver takes in
    implicitly, with the joints' force limits. Connect or fix
    ``plant.get_desired_state_input_port`` of both model instances: left open,
    the gripper is limp.

    Args:
        plant: discrete, not finalized.
        home: 4×4 pose X_WJ of the jaw on the wrist; an arm has its own.
        carrier: one of :data:`xray_drake.choices.CARRIERS`.

    Raises:
        ReachError: the wrist cannot be at home.
    """
    if carrier == "arm":
        arm, tool = add_arm_model(plant)
    else:
        arm = add_model(plant, "wrist.sdf")
        tool = plant.GetFrameByName("tool", arm)
        plant.WeldFrames(
            plant.world_frame(), plant.GetFrameByName("wrist_base", arm)
        )
    hand = add_hand(plant, tool)
    base = plant.GetBodyByName("gripper_base", hand)
    for instance in (arm, hand):
        plant.set_gravity_enabled(instance, False)
    left, right = (plant.GetJointByName(name, hand) for name in FINGER_JOINTS)
    plant.AddCouplerConstraint(left, right, 1.0)

    X_BJ, X_BC = (
        plant.GetFrameByName(name, hand)
        .GetFixedPoseInBodyFrame()
        .GetAsMatrix4()
        for name in ("jaw", "cup")
    )
    kinematics: Arm | Wrist
    if carrier == "arm":
        names = [f"arm_{name}" for name in arm_cell.JOINTS]
        kinematics = Arm(ArmCell())
        q_home = kinematics.home
    else:
        names = [f"wrist_{name}" for name in JOINTS]
        limits = joint_limits(plant, names, arm)
        kinematics = Wrist(
            R_FT=tool.GetFixedPoseInBodyFrame().rotation().matrix(),
            lower=limits.lower,
            upper=limits.upper,
            velocity=limits.velocity,
            acceleration=limits.acceleration,
            stiffness=limits.stiffness,
            damping=limits.damping,
            mass=_moved_mass(plant, names, arm, hand)[:3],
        )
        q_home = kinematics.joints(
            home @ np.linalg.inv(X_BJ), near=np.zeros(len(names))
        )
    for name, position in zip(names, q_home, strict=True):
        plant.GetJointByName(name, arm).set_default_positions([position])
    finger = plant.GetJointActuatorByName(FINGER_JOINTS[0], hand)
    return YumiGripper(
        plant=plant,
        carrier_instance=arm,
        finger_instance=hand,
        base_index=base.index(),
        carrier=kinematics,
        home=q_home,
        X_BJ=X_BJ,
        X_BC=X_BC,
        finger_travel=float(left.position_upper_limits()[0]),
        finger_speed=float(left.velocity_upper_limits()[0]),
        finger_force=finger.effort_limit(),
        finger_stiffness=finger.get_controller_gains().p,
    )


def _moved_mass(
    plant: MultibodyPlant,
    names: Sequence[str],
    arm: ModelInstanceIndex,
    hand: ModelInstanceIndex,
) -> np.ndarray:
    """Returns the (n,) masses beyond each of a chain's n joints, kg."""
    own = [
        plant.GetJointByName(name, arm).child_body().default_mass()
        for name in names
    ]
    held = [
        plant.get_body(index).default_mass()
        for index in plant.GetBodyIndices(hand)
    ]
    return np.cumsum(own[::-1])[::-1] + sum(held)
