"""How a grasp is carried out by contact: a state machine that feels."""

from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from xray_drake.configuration import number
from xray_drake.gripper.carrier import Carrier, Lag, ReachError
from xray_drake.gripper.paths import Leg, Path, stay
from xray_drake.gripper.quasi_static import TOTE_SLOTS
from xray_drake.gripper.suction import CupState
from xray_drake.gripper.yumi import YumiGripper
from xray_drake.messages import (
    Grasp,
    GraspKind,
    GripperMode,
    GripperStatus,
    Message,
    Outcome,
    SearchAction,
)
from xray_drake.scene.plant import TOTE_POSITION


@dataclass
class ExecutionConfig:
    """How grasps are carried out by contact."""

    # The tool's origin goes no faster than this, m/s, m/s².
    speed: float = number(0.8, "(0, 10]")
    acceleration: float = number(4.0, "(0, 100]")
    # Up with what has been gripped, and down with it, m/s.
    lift_speed: float = number(0.3, "(0, 10]")
    # Down to the object; and over the last stretch of it, m/s, m/s, m.
    approach_speed: float = number(0.15, "(0, 10]")
    touch_speed: float = number(0.03, "(0, 10]")
    touch_distance: float = number(0.015, "[0, 0.5]")
    # The last straight part of the approach, that planning found free, m.
    approach_distance: float = number(0.10, "(0, 1]")
    # Height of the flange on the way to the bin, to the tote and back, m; lower
    # where the carrier has no room.
    transit_height: float = number(0.46, "(0, 2]")
    # The jaw opens so much wider than the object, to each side, m.
    clearance: float = number(0.005, "[0, 0.1]")
    # Contact is felt where the carrier is pushed back with this force, N.
    contact_force: float = number(3.0, "(0, 1000]")
    # If it is felt, the grasp is tried if this little was left to go, m.
    max_retreat: float = number(0.006, "[0, 0.1]")
    # The cup is pressed on by as much, unless it seals before, m.
    cup_overtravel: float = number(0.006, "[0, 0.1]")
    # The jaw goes on by as much, unless it touches something before, as the
    # analysis assumes (JudgementConfig.overtravel): thin objects are held lower
    # on the pads, and do not slip out, m.
    jaw_overtravel: float = number(0.002, "[0, 0.1]")
    # A jaw that is closed to less than this holds nothing, m.
    empty_width: float = number(0.0005, "[0, 0.1]")
    # Vacuum at which the cup has sealed, and at which it has let go, as a share
    # of the full one.
    sealed: float = number(0.9, "(0, 1]")
    lost: float = number(0.5, "[0, 1)")
    # The jaw must stop, or the cup seal, within this time, s.
    close_timeout: float = number(3.0, "(0, 600]")
    seal_timeout: float = number(0.4, "[0, 600]")
    # The object is released this far over the height that it was gripped at, m.
    release_height: float = number(0.01, "[0, 0.5]")
    # Time to look whether the object is held, and to let it go, s.
    check_time: float = number(0.5, "[0, 60]")
    release_time: float = number(0.25, "[0, 60]")
    # At the end it waits for the cell to be at rest, at least and at most, s.
    settle_time: float = number(0.3, "[0, 60]")
    settle_timeout: float = number(3.0, "(0, 600]")
    # The carrier is stuck where it lags so far behind, m.
    stuck_distance: float = number(0.015, "(0, 1]")
    # The whole action takes no longer than this, s.
    give_up: float = number(20.0, "(0, 3600]")


class Phase(Enum):
    """What the gripper is about."""

    IDLE = "idle"
    APPROACH = "approach"
    DESCEND = "descend"
    CLOSE = "close"
    SEAL = "seal"
    LIFT = "lift"
    CHECK = "check"
    CARRY = "carry"
    LOWER = "lower"
    RELEASE = "release"
    ABORT = "abort"
    HOME = "home"
    SETTLE = "settle"


_TOUCHING = (Phase.DESCEND, Phase.CLOSE, Phase.SEAL)
_HOLDING = (Phase.LIFT, Phase.CHECK, Phase.CARRY, Phase.LOWER)
_ENDING = (Phase.IDLE, Phase.RELEASE, Phase.ABORT, Phase.HOME, Phase.SETTLE)


