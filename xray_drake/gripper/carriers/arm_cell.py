"""The arm in a plant of its own, between bin and tote, to compute with."""

import itertools

import numpy as np
from pydrake.geometry import (
    CollisionFilterDeclaration,
    GeometrySet,
    SceneGraph,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.inverse_kinematics import InverseKinematics
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import (
    Frame,
    JacobianWrtVariable,
    ModelInstanceIndex,
)
from pydrake.solvers import Solve
from pydrake.systems.framework import DiagramBuilder

from xray_drake.gripper.models import add_hand, add_model, joint_limits
from xray_drake.scene.plant import add_bin

JOINTS = ("1", "2", "7", "3", "4", "5", "6")
"""The arm's axes as ABB numbers them, in the order of all vectors here: rad."""

MOUNT = np.array(
    [[-1.0, 0, 0, 0.28], [0, 1.0, 0, 0], [0, 0, -1.0, 0.60], [0, 0, 0, 1]]
)
"""Pose X_WA of the arm's base, 4×4: axis 1 points down over the gap between bin
and tote. The arm is too short to reach over both from beside them; from there
it does, and it can keep out of the overhead camera's view."""

_LINKS = tuple(f"link_{name}" for name in JOINTS)

_MARGIN = 0.005
"""Links stay so far from bin, tote, post and one another, m."""

_POSITION_TOLERANCE = 1e-5
_ANGLE_TOLERANCE = 1e-3
"""Of inverse kinematics, m and rad; what it finds is then made exact."""

_NEARNESS = 0.1
"""Weight of nearness against distance from the joints' limits."""


def add_arm_model(plant: MultibodyPlant) -> tuple[ModelInstanceIndex, Frame]:
    """Adds the arm to a plant, hung up; returns it and its tool frame."""
    arm = add_model(plant, "yumi_arm.sdf")
    plant.WeldFrames(
        plant.world_frame(),
        plant.GetFrameByName("arm_base", arm),
        RigidTransform(MOUNT),
    )
    return arm, plant.GetFrameByName("tool", arm)


class ArmCell:
    """Where the tool is, what the arm touches, and how it gets to a pose.

    Each question sets all that its answer depends on, in one context of the
    cell's own. So contexts of a diagram that holds a cell can take turns, but
    two threads cannot use one cell, nor such a diagram, at the same time.

    Attributes:
        lower: (7,) lowest positions, rad.
        upper: (7,) highest positions, rad.
        velocity: (7,) highest speeds, rad/s.
        acceleration: (7,) highest accelerations, rad/s².
        stiffness: (7,) of the position control, N·m/rad.
        damping: (7,) of the position control, N·m·s/rad.
    """

    def __init__(self) -> None:
        """Builds the plant."""
        builder = DiagramBuilder()
        plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
        self._plant: MultibodyPlant = plant
        arm, self._tool = add_arm_model(plant)
        add_bin(plant, with_tote=True)
        add_hand(plant, self._tool)
        plant.Finalize()
        limits = joint_limits(plant, [f"arm_{name}" for name in JOINTS], arm)
        self.lower, self.upper = limits.lower, limits.upper
        self.velocity = limits.velocity
        self.acceleration = limits.acceleration
        self.stiffness, self.damping = limits.stiffness, limits.damping
        self._filter(scene_graph)
        self._diagram = builder.Build()
        self._root = self._diagram.CreateDefaultContext()
        self._context = plant.GetMyMutableContextFromRoot(self._root)
        self._query = plant.get_geometry_query_input_port()
        self._q = plant.GetPositions(self._context)

    def _filter(self, scene_graph: SceneGraph) -> None:
        """Leaves the pairs that tell something of the arm.

        Whether the gripper touches something in the bin is the grasp
        planner's to say.
        """
        plant = self._plant

        def geometry(*names: str) -> GeometrySet:
            return GeometrySet(
                [
                    item
                    for name in names
                    for item in plant.GetCollisionGeometriesForBody(
                        plant.GetBodyByName(name)
                    )
                ]
            )

        chain = ("arm_base", *_LINKS, "gripper_base")
        fingers = ("left_finger", "right_finger")
        surroundings = geometry("bin", "tote")
        filters = CollisionFilterDeclaration()
        filters.ExcludeBetween(
            geometry("arm_base", "gripper_base", *fingers), surroundings
        )
        filters.ExcludeBetween(geometry(*fingers), geometry(*chain))
        for near, far in itertools.pairwise(range(len(chain))):
            for name in chain[far : near + 3]:
                filters.ExcludeBetween(geometry(chain[near]), geometry(name))
        # The gripper's body is as wide as the wrist that carries it.
        filters.ExcludeBetween(
            geometry("gripper_base"), geometry("link_4", "link_5")
        )
        scene_graph.collision_filter_manager().Apply(filters)

    def pose(self, q: np.ndarray) -> np.ndarray:
        """Returns the tool's 4×4 pose X_WT at joint positions (7,)."""
        self._set(q)
        X_WT = self._tool.CalcPoseInWorld(self._context)
        return X_WT.GetAsMatrix4()

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Returns (6, 7): angular velocity of the tool over its velocity."""
        self._set(q)
        world = self._plant.world_frame()
        J = self._plant.CalcJacobianSpatialVelocity(
            self._context,
            JacobianWrtVariable.kQDot,
            self._tool,
            np.zeros(3),
            world,
            world,
        )
        return J[:, : len(q)]

    def inertial_torque(
        self, q: np.ndarray, v: np.ndarray, acceleration: np.ndarray
    ) -> np.ndarray:
        """Returns (7,) what it takes to move so with the gripper, N·m."""
        self._set(q)
        n, plant = len(q), self._plant
        velocities = np.zeros(plant.num_velocities())
        velocities[:n] = v
        plant.SetVelocities(self._context, velocities)
        M = plant.CalcMassMatrix(self._context)[:n, :n]
        return M @ acceleration + plant.CalcBiasTerm(self._context)[:n]

    def is_clear(self, q: np.ndarray) -> bool:
        """Says whether the links are clear of all else."""
        self._set(q)
        query = self._query.Eval(self._context)
        pairs = query.ComputeSignedDistancePairwiseClosestPoints(_MARGIN)
        return not pairs

    def solve(
        self, X_WT: np.ndarray, near: np.ndarray, seed: np.ndarray
    ) -> np.ndarray | None:
        """Returns joint positions (7,) at a pose, or None if none are found.

        Drake's inverse kinematics: of the joint positions at the pose those
        that are far from the joints' limits and near others.

        Args:
            X_WT: 4×4, m.
            near: (7,) those others.
            seed: (7,) where the search begins.
        """
        problem = InverseKinematics(self._plant, with_joint_limits=False)
        q = problem.q()
        n = len(self.lower)
        world = self._plant.world_frame()
        p_WT = X_WT[:3, 3]
        problem.AddPositionConstraint(
            self._tool,
            np.zeros(3),
            world,
            p_WT - _POSITION_TOLERANCE,
            p_WT + _POSITION_TOLERANCE,
        )
        problem.AddOrientationConstraint(
            world,
            RotationMatrix(X_WT[:3, :3]),
            self._tool,
            RotationMatrix(),
            _ANGLE_TOLERANCE,
        )
        program = problem.prog()
        program.AddBoundingBoxConstraint(self.lower, self.upper, q[:n])
        program.AddBoundingBoxConstraint(0.0, 0.0, q[n:])
        half = (self.upper - self.lower) / 2
        weights = np.diag(half**-2.0)
        middle = (self.upper + self.lower) / 2
        program.AddQuadraticErrorCost(weights, middle, q[:n])
        program.AddQuadraticErrorCost(_NEARNESS * weights, near, q[:n])
        program.SetInitialGuess(q[:n], seed)
        program.SetInitialGuess(q[n:], np.zeros(len(q) - n))
        result = Solve(program)
        return result.GetSolution(q[:n]) if result.is_success() else None

    def _set(self, q: np.ndarray) -> None:
        self._q[: len(q)] = q
        self._plant.SetPositions(self._context, self._q)
