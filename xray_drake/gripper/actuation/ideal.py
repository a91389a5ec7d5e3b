"""The ideal gripper of the paper's transition model (section V.A)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce, SpatialVelocity
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import BasicVector, Context

from xray_drake.cell.cell import Cell
from xray_drake.configuration import number
from xray_drake.grasping.gripper_geometry import GripperGeometry
from xray_drake.grasping.judgement import JudgedGrasp
from xray_drake.grasping.perturbation import PerturbationConfig, perturb
from xray_drake.gripper.motion import Grip, Segment, straight
from xray_drake.gripper.system import TransferSystem
from xray_drake.gripper.transfer import (
    HOLDING,
    LIFT_CLEARANCE,
    Actuation,
    Phase,
    TransferError,
    TransferState,
)
from xray_drake.messages import Grasp, Outcome
from xray_drake.scene.object_model import ObjectModel
from xray_drake.scene.rest import RestTest, corners_in_cell
from xray_drake.seeding import stream


@dataclass
class QuasiStaticConfig:
    """How the ideal gripper moves, and what disturbs its grasps."""

    # Errors between the planned and the executed grasp.
    perturbation: PerturbationConfig = field(default_factory=PerturbationConfig)
    # Highest speed while it carries an object, m/s.
    speed: float = number(0.8, "(0, 10]")
    # Time of the approach, and of the way back, s.
    approach_time: float = number(0.4, "(0, 60]")
    # The spring between gripper and object: N/m, N·s/m, and the most that it
    # pulls beyond the object's weight, N.
    stiffness: float = number(450.0, "(0, 1000000]")
    damping: float = number(30.0, "[0, 100000]")
    force: float = number(20.0, "(0, 10000]")
    # The object has slipped when it lags this far behind the gripper, m.
    slip_distance: float = number(0.08, "(0, 1]")
    # The heap rests when nothing moves farther than this in a round, m, s.
    rest_motion: float = number(0.001, "(0, 0.1]")
    rest_round: float = number(0.3, "(0, 60]")
    # After this time the search goes on even if something still moves, s.
    rest_timeout: float = number(3.0, "[0, 600]")
    # While it waits for rest, wakes also those bodies of the heap that nothing
    # has disturbed: what sleeps under load may then give way a little. It makes
    # up most of a rollout's time.
    settle_awake: bool = False


class Judge(Protocol):
    """Judges a grasp as executed; the grasp planners do."""

    def judge(
        self,
        grasp: Grasp,
        poses: Mapping[str, np.ndarray],
        *,
        X_WG_perturbed: np.ndarray,
        friction: float,
    ) -> JudgedGrasp:
        """Returns a quality of 0 and a reason, or the quality.

        Args:
            grasp: as planned.
            poses: object name to its 4×4 pose X_WO as it lies, m.
            X_WG_perturbed: 4×4 pose of the grasp frame as executed, m.
            friction: Coulomb coefficient as it is, not as it was planned with.
        """


@dataclass(frozen=True, eq=False, kw_only=True)
class IdealState(TransferState):
    """The state of a transfer by the ideal gripper.

    Attributes:
        segment: motion of the held object's centre of mass while one is held,
            else of the grasp frame.
        rest: whether the objects that may move are at rest.
    """

    segment: Segment
    rest: RestTest


@dataclass(frozen=True, eq=False)
class Measured:
    """Where all objects are.

    Attributes:
        time: s.
        poses: object name to its 4×4 pose X_WO, m.
    """

    time: float
    poses: Mapping[str, np.ndarray]


class IdealActuation(Actuation[IdealState, Measured]):
    """Grasps what the judge says that it holds, and draws it by a spring.

    What cannot follow, since it is wedged under others, has slipped. What has
    fallen out of the cell is not waited for.
    """

    touches = False

    def __init__(
        self,
        judge: Judge,
        models: Mapping[str, ObjectModel],
        cell: Cell,
        config: QuasiStaticConfig,
        seed: int,
    ) -> None:
        """Takes judge, objects by name, cell, motions, and the errors' seed."""
        self._judge = judge
        self._bin, self._tote = cell.bin, cell.placed_tote
        self._home = cell.X_WH
        self._models = models
        self._config = config
        self._seed = seed
        rest = (0.0, config.rest_timeout)
        self.waits = {
            Phase.CHECK: rest,
            Phase.RELEASE: (0.0, 0.0),
            Phase.SETTLE: rest,
        }

    def initial(self) -> IdealState:
        """Returns the state at home."""
        return IdealState(
            segment=Segment(self._home, self._home, 0.0, 1.0),
            rest=self._new_rest(),
        )

    def update(self, state: IdealState, now: Measured) -> IdealState:
        """Looks at what may still move, while it waits for it."""
        if state.phase not in (Phase.CHECK, Phase.SETTLE):
            return state
        held = state.action.grasp.object if state.phase is Phase.CHECK else ""
        points = corners_in_cell(
            (self._models[name], X_WO)
            for name, X_WO in now.poses.items()
            if name != held
        )
        rest = state.rest.update(now.time, points)
        return state if rest is state.rest else replace(state, rest=rest)

    def move(self, state: IdealState, now: Measured) -> IdealState:
        """Returns the state with the segment of a phase that moves."""
        grasp, poses, time = state.action.grasp, now.poses, now.time
        duration = self._config.approach_time
        if state.phase is Phase.APPROACH:
            segment = Segment(self._home, grasp.X_WG, time, duration)
        elif state.phase is Phase.LIFT:
            segment = self._lift(grasp.object, poses[grasp.object], time)
        elif state.phase is Phase.CARRY:
            to = np.array(state.segment.end[:3, 3])
            to[:2] = self._tote.slot(state.carried)
            segment = self._straight(state.segment.end, to, time)
        elif state.phase is Phase.LOWER:
            to = np.array(state.segment.end[:3, 3])
            to[2] += self._drop_to(grasp.object, poses)
            segment = self._straight(state.segment.end, to, time)
        elif state.phase in (Phase.RELEASE, Phase.ABORT):
            X_WG = grasp.X_WG
            if state.outcome is not Outcome.FAILED:
                X_WG = poses[grasp.object] @ grasp.X_OG
            segment = Segment(X_WG, self._home, time, duration)
        elif state.phase in (Phase.CHECK, Phase.SETTLE):
            return replace(state, rest=self._new_rest())
        else:
            return state
        return replace(state, segment=segment)

    def arrived(self, state: IdealState, now: Measured) -> bool:
        """Says whether a segment is over; nothing waits for the way home."""
        return (
            state.phase is Phase.HOME
            or state.outcome is Outcome.SLIPPED
            or state.segment.is_over(now.time)
        )

    def grasp(
        self, state: IdealState, now: Measured
    ) -> tuple[IdealState, bool]:
        """Asks the judge about the grasp with its errors; it holds at once."""
        action = state.action
        rng = stream(self._seed, "execution", action.number)
        X_WG, friction = perturb(action.grasp, rng, self._config.perturbation)
        judged = self._judge.judge(
            action.grasp,
            now.poses,
            X_WG_perturbed=X_WG,
            friction=friction,
        )
        if judged.quality <= 0.0:
            raise TransferError(judged.reason)
        return state, True

    def at_rest(self, state: IdealState, now: Measured) -> bool:
        """Says so of all objects; a grasp that failed has moved none."""
        return state.outcome is Outcome.FAILED or state.rest.at_rest

    def trouble(self, state: IdealState, now: Measured) -> str:
        """Says whether the object lags too far behind."""
        if state.phase not in HOLDING:
            return ""
        name = state.action.grasp.object
        X = now.poses[name]
        p_WCom = X[:3, 3] + X[:3, :3] @ self._models[name].p_OCom
        desired, _, _ = state.segment.sample(now.time)
        lag = np.linalg.norm(desired[:3, 3] - p_WCom)
        return "could not follow" if lag > self._config.slip_distance else ""

    def _lift(self, name: str, X_WO: np.ndarray, time: float) -> Segment:
        model = self._models[name]
        start = np.array(X_WO)
        start[:3, 3] += start[:3, :3] @ model.p_OCom
        lowest = _heights(model, X_WO).min()
        top = self._bin.wall_height + LIFT_CLEARANCE + 0.01
        to = start[:3, 3] + [0.0, 0.0, max(top - lowest, 0.0)]
        return self._straight(start, to, time)

    def _straight(
        self, start: np.ndarray, to: np.ndarray, time: float
    ) -> Segment:
        return straight(start, to, time, speed=self._config.speed)

    def _drop_to(self, name: str, poses: Mapping[str, np.ndarray]) -> float:
        """Returns how far to go down to just above what is in the tote, m."""
        lowest = _heights(self._models[name], poses[name]).min()
        under = [
            _heights(self._models[other], X).max()
            for other, X in poses.items()
            if other != name and self._tote.is_under(X[:3, 3])
        ]
        return min(max(under, default=0.0) + 0.005 - lowest, 0.0)

    def _new_rest(self) -> RestTest:
        return RestTest(self._config.rest_motion, self._config.rest_round)


