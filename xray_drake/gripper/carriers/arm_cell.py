"""The arm in a plant of its own, between bin and tote, to compute with."""

import itertools
import logging

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.inverse_kinematics import (
    DifferentialInverseKinematicsParameters,
    DoDifferentialInverseKinematics,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    Frame,
    JacobianWrtVariable,
    ModelInstanceIndex,
)
from pydrake.planning import RobotDiagramBuilder, SceneGraphCollisionChecker
from pydrake.systems.framework import Context

from xray_drake.gripper.models import add_carrier, add_hand, joint_limits
from xray_drake.scene.plant import add_bin

JOINTS = ("1", "2", "7", "3", "4", "5", "6")
"""The arm's axes as ABB numbers them, in the order of all vectors here: rad."""

MOUNT = np.array(
    [[-1.0, 0, 0, 0.28], [0, 1.0, 0, 0], [0, 0, -1.0, 0.60], [0, 0, 0, 1]]
)
"""Pose X_WA of the arm's base, 4×4: axis 1 points down over the gap between bin
and tote. The arm is too short to reach over both from beside them; from there
it does, and it can keep out of the overhead camera's view."""

_CHAIN = ("arm_base", *(f"link_{name}" for name in JOINTS), "gripper_base")
_FINGERS = ("left_finger", "right_finger")
_FILTERED = (
    # Whether the gripper touches something in the bin is the grasp planner's
    # to say.
    *itertools.product(("arm_base", _CHAIN[-1], *_FINGERS), ("bin", "tote")),
    *itertools.product(_FINGERS, _CHAIN),
    *itertools.pairwise(_CHAIN),
    *zip(_CHAIN, _CHAIN[2:], strict=False),
    # The gripper's body is as wide as the wrist that carries it.
    ("gripper_base", "link_4"),
)
"""Pairs of bodies of which a distance tells nothing."""

_MARGIN = 0.005
"""Links stay so far from bin, tote, post and one another, m."""

_TOLERANCE = 1e-7
_ITERATIONS = 20
_LONGEST = 0.4
"""Of inverse kinematics: error that ends it, m and in a rotation matrix; steps
at most; and the longest one, rad."""

_CENTRING = 0.02
"""Share of the way to the middle of its limits that a joint goes in a step, as
far as the pose leaves it free."""


def add_arm(plant: MultibodyPlant) -> tuple[ModelInstanceIndex, Frame]:
    """Adds the arm to a plant, hung up; returns it and its tool frame."""
    return add_carrier(plant, "yumi_arm.sdf", "arm_base", MOUNT)


class ArmCell:
    """Where the tool is, what the arm touches, and how it gets to a pose.

    Each question sets all that its answer depends on, in one context of the
    cell's own. So contexts of a diagram that holds a cell can take turns, but
    two threads cannot use one cell, nor such a diagram, at the same time.

    Attributes:
        limits: of its n joints.
    """

    def __init__(self) -> None:
        """Builds the plant."""
        builder = RobotDiagramBuilder(0.0)
        plant = builder.plant()
        arm, tool = add_arm(plant)
        add_bin(plant, with_tote=True)
        hand = add_hand(plant, tool)
        self.limits = joint_limits(plant, arm)
        self._tool = tool.index()
        drake = logging.getLogger("drake")
        level = drake.level
        drake.setLevel(logging.WARNING)  # It tells of its contexts.
        self._checker = SceneGraphCollisionChecker(
            model=builder.Build(),
            robot_model_instances=[arm, hand],
            edge_step_size=1.0,
            env_collision_padding=_MARGIN,
            self_collision_padding=_MARGIN,
        )
        drake.setLevel(level)
        plant = self._checker.plant()
        for names in _FILTERED:
            first, second = map(plant.GetBodyByName, names)
            if not self._checker.IsCollisionFilteredBetween(first, second):
                self._checker.SetCollisionFilteredBetween(first, second, True)
        size, n = plant.num_positions(), len(JOINTS)
        self._rest = np.zeros(size - n)
        limits, rest = self.limits, self._rest
        step = np.r_[np.full(n, _LONGEST), rest]
        self._steps = DifferentialInverseKinematicsParameters(size, size)
        self._steps.set_time_step(1.0)
        self._steps.set_joint_velocity_limits((-step, step))
        self._steps.set_joint_position_limits(
            (np.r_[limits.lower + 1e-6, rest], np.r_[limits.upper - 1e-6, rest])
        )
        middle = (limits.lower + limits.upper) / 2
        self._steps.set_nominal_joint_position(np.r_[middle, rest])

    def pose(self, q: np.ndarray) -> np.ndarray:
        """Returns the tool's 4×4 pose X_WT at joint positions (7,)."""
        return self._pose(self._at(q)).GetAsMatrix4()

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Returns (6, 7): angular velocity of the tool over its velocity."""
        plant = self._checker.plant()
        world = plant.world_frame()
        J = plant.CalcJacobianSpatialVelocity(
            self._at(q),
            JacobianWrtVariable.kQDot,
            plant.get_frame(self._tool),
            np.zeros(3),
            world,
            world,
        )
        return J[:, : len(q)]

    def inertial_torque(
        self, q: np.ndarray, v: np.ndarray, acceleration: np.ndarray
    ) -> np.ndarray:
        """Returns (7,) what it takes to move so with the gripper, N·m."""
        plant, context, n = self._checker.plant(), self._at(q), len(q)
        plant.SetVelocities(context, np.r_[v, self._rest])
        M = plant.CalcMassMatrix(context)[:n, :n]
        return M @ acceleration + plant.CalcBiasTerm(context)[:n]

    def is_clear(self, q: np.ndarray) -> bool:
        """Says whether the links are clear of all else."""
        return self._checker.CheckConfigCollisionFree(np.r_[q, self._rest])

    def reach(
        self, X_WT: np.ndarray, q: np.ndarray, *, centred: bool = True
    ) -> np.ndarray | None:
        """Returns joint positions (7,) near q exactly at a pose, or None.

        Args:
            X_WT: 4×4, m.
            q: (7,) where to begin.
            centred: at first it goes to the middle of the joints' limits, too.
        """
        target, plant = RigidTransform(X_WT), self._checker.plant()
        gain = _CENTRING * np.eye(plant.num_positions())
        for number in range(_ITERATIONS):
            centring = centred and number < 2
            context = self._at(q)
            if not centring and self._pose(context).IsNearlyEqualTo(
                target, _TOLERANCE
            ):
                return q
            self._steps.set_joint_centering_gain(centring * gain)
            step = DoDifferentialInverseKinematics(
                plant, context, target, plant.get_frame(self._tool), self._steps
            ).joint_velocities
            if step is None:
                return None
            q = q + step[: len(q)]
        return None

    def _at(self, q: np.ndarray) -> Context:
        self._checker.UpdatePositions(np.r_[q, self._rest])
        return self._checker.plant_context()

    def _pose(self, context: Context) -> RigidTransform:
        frame = self._checker.plant().get_frame(self._tool)
        return frame.CalcPoseInWorld(context)
