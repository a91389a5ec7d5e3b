"""The arm in a plant of its own, between bin and tote, to compute with."""

import itertools
import logging
from collections.abc import Iterator
from dataclasses import dataclass

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

from xray_drake.cell.cell import Cell
from xray_drake.gripper.models import add_carrier, add_hand, joint_limits
from xray_drake.scene.plant import add_bin, add_tote

_HAND = "gripper_base"
_FINGERS = ("left_finger", "right_finger")


@dataclass(frozen=True, eq=False)
class ArmModel:
    """An arm whose first axis is vertical, and where it stands.

    Attributes:
        file: in ``models/gripper``; the gripper is welded to its frame "tool".
        links: its bodies from base to tool; the joints are in their order.
        X_WA: 4×4 pose of the first of them; its place is the cell's.
        ready: (n,) joint positions somewhere in the middle of its reach, rad.
        home: (n,) joint positions near those at home, rad.
        home_place: where the tool is at home, pointing down, from the base
            along the world's x and y, m.
        headroom: the tool stays so far below the base, where the arm has room
            to fold, m.
        turning_radius: so near axis 1 is the tool while the arm turns, to pass
            base and posts, m.
    """

    file: str
    links: tuple[str, ...]
    X_WA: np.ndarray
    ready: np.ndarray
    home: np.ndarray
    home_place: tuple[float, float]
    headroom: float
    turning_radius: tuple[float, float]

    def add(
        self, plant: MultibodyPlant, cell: Cell
    ) -> tuple[ModelInstanceIndex, Frame]:
        """Adds the arm to a plant, where a cell has it mounted.

        Returns:
            It and its tool frame.
        """
        return add_carrier(plant, self.file, self.links[0], self.mounted(cell))

    def mounted(self, cell: Cell) -> np.ndarray:
        """Returns the 4×4 pose of its base in a cell, m."""
        X_WA = np.array(self.X_WA)
        X_WA[:3, 3] = cell.p_WM
        return X_WA

    def filtered(self) -> Iterator[tuple[str, str]]:
        """Yields pairs of bodies of which a distance tells nothing."""
        chain = (*self.links, _HAND)
        # Whether the gripper touches something in the bin is the grasp
        # planner's to say.
        still = (self.links[0], _HAND, *_FINGERS)
        yield from itertools.product(still, ("bin", "tote"))
        yield from itertools.product(_FINGERS, chain)
        yield from itertools.pairwise(chain)
        yield from zip(chain, chain[2:], strict=False)
        # The gripper's body is as wide as the wrist that carries it.
        yield _HAND, self.links[-3]


YUMI_ARM = ArmModel(
    file="yumi_arm.sdf",
    # The arm's axes as ABB numbers them.
    links=("arm_base", *(f"link_{name}" for name in "1273456")),
    # Axis 1 points down over the gap between bin and tote. The arm is too short
    # to reach over both from beside them; from there it does, and it can keep
    # out of the overhead camera's view.
    X_WA=np.array(
        [[-1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 0, -1.0, 0], [0, 0, 0, 1]]
    ),
    ready=np.deg2rad([0.0, -60.0, 0.0, 10.0, 0.0, 60.0, 0.0]),
    home=np.deg2rad([103.0, -108.0, -111.0, 53.0, 63.0, 88.0, -69.0]),
    home_place=(0.24, 0.0),
    headroom=0.18,
    turning_radius=(0.22, 0.34),
)

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


class ArmCell:
    """Where the tool is, what the arm touches, and how it gets to a pose.

    Each question sets all that its answer depends on, in one context of the
    cell's own. So contexts of a diagram that holds a cell can take turns, but
    two threads cannot use one cell, nor such a diagram, at the same time.

    Attributes:
        limits: of its n joints.
    """

    def __init__(self, model: ArmModel, cell: Cell) -> None:
        """Builds the plant of an arm that is mounted in a cell."""
        builder = RobotDiagramBuilder(0.0)
        plant = builder.plant()
        arm, tool = model.add(plant, cell)
        add_bin(plant, cell.bin)
        add_tote(plant, cell.placed_tote)
        hand = add_hand(plant, tool, cell.gripper.spec.file)
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
        for names in model.filtered():
            first, second = map(plant.GetBodyByName, names)
            if not self._checker.IsCollisionFilteredBetween(first, second):
                self._checker.SetCollisionFilteredBetween(first, second, True)
        size, n = plant.num_positions(), len(self.limits.lower)
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
        """Returns the tool's 4×4 pose X_WT at joint positions (n,)."""
        return self._pose(self._at(q)).GetAsMatrix4()

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Returns (6, n): angular velocity of the tool over its velocity."""
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
        """Returns (n,) what it takes to move so with the gripper, N·m."""
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
        """Returns joint positions (n,) near q exactly at a pose, or None.

        Args:
            X_WT: 4×4, m.
            q: (n,) where to begin.
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