class QuasiStaticGripper(TransferSystem[IdealState, Measured]):
    """Lifts objects by an ideal grip, where the grasp would hold.

    .. pydrake_system::

        name: QuasiStaticGripper
        input_ports:
        - action
        - body_poses
        - body_spatial_velocities
        output_ports:
        - status
        - applied_spatial_force
        - position

    A new ``action`` (:class:`~xray_drake.messages.SearchAction`) is perturbed
    and judged. If it holds, a spring between gripper and object lifts the
    object clear of the bin through the plant's own dynamics
    (``applied_spatial_force``), waits until the rest is at rest, carries it
    over the tote, lowers and releases it. If not, nothing moves and the
    action is spent.

    ``status`` (:class:`~xray_drake.messages.GripperStatus`) is idle only when
    the heap is at rest. ``position`` (quaternion and position of the
    gripper's base, two finger joints) is for drawing: the ideal gripper has no
    body that could collide.
    """

    def __init__(
        self,
        *,
        judge: Judge,
        objects: Sequence[ObjectModel],
        bodies: Mapping[str, int],
        geometry: GripperGeometry,
        cell: Cell | None = None,
        config: QuasiStaticConfig | None = None,
        seed: int = 0,
        period: float = 0.02,
        time_step: float = 0.005,
    ) -> None:
        """Builds the gripper.

        Args:
            judge: says whether a perturbed grasp holds.
            objects: all objects of the heap.
            bodies: object name to its index in the body ports.
            geometry: of the drawn gripper.
            cell: in which it works; by default the nominal one.
            config: motions and perturbations.
            seed: of the perturbations.
            period: of the state machine, s.
            time_step: of the plant, s.
        """
        config = config or QuasiStaticConfig()
        self._models = {model.name: model for model in objects}
        actuation = IdealActuation(
            judge, self._models, cell or Cell(), config, seed
        )
        super().__init__(actuation, actuation.initial(), period=period)
        self._bodies = dict(bodies)
        self._geometry = geometry
        self._grip = Grip(
            stiffness=config.stiffness,
            damping=config.damping,
            force=config.force,
            step=time_step,
        )
        self._poses = self.declare_input("body_poses", [RigidTransform()])
        self._velocities = self.declare_input(
            "body_spatial_velocities", [SpatialVelocity.Zero()]
        )
        moving = {self._ticket, self.time_ticket(), self._poses.ticket()}
        self.DeclareAbstractOutputPort(
            "applied_spatial_force",
            alloc=lambda: Value([ExternallyAppliedSpatialForce()]),
            calc=self._calc_force,
            prerequisites_of_calc={*moving, self._velocities.ticket()},
        )
        self.DeclareVectorOutputPort(
            "position", 9, self._calc_position, prerequisites_of_calc=moving
        )

    def _measure(self, context: Context, state: IdealState) -> Measured:
        poses = self._poses.Eval(context)
        return Measured(
            context.get_time(),
            {
                name: poses[index].GetAsMatrix4()
                for name, index in self._bodies.items()
            },
        )

    def _calc_force(self, context: Context, output: AbstractValue) -> None:
        state = self.state(context)
        if state.phase not in HOLDING:
            output.set_value([])
            return
        model = self._models[state.action.grasp.object]
        index = self._bodies[model.name]
        X_WO = self._poses.Eval(context)[index]
        V_WO = self._velocities.Eval(context)[index]
        R = X_WO.rotation().matrix()
        p_OCom_W = R @ model.p_OCom
        torque, force = self._grip.wrench(
            mass=model.mass,
            inertia_W=R @ model.inertia @ R.T,
            desired=state.segment.sample(context.get_time()),
            R_WO=R,
            p_WCom=X_WO.translation() + p_OCom_W,
            w_WO=V_WO.rotational(),
            v_WCom=V_WO.Shift(p_OCom_W).translational(),
        )
        applied = ExternallyAppliedSpatialForce()
        applied.body_index = BodyIndex(index)
        applied.p_BoBq_B = model.p_OCom
        applied.F_Bq_W = SpatialForce(tau=torque, f=force)
        output.set_value([applied])

    def _calc_position(self, context: Context, output: BasicVector) -> None:
        state = self.state(context)
        grasp, closed = state.action.grasp, 0.0
        if state.phase in HOLDING:
            X_WO = self._poses.Eval(context)[self._bodies[grasp.object]]
            X_WG = X_WO.GetAsMatrix4() @ grasp.X_OG
            opening = self._geometry.open_width
            closed = (opening - min(grasp.width, opening)) / 2
        else:
            X_WG, _, _ = state.segment.sample(context.get_time())
        X_BG = self._geometry.frame(grasp.kind)
        X_WB = RigidTransform(X_WG @ np.linalg.inv(X_BG))
        output.SetFromVector(
            [
                *X_WB.rotation().ToQuaternion().wxyz(),
                *X_WB.translation(),
                closed,
                closed,
            ]
        )


def _heights(model: ObjectModel, X_WO: np.ndarray) -> np.ndarray:
    return model.visual.vertices @ X_WO[2, :3] + X_WO[2, 3]