@dataclass(frozen=True, eq=False)
class Senses:
    """What a gripper feels of itself.

    Attributes:
        time: s.
        joints: (n,) positions of the carrier.
        desired: (n,) positions that it should have by now.
        finger: position of the fingers, 0 open, m.
        cup: the suction cup; of it only vacuum and, to say why, ``lost``.
        at_rest: nothing moves in the cell.
        velocities: (n,) that it has.
        lag_velocity: (n,) velocities that it should have, less those.
        acceleration: (n,) accelerations that it should have.
    """

    time: float
    joints: np.ndarray
    desired: np.ndarray
    finger: float
    cup: CupState
    at_rest: bool = True
    velocities: np.ndarray | None = None
    lag_velocity: np.ndarray | None = None
    acceleration: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class Motion(Message):
    """The state of the machine.

    Attributes:
        phase: what it is about.
        path: of the carrier.
        action: last taken up.
        since: when the phase began, s.
        began: when the action began, s.
        outcome: of the action, as far as it is known.
        reason: for a failure.
        goal: (n,) joint positions of the grasp.
        descent: (n,) joint positions on the way to it: before it, where the
            carrier slows down, and beyond it.
        finger: position commanded to the fingers, m.
        finger_rate: its rate, m/s.
        finger_target: where it goes, m; beyond ``closed`` for a squeeze.
        still: position at which the fingers were last seen to move, m.
        still_since: when, s.
        suction: air is drawn.
        carried: objects brought to the tote.
    """

    phase: Phase
    path: Path
    action: SearchAction = field(default_factory=SearchAction)
    since: float = 0.0
    began: float = 0.0
    outcome: Outcome = Outcome.NONE
    reason: str = ""
    goal: np.ndarray = field(default_factory=lambda: np.zeros(0))
    descent: tuple[np.ndarray, ...] = ()
    finger: float = 0.0
    finger_rate: float = 0.0
    finger_target: float = 0.0
    still: float = 0.0
    still_since: float = 0.0
    suction: bool = False
    carried: int = 0


