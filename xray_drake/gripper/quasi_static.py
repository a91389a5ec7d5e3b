"""The ideal gripper of the paper's transition model (section V.A)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Protocol

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce, SpatialVelocity
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import (
    BasicVector,
    Context,
    EventStatus,
    State,
)

from xray_drake.configuration import number
from xray_drake.grasping.judgement import JudgedGrasp
from xray_drake.grasping.perturbation import PerturbationConfig, perturb
from xray_drake.gripper.motion import Grip, Segment, straight
from xray_drake.lifetimes import CollectableLeafSystem
from xray_drake.messages import (
    Grasp,
    GraspKind,
    GripperMode,
    GripperStatus,
    Message,
    Outcome,
    SearchAction,
)
from xray_drake.scene.object_model import ObjectModel
from xray_drake.scene.plant import (
    BIN_WALL_HEIGHT,
    TOTE_POSITION,
    over_tote,
)
from xray_drake.scene.rest import RestTest, corners_in_cell
from xray_drake.seeding import stream

LIFT_CLEARANCE = 0.05
"""An object is lifted clear of the bin when it is this far over the walls, m
(PROTOCOL.md)."""

TOTE_SLOTS = tuple((x, y) for y in (0.1, 0.0, -0.1) for x in (-0.1, 0.0, 0.1))
"""Where in the tote one object after the other goes, from its centre, m."""

_HOME = np.array(
    [[1.0, 0, 0, 0.0], [0, -1.0, 0, 0.32], [0, 0, -1.0, 0.34], [0, 0, 0, 1]]
)
"""Where the drawn gripper waits: jaw down, beside the camera's view."""


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


class _Phase(Enum):
    IDLE = "idle"
    APPROACH = "approach"
    RETREAT = "retreat"
    LIFT = "lift"
    HOLD = "hold"
    CARRY = "carry"
    LOWER = "lower"
    SETTLE = "settle"


_STIRRING = (_Phase.LIFT, _Phase.HOLD)
_HOLDING = (_Phase.LIFT, _Phase.HOLD, _Phase.CARRY, _Phase.LOWER)


@dataclass(frozen=True, eq=False)
class QuasiStaticMotion(Message):
    """The gripper's state.

    ``segment`` moves the held object's centre of mass while one is held, else
    the grasp frame.
    """

    phase: _Phase
    segment: Segment
    rest: RestTest
    action: SearchAction = field(default_factory=SearchAction)
    outcome: Outcome = Outcome.NONE
    reason: str = ""
    since: float = 0.0
    carried: int = 0


@dataclass(frozen=True, eq=False)
class DrawnGripper:
    """Frames of the gripper that is drawn: 4×4 X_BJ (jaw), X_BC (cup)."""

    X_BJ: np.ndarray
    X_BC: np.ndarray
    opening: float


