"""Puts a gripper on its carrier into a MultibodyPlant."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BodyIndex,
    Frame,
    ModelInstanceIndex,
    RigidBody,
)

from xray_drake.cell.cell import Cell
from xray_drake.choices import CARRIERS
from xray_drake.grasping.gripper_geometry import (
    FINGER_JOINTS,
    gripper_geometry,
)
from xray_drake.gripper.carriers.arm import Arm
from xray_drake.gripper.carriers.arm_cell import YUMI_ARM
from xray_drake.gripper.carriers.carrier import Carrier
from xray_drake.gripper.carriers.wrist import add_wrist, make_wrist
from xray_drake.gripper.models import add_hand, moving_joints


@dataclass(frozen=True, eq=False)
class MountedGripper:
    """A gripper and its carrier as they stand in a plant.

    Each model instance has the plant's own ports: the state is positions, then
    velocities; the desired state, which must be connected, is the same.

    Attributes:
        plant: in which they stand.
        carrier_instance: the joints of the wrist or of the arm.
        finger_instance: the joints of the left and of the right finger, each
            from open (0) to closed (``finger_travel``).
        base_index: of ``base``.
        carrier: its kinematics, limits and paths.
        X_BJ: 4×4 pose of the jaw frame in B, m.
        X_BC: 4×4 pose of the cup frame in B, m; None without a cup.
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
    X_BJ: np.ndarray
    X_BC: np.ndarray | None
    finger_travel: float
    finger_speed: float
    finger_force: float
    finger_stiffness: float

    @property
    def base(self) -> RigidBody:
        """The gripper's body, whose frame B is the carrier's tool frame."""
        return self.plant.get_body(self.base_index)

    @property
    def meshcat_path(self) -> str:
        """Where Drake's visualizer draws its base."""
        name = self.plant.GetModelInstanceName(self.finger_instance)
        return f"visualizer/{name}/{self.base.name()}"

    def bodies(self, plant: MultibodyPlant) -> list[RigidBody]:
        """Returns the bodies that can touch something: base and fingers."""
        return [
            plant.get_body(index)
            for index in plant.GetBodyIndices(self.finger_instance)
        ]


_Add = Callable[[MultibodyPlant, Cell], tuple[ModelInstanceIndex, Frame]]
_Make = Callable[
    [
        MultibodyPlant,
        ModelInstanceIndex,
        ModelInstanceIndex,
        np.ndarray,
        Cell,
    ],
    Carrier,
]

_CARRIERS: Mapping[str, tuple[_Add, _Make]] = {
    "wrist": (add_wrist, make_wrist),
    "arm": (YUMI_ARM.add, lambda *given: Arm(YUMI_ARM, given[-1])),
}
"""How to add a carrier to a plant, and to make its kinematics."""


def add_gripper(
    plant: MultibodyPlant,
    *,
    carrier: str = CARRIERS[0],
    cell: Cell | None = None,
) -> MountedGripper:
    """Adds the gripper to a plant, at home and open in the default context.

    Its position control is the plant's own: PD gains that the solver takes in
    implicitly, with the joints' force limits. Connect or fix
    ``plant.get_desired_state_input_port`` of both model instances: left open,
    the gripper is limp.

    Args:
        plant: discrete, not finalized.
        carrier: one of :data:`xray_drake.choices.CARRIERS`.
        cell: says which gripper, where it is mounted and waits; by default
            the nominal one.

    Raises:
        ReachError: the wrist cannot be at home.
        ConfigurationError: the gripper's model cannot be read.
    """
    add, make = _CARRIERS[carrier]
    cell = cell or Cell()
    spec = cell.gripper.spec
    geometry = gripper_geometry(spec)
    arm, tool = add(plant, cell)
    hand = add_hand(plant, tool, spec.file)
    base = plant.GetBodyByName("gripper_base", hand)
    for instance in (arm, hand):
        plant.set_gravity_enabled(instance, False)
    left, right = (plant.GetJointByName(name, hand) for name in FINGER_JOINTS)
    plant.AddCouplerConstraint(left, right, 1.0)

    kinematics = make(plant, arm, hand, geometry.X_BJ, cell)
    joints = moving_joints(plant, arm)
    for joint, position in zip(joints, kinematics.home, strict=True):
        joint.set_default_positions([position])
    finger = plant.GetJointActuatorByName(FINGER_JOINTS[0], hand)
    return MountedGripper(
        plant=plant,
        carrier_instance=arm,
        finger_instance=hand,
        base_index=base.index(),
        carrier=kinematics,
        X_BJ=geometry.X_BJ,
        X_BC=geometry.X_BC,
        finger_travel=float(left.position_upper_limits()[0]),
        finger_speed=float(left.velocity_upper_limits()[0]),
        finger_force=finger.effort_limit(),
        finger_stiffness=finger.get_controller_gains().p,
    )