class GraspExecution:
    """Carries out one grasp after the other.

    Idle; approach (to above the grasp, the fingers opening); descend (straight,
    guarded: it stops when it touches); close or seal; lift; check; carry;
    lower (guarded, too); release; home; settle. Where something fails, abort:
    back the way it came, and home. What it knows of the world is what
    :class:`Senses` has.
    """

    def __init__(
        self,
        gripper: YumiGripper,
        config: ExecutionConfig | None = None,
        *,
        force: float = 20.0,
    ) -> None:
        """Builds the machine.

        Args:
            gripper: limits and frames; the plant is not touched.
            config: how it moves and when it gives up.
            force: squeeze of each finger, N; no more than it can.
        """
        self._gripper = gripper
        self._config = config or ExecutionConfig()
        self._force = min(force, gripper.finger_force)
        self._carrier: Carrier = gripper.carrier.slowed(
            self._config.acceleration
        )
        self._transit = min(self._config.transit_height, self._carrier.highest)
        self._X_GB = {
            GraspKind.JAW: np.linalg.inv(gripper.X_BJ),
            GraspKind.SUCTION: np.linalg.inv(gripper.X_BC),
        }

    def rest(self) -> Motion:
        """Returns the machine at home."""
        return Motion(Phase.IDLE, stay(self._gripper.home, 0.0, 0.01))

    def status(self, motion: Motion) -> GripperStatus:
        """Returns what the policy and the monitor are told."""
        phase = motion.phase
        idle = phase is Phase.IDLE
        failed = motion.outcome in (Outcome.FAILED, Outcome.SLIPPED)
        resting = phase is Phase.CHECK or (phase is Phase.SETTLE and failed)
        stirring = (
            phase in (*_TOUCHING, Phase.LIFT, Phase.ABORT)
            or resting
            or (phase is Phase.HOME and failed)
        )
        name = motion.action.grasp.object
        away = idle or phase is Phase.APPROACH
        return GripperStatus(
            mode=GripperMode.IDLE if idle else GripperMode.BUSY,
            number=motion.action.number,
            outcome=motion.outcome if idle else Outcome.NONE,
            reason=motion.reason if idle else "",
            held=name if phase in _HOLDING else "",
            stirring=stirring,
            settling=resting,
            loose=() if away else (name,),
        )

    def begin(
        self, motion: Motion, action: SearchAction, senses: Senses
    ) -> Motion:
        """Takes up an action."""
        motion = replace(
            motion,
            action=action,
            began=senses.time,
            outcome=Outcome.NONE,
            reason="",
        )
        grasp = action.grasp
        if not grasp:
            return replace(
                motion,
                outcome=Outcome.NO_GRASP,
                reason=action.why_no_grasp,
            )
        carrier, home = self._carrier, self._gripper.home
        config, suction = self._config, grasp.kind is GraspKind.SUCTION
        beyond = config.cup_overtravel if suction else config.jaw_overtravel
        poses = [
            self._pose(grasp, advance)
            for advance in (
                beyond,
                0.0,
                -config.touch_distance,
                -config.approach_distance,
            )
        ]
        above = np.array(poses[-1])
        above[2, 3] = self._transit
        try:
            last, goal, touch, back, over = carrier.along(
                [*poses, above], near=home
            )
            motion = replace(motion, goal=goal, descent=(back, touch, last))
            self._above_tote(motion, over)
            rise = carrier.at_height(home, self._transit)
            motion = self._go(
                motion,
                Phase.APPROACH,
                [Leg(rise, free=True), Leg(over, config.speed, free=True)],
                senses,
                start=motion.path.end,
            )
        except ReachError as error:
            return replace(motion, outcome=Outcome.FAILED, reason=str(error))
        travel = self._gripper.finger_travel
        opening = grasp.width + 2 * self._config.clearance
        target = travel
        if grasp.kind is GraspKind.JAW:
            target = max(travel - 0.5 * opening, 0.0)
        return replace(motion, finger_target=target)

    def advance(self, motion: Motion, senses: Senses, elapsed: float) -> Motion:
        """Returns the machine a moment later.

        Args:
            motion: before.
            senses: now.
            elapsed: since the last call, s.
        """
        motion = self._move_fingers(motion, senses, elapsed)
        phase = motion.phase
        if phase is Phase.IDLE:
            return motion
        if phase not in _ENDING:
            lost = self._lost(motion, senses)
            if lost and phase is Phase.LOWER:  # It fell into the tote.
                return self._set_down(motion, senses)
            trouble = lost or self._trouble(motion, senses)
            if trouble:
                return self._abort(motion, senses, trouble)
        step = {
            Phase.APPROACH: self._approach,
            Phase.DESCEND: self._descend,
            Phase.CLOSE: self._close,
            Phase.SEAL: self._seal,
            Phase.LIFT: self._lift,
            Phase.CHECK: self._check,
            Phase.CARRY: self._carry,
            Phase.LOWER: self._lower,
            Phase.RELEASE: self._release,
            Phase.ABORT: self._retreat,
            Phase.HOME: self._home,
            Phase.SETTLE: self._settle,
        }[phase]
        try:
            return step(motion, senses)
        except ReachError as error:
            return self._abort(motion, senses, str(error))

    # What it feels.

    def width(self, senses: Senses) -> float:
        """Returns the distance of the pads, m."""
        return 2.0 * (self._gripper.finger_travel - senses.finger)

    def felt(self, motion: Motion, senses: Senses) -> float:
        """Returns the force against the way the tool goes, N."""
        none = np.zeros(len(senses.joints))
        lag = Lag(
            q=senses.joints,
            v=none if senses.velocities is None else senses.velocities,
            position=senses.desired - senses.joints,
            velocity=none
            if senses.lag_velocity is None
            else senses.lag_velocity,
            acceleration=none
            if senses.acceleration is None
            else senses.acceleration,
        )
        force = self._carrier.force(lag)
        return float(force @ self._direction(motion))

    def _direction(self, motion: Motion) -> np.ndarray:
        if motion.phase is Phase.LOWER:
            return np.array([0.0, 0.0, -1.0])
        return motion.action.grasp.X_WG[:3, 2]

    def _trouble(self, motion: Motion, senses: Senses) -> str:
        """Returns why the action cannot go on, or nothing."""
        if senses.time - motion.began > self._config.give_up:
            return f"gave up after {self._config.give_up:g} s"
        lag = self._at(senses.desired) - self._at(senses.joints)
        if np.linalg.norm(lag) > self._config.stuck_distance:
            return f"the {self._carrier.name} is stuck"
        return ""

    def _lost(self, motion: Motion, senses: Senses) -> str:
        """Returns why it does not hold any more what it held, or nothing."""
        if motion.phase not in _HOLDING:
            return ""
        if motion.action.grasp.kind is GraspKind.SUCTION:
            if senses.cup.vacuum < self._config.lost:
                return senses.cup.lost or "the vacuum is gone"
        elif self.width(senses) < self._config.empty_width:
            return "it slipped out of the jaw"
        return ""

    # What it does.

    def _pose(self, grasp: Grasp, advance: float) -> np.ndarray:
        """Returns X_WT at a grasp, or before or beyond it (m)."""
        X_WG = np.array(grasp.X_WG)
        X_WG[:3, 3] += advance * X_WG[:3, 2]
        return X_WG @ self._X_GB[grasp.kind]

    def _at(self, q: np.ndarray) -> np.ndarray:
        """Returns where the tool's origin is, (3,), m."""
        return self._carrier.pose(q)[:3, 3]

    def _above_tote(self, motion: Motion, q: np.ndarray) -> np.ndarray:
        """Returns joint positions with what is held above its place."""
        slot = TOTE_SLOTS[motion.carried % len(TOTE_SLOTS)]
        X_TG = np.linalg.inv(self._X_GB[motion.action.grasp.kind])
        return self._carrier.over(
            q,
            X_TG[:3, 3],
            np.array(TOTE_POSITION[:2]) + slot,
            lowest=self._release_height(motion),
        )

    def _release_height(self, motion: Motion) -> float:
        """Returns the height of the tool's origin at which it lets go, m."""
        return self._at(motion.goal)[2] + self._config.release_height

    def _go(
        self,
        motion: Motion,
        phase: Phase,
        legs: list[Leg],
        senses: Senses,
        *,
        start: np.ndarray,
    ) -> Motion:
        path = self._carrier.path(start, legs, senses.time)
        return replace(motion, phase=phase, path=path, since=senses.time)

    def _wait(self, motion: Motion, phase: Phase, senses: Senses) -> Motion:
        """Stops where the carrier is."""
        return replace(
            motion,
            phase=phase,
            path=stay(senses.joints, senses.time, 0.01),
            since=senses.time,
            still=senses.finger,
            still_since=senses.time,
        )

    def _over(self, motion: Motion, senses: Senses) -> bool:
        return senses.time >= motion.path.end_time

    def _move_fingers(
        self, motion: Motion, senses: Senses, elapsed: float
    ) -> Motion:
        gripper = self._gripper
        step = gripper.finger_speed * elapsed
        lead = self._force / gripper.finger_stiffness
        to = min(motion.finger_target, senses.finger + lead)
        change = float(np.clip(to - motion.finger, -step, step))
        finger = motion.finger + change
        rate = change / elapsed if abs(change) > 0.99 * step else 0.0
        if finger == motion.finger and rate == motion.finger_rate:
            return motion
        return replace(motion, finger=finger, finger_rate=rate)

    def _approach(self, motion: Motion, senses: Senses) -> Motion:
        ready = abs(senses.finger - motion.finger_target) < 0.001
        if not (self._over(motion, senses) and ready):
            return motion
        config = self._config
        suction = motion.action.grasp.kind is GraspKind.SUCTION
        back, touch, last = motion.descent
        legs = [
            Leg(back, config.speed),
            Leg(touch, config.approach_speed),
            Leg(last, config.touch_speed),
        ]
        motion = replace(motion, suction=suction)
        return self._go(
            motion, Phase.DESCEND, legs, senses, start=motion.path.end
        )

    def _descend(self, motion: Motion, senses: Senses) -> Motion:
        suction = motion.action.grasp.kind is GraspKind.SUCTION
        following = Phase.SEAL if suction else Phase.CLOSE
        if suction and senses.cup.vacuum > 0.0:
            return self._wait(motion, following, senses)
        if self._over(motion, senses):
            return self._wait(motion, following, senses)
        if self.felt(motion, senses) < self._config.contact_force:
            return motion
        way = self._at(motion.goal) - self._at(senses.joints)
        way = float(way @ self._direction(motion))
        if way > self._config.max_retreat:
            return self._abort(
                motion, senses, f"stopped {1e3 * way:.0f} mm before the grasp"
            )
        return self._wait(motion, following, senses)

    def _close(self, motion: Motion, senses: Senses) -> Motion:
        travel = self._gripper.finger_travel
        if motion.finger_target < 2 * travel:
            return replace(motion, finger_target=np.inf)
        if self.width(senses) < self._config.empty_width:
            return self._abort(motion, senses, "the jaw closed on nothing")
        if abs(senses.finger - motion.still) > 2e-4:
            motion = replace(
                motion, still=senses.finger, still_since=senses.time
            )
        squeeze = motion.finger - senses.finger
        full = 0.8 * self._force / self._gripper.finger_stiffness
        if senses.time - motion.still_since > 0.1 and squeeze > full:
            return self._raise(motion, senses)
        if senses.time - motion.since > self._config.close_timeout:
            return self._abort(motion, senses, "the jaw does not come to rest")
        return motion

    def _seal(self, motion: Motion, senses: Senses) -> Motion:
        if senses.cup.vacuum > self._config.sealed:
            return self._raise(motion, senses)
        if senses.time - motion.since > self._config.seal_timeout:
            return self._abort(
                motion, senses, senses.cup.lost or "the cup does not seal"
            )
        return motion

    def _raise(self, motion: Motion, senses: Senses) -> Motion:
        start = motion.path.end
        top = self._carrier.at_height(
            start, max(self._transit, self._at(start)[2])
        )
        return self._go(
            motion,
            Phase.LIFT,
            [Leg(top, self._config.lift_speed)],
            senses,
            start=start,
        )

    def _lift(self, motion: Motion, senses: Senses) -> Motion:
        if not self._over(motion, senses):
            return motion
        return replace(motion, phase=Phase.CHECK, since=senses.time)

    def _check(self, motion: Motion, senses: Senses) -> Motion:
        if senses.time - motion.since < self._config.check_time:
            return motion
        to = self._above_tote(motion, motion.path.end)
        return self._go(
            motion,
            Phase.CARRY,
            [Leg(to, self._config.speed, free=True)],
            senses,
            start=motion.path.end,
        )

    def _carry(self, motion: Motion, senses: Senses) -> Motion:
        if not self._over(motion, senses):
            return motion
        start = motion.path.end
        height = min(self._at(start)[2], self._release_height(motion))
        to = self._carrier.at_height(start, height)
        return self._go(
            motion,
            Phase.LOWER,
            [Leg(to, self._config.lift_speed)],
            senses,
            start=start,
        )

    def _lower(self, motion: Motion, senses: Senses) -> Motion:
        felt = self.felt(motion, senses) > self._config.contact_force
        if felt or self._over(motion, senses):
            return self._set_down(motion, senses)
        return motion

    def _set_down(self, motion: Motion, senses: Senses) -> Motion:
        motion = self._wait(motion, Phase.RELEASE, senses)
        jaw = motion.action.grasp.kind is GraspKind.JAW
        return replace(
            motion,
            suction=False,
            finger_target=0.0 if jaw else motion.finger_target,
            outcome=Outcome.LIFTED,
            carried=motion.carried + 1,
        )

    def _release(self, motion: Motion, senses: Senses) -> Motion:
        if senses.time - motion.since < self._config.release_time:
            return motion
        return self._homeward(motion, senses)

    def _abort(self, motion: Motion, senses: Senses, reason: str) -> Motion:
        """Goes back the way it came, if it is still down, and gives up."""
        holding = motion.phase in _HOLDING
        legs = []
        if motion.phase in _TOUCHING:
            back, *_ = motion.descent
            height = max(self._at(back)[2], self._at(senses.joints)[2])
            back = self._carrier.at_height(back, height)
            legs.append(Leg(back, self._config.lift_speed, free=True))
        else:
            legs.append(Leg(senses.joints, self._config.lift_speed, free=True))
        motion = self._go(
            motion, Phase.ABORT, legs, senses, start=senses.joints
        )
        return replace(
            motion,
            outcome=Outcome.SLIPPED if holding else Outcome.FAILED,
            reason=reason,
            suction=False,
            finger_target=0.0 if holding else senses.finger,
        )

    def _retreat(self, motion: Motion, senses: Senses) -> Motion:
        if not self._over(motion, senses):
            return motion
        return self._homeward(motion, senses)

    def _homeward(self, motion: Motion, senses: Senses) -> Motion:
        start, home = motion.path.end, self._gripper.home
        height = max(self._transit, self._at(start)[2])
        up = self._carrier.at_height(start, height)
        across = self._carrier.at_height(home, height)
        speed = self._config.speed
        legs = [Leg(up, speed), Leg(across, speed), Leg(home, speed)]
        return self._go(
            motion,
            Phase.HOME,
            [replace(leg, free=True) for leg in legs],
            senses,
            start=start,
        )

    def _home(self, motion: Motion, senses: Senses) -> Motion:
        if motion.finger_target != 0.0 and (
            self._at(senses.joints)[2] > self._transit - 0.01
        ):
            motion = replace(motion, finger_target=0.0)
        if not self._over(motion, senses):
            return motion
        return replace(motion, phase=Phase.SETTLE, since=senses.time)

    def _settle(self, motion: Motion, senses: Senses) -> Motion:
        waited = senses.time - motion.since
        rests = senses.at_rest and waited >= self._config.settle_time
        if not rests and waited < self._config.settle_timeout:
            return motion
        return replace(motion, phase=Phase.IDLE, since=senses.time)
