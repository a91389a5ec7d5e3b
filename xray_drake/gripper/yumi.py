"""Puts the YuMi-like gripper on its wrist into a MultibodyPlant."""

from dataclasses import dataclass

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex, RigidBody

from xray_drake.gripper.wrist import JOINTS, Wrist
from xray_drake.resources import PACKAGE_NAME
from xray_drake.scene.parsing import configure_parser

HOME = np.array(
    [[1.0, 0, 0, 0.0], [0, -1.0, 0, 0.32], [0, 0, -1.0, 0.34], [0, 0, 0, 1]]
)
"""Where the jaw waits: pointing down, beside the overhead camera's view."""

FINGER_JOINTS = ("left_finger_joint", "right_finger_joint")


@dataclass(frozen=True, eq=False)
class YumiGripper:
    """The gripper and its wrist as they stand in a plant.

    Each model instance has the plant's own ports: the state is positions, then
    velocities; the desired state, which must be connected, is the same.

    Attributes:
        wrist_instance: six joints, see :data:`xray_drake.gripper.wrist.JOINTS`.
        finger_instance: the joints of the left and of the right finger, each
            from open (0) to closed (25 mm).
        base: the gripper's body, whose frame B is the wrist's tool frame.
        wrist: the wrist's kinematics and limits.
        home: (6,) positions of the wrist's joints at home.
        X_BJ: 4×4 pose of the jaw frame in B, m.
        X_BC: 4×4 pose of the cup frame in B, m.
        finger_travel: of each finger, m.
        finger_speed: highest speed of each finger, m/s.
        finger_force: largest force of each finger, N.
        finger_stiffness: of the position control of each finger, N/m.
    """

    wrist_instance: ModelInstanceIndex
    finger_instance: ModelInstanceIndex
    base: RigidBody
    wrist: Wrist
    home: np.ndarray
    X_BJ: np.ndarray
    X_BC: np.ndarray
    finger_travel: float
    finger_speed: float
    finger_force: float
    finger_stiffness: float

    def bodies(self, plant: MultibodyPlant) -> list[RigidBody]:
        """Returns the bodies that can touch something: base and fingers."""
        return [
            plant.get_body(index)
            for index in plant.GetBodyIndices(self.finger_instance)
        ]


def add_gripper(
    plant: MultibodyPlant, *, home: np.ndarray = HOME
) -> YumiGripper:
    """Adds the gripper to a plant, at home and open in the default context.

    Its position control is the plant's own: PD gains that the solver takes in
    implicitly, with the joints' force limits. Connect or fix
    ``plant.get_desired_state_input_port`` of both model instances: left open,
    the gripper is limp.

    Args:
        plant: discrete, not finalized.
        home: 4×4 pose X_WJ of the jaw.

    Raises:
        ReachError: the wrist cannot be at home.
    """
    parser = Parser(plant)
    configure_parser(parser)
    folder = f"package://{PACKAGE_NAME}/gripper"
    (arm,) = parser.AddModelsFromUrl(f"{folder}/wrist.sdf")
    (hand,) = parser.AddModelsFromUrl(f"{folder}/yumi_gripper.sdf")
    base = plant.GetBodyByName("gripper_base", hand)
    tool = plant.GetFrameByName("tool", arm)
    plant.WeldFrames(
        plant.world_frame(), plant.GetFrameByName("wrist_base", arm)
    )
    plant.WeldFrames(tool, base.body_frame())
    for instance in (arm, hand):
        plant.set_gravity_enabled(instance, False)
    left, right = (plant.GetJointByName(name, hand) for name in FINGER_JOINTS)
    plant.AddCouplerConstraint(left, right, 1.0)

    joints = [plant.GetJointByName(f"wrist_{name}", arm) for name in JOINTS]
    actuators = [
        plant.GetJointActuatorByName(joint.name(), arm) for joint in joints
    ]
    wrist = Wrist(
        R_FT=tool.GetFixedPoseInBodyFrame().rotation().matrix(),
        lower=np.concatenate([j.position_lower_limits() for j in joints]),
        upper=np.concatenate([j.position_upper_limits() for j in joints]),
        velocity=np.concatenate([j.velocity_upper_limits() for j in joints]),
        acceleration=np.concatenate(
            [j.acceleration_upper_limits() for j in joints]
        ),
        stiffness=np.array([a.get_controller_gains().p for a in actuators]),
    )
    X_BJ, X_BC = (
        plant.GetFrameByName(name, hand)
        .GetFixedPoseInBodyFrame()
        .GetAsMatrix4()
        for name in ("jaw", "cup")
    )
    q_home = wrist.joints(home @ np.linalg.inv(X_BJ), near=np.zeros(6))
    for joint, position in zip(joints, q_home, strict=True):
        joint.set_default_positions([position])
    finger = plant.GetJointActuatorByName(FINGER_JOINTS[0], hand)
    return YumiGripper(
        wrist_instance=arm,
        finger_instance=hand,
        base=base,
        wrist=wrist,
        home=q_home,
        X_BJ=X_BJ,
        X_BC=X_BC,
        finger_travel=float(left.position_upper_limits()[0]),
        finger_speed=float(left.velocity_upper_limits()[0]),
        finger_force=finger.effort_limit(),
        finger_stiffness=finger.get_controller_gains().p,
    )