class QuasiStaticGripper(CollectableLeafSystem):
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
    action is spent. An object that cannot follow (wedged under others) slips.
    What has fallen out of the cell is not waited for.

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
        drawn: DrawnGripper,
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
            drawn: frames of the drawn gripper.
            config: motions and perturbations.
            seed: of the perturbations.
            period: of the state machine, s.
            time_step: of the plant, s.
        """
        super().__init__()
        self.set_name("gripper_controller")
        self._judge = judge
        self._models = {model.name: model for model in objects}
        self._bodies = dict(bodies)
        self._opening = drawn.opening
        X_JB, X_CB = np.linalg.inv(drawn.X_BJ), np.linalg.inv(drawn.X_BC)
        self._X_GB = {
            GraspKind.NONE: X_JB,
            GraspKind.JAW: X_JB,
            GraspKind.SUCTION: X_CB,
        }
        self._config = config or QuasiStaticConfig()
        self._seed = seed
        self._grip = Grip(
            stiffness=self._config.stiffness,
            damping=self._config.damping,
            force=self._config.force,
            step=time_step,
        )
        self._action = self.DeclareAbstractInputPort(
            "action", Value(SearchAction())
        )
        self._poses = self.DeclareAbstractInputPort(
            "body_poses", Value([RigidTransform()])
        )
        self._velocities = self.DeclareAbstractInputPort(
            "body_spatial_velocities", Value([SpatialVelocity.Zero()])
        )
        rest = RestTest(self._config.rest_motion, self._config.rest_round)
        home = Segment(_HOME, _HOME, 0.0, 1.0)
        self._state = self.DeclareAbstractState(
            Value(QuasiStaticMotion(_Phase.IDLE, home, rest))
        )
        ticket = self.abstract_state_ticket(self._state)
        self.DeclareAbstractOutputPort(
            "status",
            alloc=lambda: Value(GripperStatus()),
            calc=self._calc_status,
            prerequisites_of_calc={ticket},
        )
        self.DeclareAbstractOutputPort(
            "applied_spatial_force",
            alloc=lambda: Value([ExternallyAppliedSpatialForce()]),
            calc=self._calc_force,
            prerequisites_of_calc={
                ticket,
                self.time_ticket(),
                self._poses.ticket(),
                self._velocities.ticket(),
            },
        )
        self.DeclareVectorOutputPort(
            "position",
            9,
            self._calc_position,
            prerequisites_of_calc={
                ticket,
                self.time_ticket(),
                self._poses.ticket(),
            },
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(
            period_sec=period, offset_sec=0.0, update=self._update
        )

    def state(self, context: Context) -> QuasiStaticMotion:
        """Returns what it is doing, for :meth:`set_state`.

        Args:
            context: its own.
        """
        return self._motion(context)

    def set_state(
        self,
        context: Context,
        state: QuasiStaticMotion,
        *,
        action: SearchAction,
    ) -> None:
        """Lets it do what another gripper of the same heap did.

        Args:
            context: its own; changed.
            state: of the other, from :meth:`state`.
            action: that it does, with the same grasp as the other.
        """
        context.get_mutable_abstract_state(self._state).set_value(
            replace(state, action=action)
        )

    def _motion(self, context: Context) -> QuasiStaticMotion:
        return context.get_abstract_state(self._state).get_value()

    def _object_poses(self, context: Context) -> dict[str, np.ndarray]:
        poses = self._poses.Eval(context)
        return {
            name: poses[index].GetAsMatrix4()
            for name, index in self._bodies.items()
        }

    def _calc_status(self, context: Context, output: AbstractValue) -> None:
        motion = self._motion(context)
        idle = motion.phase is _Phase.IDLE
        holding = motion.phase in _HOLDING
        slipped = (
            motion.phase is _Phase.SETTLE and motion.outcome is Outcome.SLIPPED
        )
        released = motion.phase in (*_HOLDING, _Phase.SETTLE)
        name = motion.action.grasp.object
        output.set_value(
            GripperStatus(
                mode=GripperMode.IDLE if idle else GripperMode.BUSY,
                number=motion.action.number,
                outcome=motion.outcome if idle else Outcome.NONE,
                reason=motion.reason if idle else "",
                held=name if holding else "",
                stirring=motion.phase in _STIRRING or slipped,
                settling=motion.phase is _Phase.HOLD or slipped,
                loose=(name,) if released else (),
            )
        )

    def _calc_force(self, context: Context, output: AbstractValue) -> None:
        motion = self._motion(context)
        if motion.phase not in _HOLDING:
            output.set_value([])
            return
        model = self._models[motion.action.grasp.object]
        index = self._bodies[model.name]
        X_WO = self._poses.Eval(context)[index]
        V_WO = self._velocities.Eval(context)[index]
        R = X_WO.rotation().matrix()
        p_OCom_W = R @ model.p_OCom
        w = V_WO.rotational()
        torque, force = self._grip.wrench(
            mass=model.mass,
            inertia_W=R @ model.inertia @ R.T,
            desired=motion.segment.sample(context.get_time()),
            R_WO=R,
            p_WCom=X_WO.translation() + p_OCom_W,
            w_WO=w,
            v_WCom=V_WO.Shift(p_OCom_W).translational(),
        )
        applied = ExternallyAppliedSpatialForce()
        applied.body_index = BodyIndex(index)
        applied.p_BoBq_B = model.p_OCom
        applied.F_Bq_W = SpatialForce(tau=torque, f=force)
        output.set_value([applied])

    def _calc_position(self, context: Context, output: BasicVector) -> None:
        motion = self._motion(context)
        grasp = motion.action.grasp
        if motion.phase in _HOLDING:
            index = self._bodies[grasp.object]
            X_WO = self._poses.Eval(context)[index].GetAsMatrix4()
            X_WG = X_WO @ grasp.X_OG
        else:
            X_WG, _, _ = motion.segment.sample(context.get_time())
        X_WB = RigidTransform(X_WG @ self._X_GB[grasp.kind])
        opening = self._opening
        if motion.phase in _HOLDING:
            opening = min(grasp.width, opening)
        closed = (self._opening - opening) / 2
        output.SetFromVector(
            [
                *X_WB.rotation().ToQuaternion().wxyz(),
                *X_WB.translation(),
                closed,
                closed,
            ]
        )

    def _update(self, context: Context, state: State) -> EventStatus:
        motion = self._motion(context)
        time = context.get_time()
        if motion.phase is _Phase.IDLE:
            action: SearchAction = self._action.Eval(context)
            if action.number == motion.action.number:
                return EventStatus.DidNothing()
            following = self._begin(motion, action, time)
        else:
            following = self._advance(motion, self._object_poses(context), time)
        if following is motion:
            return EventStatus.DidNothing()
        state.get_mutable_abstract_state(self._state).set_value(following)
        return EventStatus.Succeeded()

    def _begin(
        self, motion: QuasiStaticMotion, action: SearchAction, time: float
    ) -> QuasiStaticMotion:
        if not action.grasp:
            return replace(
                motion,
                action=action,
                outcome=Outcome.NO_GRASP,
                reason=action.why_no_grasp,
            )
        segment = Segment(
            _HOME, action.grasp.X_WG, time, self._config.approach_time
        )
        return replace(
            motion,
            phase=_Phase.APPROACH,
            segment=segment,
            action=action,
            outcome=Outcome.NONE,
            reason="",
            since=time,
        )

    def _advance(
        self,
        motion: QuasiStaticMotion,
        poses: dict[str, np.ndarray],
        time: float,
    ) -> QuasiStaticMotion:
        grasp = motion.action.grasp
        if motion.phase in _HOLDING and self._has_slipped(motion, poses, time):
            return self._release(
                motion, poses, time, Outcome.SLIPPED, "could not follow"
            )
        if motion.phase is _Phase.APPROACH:
            if not motion.segment.is_over(time):
                return motion
            return self._try(motion, poses, time)
        if motion.phase is _Phase.RETREAT:
            if not motion.segment.is_over(time):
                return motion
            return replace(motion, phase=_Phase.IDLE)
        if motion.phase is _Phase.LIFT:
            if not motion.segment.is_over(time):
                return motion
            return replace(
                motion, phase=_Phase.HOLD, since=time, rest=self._new_rest()
            )
        if motion.phase is _Phase.HOLD:
            others = {n: X for n, X in poses.items() if n != grasp.object}
            motion = self._watch(motion, others, time)
            if not self._is_quiet(motion, time):
                return motion
            x, y = TOTE_SLOTS[motion.carried % len(TOTE_SLOTS)]
            to = np.array(motion.segment.end[:3, 3])
            to[:2] = np.array(TOTE_POSITION[:2]) + [x, y]
            return self._carry(motion, _Phase.CARRY, to, time)
        if motion.phase is _Phase.CARRY:
            if not motion.segment.is_over(time):
                return motion
            to = np.array(motion.segment.end[:3, 3])
            to[2] += self._drop_to(grasp.object, poses)
            return self._carry(motion, _Phase.LOWER, to, time)
        if motion.phase is _Phase.LOWER:
            if not motion.segment.is_over(time):
                return motion
            return self._release(motion, poses, time, Outcome.LIFTED, "")
        motion = self._watch(motion, poses, time)
        if not self._is_quiet(motion, time):
            return motion
        return replace(motion, phase=_Phase.IDLE)

    def _try(
        self,
        motion: QuasiStaticMotion,
        poses: dict[str, np.ndarray],
        time: float,
    ) -> QuasiStaticMotion:
        action = motion.action
        rng = stream(self._seed, "execution", action.number)
        X_WG, friction = perturb(action.grasp, rng, self._config.perturbation)
        judged = self._judge.judge(
            action.grasp, poses, X_WG_perturbed=X_WG, friction=friction
        )
        if judged.quality <= 0.0:
            return replace(
                motion,
                phase=_Phase.RETREAT,
                segment=self._homeward(action.grasp.X_WG, time),
                outcome=Outcome.FAILED,
                reason=judged.reason,
            )
        name = action.grasp.object
        model = self._models[name]
        start = np.array(poses[name])
        start[:3, 3] += start[:3, :3] @ model.p_OCom
        lowest = _heights(model, poses[name]).min()
        top = BIN_WALL_HEIGHT + LIFT_CLEARANCE + 0.01
        to = start[:3, 3] + [0.0, 0.0, max(top - lowest, 0.0)]
        return replace(
            motion,
            phase=_Phase.LIFT,
            segment=straight(start, to, time, speed=self._config.speed),
            since=time,
        )

    def _has_slipped(
        self,
        motion: QuasiStaticMotion,
        poses: dict[str, np.ndarray],
        time: float,
    ) -> bool:
        name = motion.action.grasp.object
        X = poses[name]
        p_WCom = X[:3, 3] + X[:3, :3] @ self._models[name].p_OCom
        desired, _, _ = motion.segment.sample(time)
        lag = np.linalg.norm(desired[:3, 3] - p_WCom)
        return bool(lag > self._config.slip_distance)

    def _carry(
        self,
        motion: QuasiStaticMotion,
        phase: _Phase,
        to: np.ndarray,
        time: float,
    ) -> QuasiStaticMotion:
        segment = straight(
            motion.segment.end, to, time, speed=self._config.speed
        )
        return replace(motion, phase=phase, segment=segment, since=time)

    def _drop_to(self, name: str, poses: dict[str, np.ndarray]) -> float:
        """Returns how far to go down to just above what is in the tote, m."""
        lowest = _heights(self._models[name], poses[name]).min()
        under = [
            _heights(self._models[other], X).max()
            for other, X in poses.items()
            if other != name and over_tote(X[:3, 3])
        ]
        return min(max(under, default=0.0) + 0.005 - lowest, 0.0)

    def _release(
        self,
        motion: QuasiStaticMotion,
        poses: dict[str, np.ndarray],
        time: float,
        outcome: Outcome,
        reason: str,
    ) -> QuasiStaticMotion:
        grasp = motion.action.grasp
        return replace(
            motion,
            phase=_Phase.SETTLE,
            segment=self._homeward(poses[grasp.object] @ grasp.X_OG, time),
            rest=self._new_rest(),
            outcome=outcome,
            reason=reason,
            since=time,
            carried=motion.carried + (outcome is Outcome.LIFTED),
        )

    def _homeward(self, X_WG: np.ndarray, time: float) -> Segment:
        return Segment(X_WG, _HOME, time, self._config.approach_time)

    def _new_rest(self) -> RestTest:
        return RestTest(self._config.rest_motion, self._config.rest_round)

    def _watch(
        self,
        motion: QuasiStaticMotion,
        poses: dict[str, np.ndarray],
        time: float,
    ) -> QuasiStaticMotion:
        points = corners_in_cell(
            (self._models[name], X_WO) for name, X_WO in poses.items()
        )
        rest = motion.rest.update(time, points)
        return motion if rest is motion.rest else replace(motion, rest=rest)

    def _is_quiet(self, motion: QuasiStaticMotion, time: float) -> bool:
        waited = time - motion.since
        return motion.rest.at_rest or waited >= self._config.rest_timeout


def _heights(model: ObjectModel, X_WO: np.ndarray) -> np.ndarray:
    return model.visual.vertices @ X_WO[2, :3] + X_WO[2, 3]
