"""How a grasp is carried out by contact: guarded motion, pads and cup."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from xray_drake.cell.bin import Tote
from xray_drake.configuration import in_order, number
from xray_drake.gripper.carriers.carrier import Carrier, Tracking
from xray_drake.gripper.carriers.paths import Leg, Path, stay
from xray_drake.gripper.mounted import MountedGripper
from xray_drake.gripper.suction import CupState
from xray_drake.gripper.transfer import (
    Actuation,
    Phase,
    TransferError,
    TransferState,
)
from xray_drake.messages import Grasp, GraspKind, Outcome


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

    def complaints(self) -> Iterator[str]:
        """Yields what is wrong between its fields."""
        yield from in_order(self, "lost", "sealed")


class Step(Enum):
    """The steps of a grasp by contact."""

    NONE = "none"
    DESCEND = "descend"
    CLOSE = "close"


@dataclass(frozen=True, eq=False)
class Measured:
    """What a gripper measures of itself.

    Attributes:
        time: s.
        tracking: positions and velocities of the carrier's joints.
        finger: position of the fingers, 0 open, m.
        cup: the suction cup; of it only vacuum and, to say why, ``lost``.
        at_rest: nothing moves in the cell.
    """

    time: float
    tracking: Tracking
    finger: float
    cup: CupState
    at_rest: bool = True


@dataclass(frozen=True, eq=False, kw_only=True)
class ContactState(TransferState):
    """The state of a transfer by contact.

    Attributes:
        path: of the carrier.
        step: of the grasp.
        goal: (n,) joint positions of the grasp.
        descent: (n,) joint positions on the way to it: before it, where the
            carrier slows down, and beyond it.
        finger: position commanded to the fingers, m.
        finger_rate: its rate, m/s.
        finger_target: where it goes, m; beyond ``closed`` for a squeeze.
        still: position at which the fingers were last seen to move, m.
        still_since: when, s.
        suction: air is drawn.
    """

    path: Path
    step: Step = Step.NONE
    goal: np.ndarray = field(default_factory=lambda: np.zeros(0))
    descent: tuple[np.ndarray, ...] = ()
    finger: float = 0.0
    finger_rate: float = 0.0
    finger_target: float = 0.0
    still: float = 0.0
    still_since: float = 0.0
    suction: bool = False


class ContactActuation(Actuation[ContactState, Measured]):
    """Moves a carrier, closes pads, and seals a cup.

    It approaches to above the grasp, while the fingers open; descends straight
    and guarded: it stops when it touches; closes or seals. It lowers guarded,
    too. What it knows of the world is what :class:`Measured` has.
    """

    touches = True

    def __init__(
        self,
        gripper: MountedGripper,
        tote: Tote,
        config: ExecutionConfig | None = None,
        *,
        force: float | None = None,
        period: float = 0.01,
    ) -> None:
        """Builds it.

        Args:
            gripper: limits and frames; the plant is not touched.
            tote: where objects are put down.
            config: how it moves and when it gives up.
            force: squeeze of each finger, N; by default, and at most, all
                that it can.
            period: between two updates, s.
        """
        self._gripper = gripper
        self._tote = tote
        self._config = config = config or ExecutionConfig()
        most = gripper.finger_force
        self._force = most if force is None else min(force, most)
        self._period = period
        self._carrier: Carrier = gripper.carrier
        self._transit = min(config.transit_height, self._carrier.highest)
        self._X_GB = {GraspKind.JAW: np.linalg.inv(gripper.X_BJ)}
        if gripper.X_BC is not None:
            self._X_GB[GraspKind.SUCTION] = np.linalg.inv(gripper.X_BC)
        self.waits = {
            Phase.CHECK: (config.check_time, config.check_time),
            Phase.RELEASE: (config.release_time, config.release_time),
            Phase.SETTLE: (config.settle_time, config.settle_timeout),
        }

    def initial(self) -> ContactState:
        """Returns the state at home."""
        return ContactState(path=stay(self._carrier.home, 0.0, 0.01))

    def update(self, state: ContactState, now: Measured) -> ContactState:
        """Moves the fingers; opens them when they are high on the way home."""
        gripper = self._gripper
        step = gripper.finger_speed * self._period
        lead = self._force / gripper.finger_stiffness
        to = min(state.finger_target, now.finger + lead)
        change = float(np.clip(to - state.finger, -step, step))
        finger = state.finger + change
        rate = change / self._period if abs(change) > 0.99 * step else 0.0
        if finger != state.finger or rate != state.finger_rate:
            state = replace(state, finger=finger, finger_rate=rate)
        high = self._transit - 0.01
        if (
            state.phase is Phase.HOME
            and state.finger_target != 0.0
            and self._at(now.tracking.q)[2] > high
        ):
            state = replace(state, finger_target=0.0)
        return state

    def move(self, state: ContactState, now: Measured) -> ContactState:
        """Returns the state with the path of a phase that moves."""
        begin = {
            Phase.APPROACH: self._approach,
            Phase.LIFT: self._lift,
            Phase.CARRY: self._carry,
            Phase.LOWER: self._lower,
            Phase.RELEASE: self._release,
            Phase.ABORT: self._retreat,
            Phase.HOME: self._homeward,
        }.get(state.phase)
        return begin(state, now) if begin else state

    def arrived(self, state: ContactState, now: Measured) -> bool:
        """Says whether the path is over, or what is lowered touches."""
        over = now.time >= state.path.end_time
        if state.phase is Phase.APPROACH:
            ready = abs(now.finger - state.finger_target) < 0.001
            return over and ready
        if state.phase is Phase.LOWER:
            down = np.array([0.0, 0.0, -1.0])
            limit = self._config.contact_force
            return over or self._contact_force(now, down) > limit
        return over

    def grasp(
        self, state: ContactState, now: Measured
    ) -> tuple[ContactState, bool]:
        """Descends until it touches, then closes the jaw or seals the cup."""
        suction = state.action.grasp.kind is GraspKind.SUCTION
        if state.step is Step.NONE:
            config = self._config
            back, touch, last = state.descent
            legs = (
                Leg(back, config.speed),
                Leg(touch, config.approach_speed),
                Leg(last, config.touch_speed),
            )
            state = self._go(state, now, *legs)
            return replace(state, step=Step.DESCEND, suction=suction), False
        if state.step is Step.DESCEND:
            return self._descend(state, now, suction), False
        if suction:
            return state, self._seals(state, now)
        return self._close(state, now)

    def at_rest(self, state: ContactState, now: Measured) -> bool:
        """Says so of the cell."""
        return now.at_rest

    def lost(self, state: ContactState, now: Measured) -> str:
        """Says why jaw or cup are empty."""
        if state.action.grasp.kind is GraspKind.SUCTION:
            if now.cup.vacuum < self._config.lost:
                return now.cup.lost or "the vacuum is gone"
        elif self._width(now) < self._config.empty_width:
            return "it slipped out of the jaw"
        return ""

    def trouble(self, state: ContactState, now: Measured) -> str:
        """Says whether time is over, or the carrier does not follow."""
        config, tracking = self._config, now.tracking
        if now.time - state.began > config.give_up:
            return f"gave up after {config.give_up:g} s"
        lag = self._at(tracking.q_desired) - self._at(tracking.q)
        if np.linalg.norm(lag) > config.stuck_distance:
            return f"the {self._carrier.name} is stuck"
        return ""

    # What it measures.

    def _width(self, now: Measured) -> float:
        """Returns the distance of the pads, m."""
        return 2.0 * (self._gripper.finger_travel - now.finger)

    def _contact_force(self, now: Measured, direction: np.ndarray) -> float:
        """Returns the force against a direction in the world, N."""
        return float(self._carrier.force(now.tracking) @ direction)

    def _at(self, q: np.ndarray) -> np.ndarray:
        """Returns where the tool's origin is, (3,), m."""
        return self._carrier.pose(q)[:3, 3]

    # The grasp.

    def _descend(
        self, state: ContactState, now: Measured, suction: bool
    ) -> ContactState:
        sealing = suction and now.cup.vacuum > 0.0
        if not sealing and now.time < state.path.end_time:
            direction, config = state.action.grasp.X_WG[:3, 2], self._config
            if self._contact_force(now, direction) < config.contact_force:
                return state
            left = self._at(state.goal) - self._at(now.tracking.q)
            left = float(left @ direction)
            if left > config.max_retreat:
                raise TransferError(
                    f"stopped {1e3 * left:.0f} mm before the grasp"
                )
        return replace(self._wait(state, now), step=Step.CLOSE, since=now.time)

    def _close(
        self, state: ContactState, now: Measured
    ) -> tuple[ContactState, bool]:
        gripper = self._gripper
        if state.finger_target < 2 * gripper.finger_travel:
            return replace(state, finger_target=np.inf), False
        if self._width(now) < self._config.empty_width:
            raise TransferError("the jaw closed on nothing")
        time, finger = now.time, now.finger
        if abs(finger - state.still) > 2e-4:
            state = replace(state, still=finger, still_since=time)
        squeeze = state.finger - finger
        full = 0.8 * self._force / gripper.finger_stiffness
        if time - state.still_since > 0.1 and squeeze > full:
            return state, True
        if time - state.since > self._config.close_timeout:
            raise TransferError("the jaw does not come to rest")
        return state, False

    def _seals(self, state: ContactState, now: Measured) -> bool:
        if now.cup.vacuum > self._config.sealed:
            return True
        if now.time - state.since > self._config.seal_timeout:
            raise TransferError(now.cup.lost or "the cup does not seal")
        return False

    # Paths.

    def _go(
        self,
        state: ContactState,
        now: Measured,
        *legs: Leg,
        start: np.ndarray | None = None,
    ) -> ContactState:
        """Sets out along legs, from the end of the last path by default."""
        start = state.path.end if start is None else start
        path = self._carrier.path(
            start, legs, now.time, acceleration=self._config.acceleration
        )
        return replace(state, path=path)

    def _wait(self, state: ContactState, now: Measured) -> ContactState:
        """Stops where the carrier is."""
        time = now.time
        return replace(
            state,
            path=stay(now.tracking.q, time, 0.01),
            still=now.finger,
            still_since=time,
        )

    def _approach(self, state: ContactState, now: Measured) -> ContactState:
        config, gripper = self._config, self._gripper
        grasp, home = state.action.grasp, gripper.carrier.home
        suction = grasp.kind is GraspKind.SUCTION
        if grasp.kind not in self._X_GB:
            raise TransferError("the gripper has no suction cup")
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
        last, goal, touch, back, over = self._carrier.along(
            [*poses, above], near=home
        )
        shut = gripper.finger_travel
        opening = grasp.width + 2 * config.clearance
        state = replace(
            state,
            step=Step.NONE,
            goal=goal,
            descent=(back, touch, last),
            finger_target=shut if suction else max(shut - 0.5 * opening, 0.0),
        )
        self._over_tote(state, over)  # Or it could not be brought there.
        rise = self._carrier.at_height(home, self._transit)
        legs = Leg(rise, free=True), Leg(over, config.speed, free=True)
        return self._go(state, now, *legs)

    def _pose(self, grasp: Grasp, advance: float) -> np.ndarray:
        """Returns X_WT at a grasp, or before or beyond it (m)."""
        X_WG = np.array(grasp.X_WG)
        X_WG[:3, 3] += advance * X_WG[:3, 2]
        return X_WG @ self._X_GB[grasp.kind]

    def _over_tote(self, state: ContactState, q: np.ndarray) -> np.ndarray:
        """Returns joint positions with what is held above its place."""
        X_TG = np.linalg.inv(self._X_GB[state.action.grasp.kind])
        return self._carrier.over(
            q,
            X_TG[:3, 3],
            self._tote.slot(state.carried),
            lowest=self._release_height(state),
        )

    def _release_height(self, state: ContactState) -> float:
        """Returns the height of the tool's origin at which it lets go, m."""
        return self._at(state.goal)[2] + self._config.release_height

    def _lift(self, state: ContactState, now: Measured) -> ContactState:
        start = state.path.end
        height = max(self._transit, self._at(start)[2])
        top = self._carrier.at_height(start, height)
        state = replace(state, step=Step.NONE)
        return self._go(state, now, Leg(top, self._config.lift_speed))

    def _carry(self, state: ContactState, now: Measured) -> ContactState:
        to = self._over_tote(state, state.path.end)
        leg = Leg(to, self._config.speed, free=True)
        return self._go(state, now, leg)

    def _lower(self, state: ContactState, now: Measured) -> ContactState:
        start = state.path.end
        height = min(self._at(start)[2], self._release_height(state))
        to = self._carrier.at_height(start, height)
        return self._go(state, now, Leg(to, self._config.lift_speed))

    def _release(self, state: ContactState, now: Measured) -> ContactState:
        jaw = state.action.grasp.kind is GraspKind.JAW
        return replace(
            self._wait(state, now),
            suction=False,
            finger_target=0.0 if jaw else state.finger_target,
        )

    def _retreat(self, state: ContactState, now: Measured) -> ContactState:
        """Goes back the way it came, if it is still down, and gives up."""
        q = to = now.tracking.q
        if state.step is not Step.NONE:
            back, *_ = state.descent
            height = max(self._at(back)[2], self._at(q)[2])
            to = self._carrier.at_height(back, height)
        leg = Leg(to, self._config.lift_speed, free=True)
        dropped = state.outcome is Outcome.SLIPPED
        return replace(
            self._go(state, now, leg, start=q),
            suction=False,
            finger_target=0.0 if dropped else now.finger,
        )

    def _homeward(self, state: ContactState, now: Measured) -> ContactState:
        start, home = state.path.end, self._gripper.carrier.home
        height = max(self._transit, self._at(start)[2])
        up = self._carrier.at_height(start, height)
        across = self._carrier.at_height(home, height)
        legs = (
            Leg(q, self._config.speed, free=True) for q in (up, across, home)
        )
        return self._go(state, now, *legs)
