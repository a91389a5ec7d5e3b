"""How an object gets from the bin to the tote: the one state machine."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Generic, Protocol, TypeVar

from xray_drake.messages import (
    GripperMode,
    GripperStatus,
    Message,
    Outcome,
    SearchAction,
)

LIFT_CLEARANCE = 0.05
"""An object is lifted clear of the bin when it is this far over the walls, m
(PROTOCOL.md)."""


class TransferError(ValueError):
    """An attempt that fails; the message is one line."""


class Phase(Enum):
    """The phases of a transfer."""

    IDLE = "idle"
    APPROACH = "approach"
    GRASP = "grasp"
    LIFT = "lift"
    CHECK = "check"
    CARRY = "carry"
    LOWER = "lower"
    RELEASE = "release"
    ABORT = "abort"
    HOME = "home"
    SETTLE = "settle"


HOLDING = (Phase.LIFT, Phase.CHECK, Phase.CARRY, Phase.LOWER)
"""The phases in which an object is held."""

_TRYING = (Phase.APPROACH, Phase.GRASP, *HOLDING)
_NEXT = {
    Phase.APPROACH: Phase.GRASP,
    Phase.LIFT: Phase.CHECK,
    Phase.CHECK: Phase.CARRY,
    Phase.CARRY: Phase.LOWER,
    Phase.LOWER: Phase.RELEASE,
    Phase.RELEASE: Phase.HOME,
    Phase.ABORT: Phase.HOME,
    Phase.HOME: Phase.SETTLE,
    Phase.SETTLE: Phase.IDLE,
}


@dataclass(frozen=True, eq=False)
class TransferState(Message):
    """The state of a transfer; actuations add their own.

    Attributes:
        phase: what the gripper is doing.
        action: last taken up.
        since: when the phase began, s.
        began: when the action began, s.
        outcome: of the action, as far as it is known.
        reason: for a failure.
        carried: number of objects brought to the tote.
    """

    phase: Phase = Phase.IDLE
    action: SearchAction = field(default_factory=SearchAction)
    since: float = 0.0
    began: float = 0.0
    outcome: Outcome = Outcome.NONE
    reason: str = ""
    carried: int = 0


class Timed(Protocol):
    """What an actuation measures at one instant; each adds its own."""

    @property
    def time(self) -> float:
        """The time, s."""


S = TypeVar("S", bound=TransferState)
M = TypeVar("M", bound=Timed)


class Actuation(ABC, Generic[S, M]):
    """Moves, grasps and measures for a transfer.

    All methods are functions of the state and of what is measured.

    Attributes:
        waits: phases of waiting: they last until all is at rest, at least and
            at most for this time, s.
        touches: a grasp that fails may have moved objects.
    """

    waits: Mapping[Phase, tuple[float, float]]
    touches: bool

    @abstractmethod
    def update(self, state: S, now: M) -> S:
        """Returns the state a period later, before any change of phase."""

    @abstractmethod
    def move(self, state: S, now: M) -> S:
        """Returns the state with the motion of the phase that begins.

        Raises:
            TransferError: there is no such motion.
        """

    @abstractmethod
    def arrived(self, state: S, now: M) -> bool:
        """Says whether the motion of the phase is over."""

    @abstractmethod
    def grasp(self, state: S, now: M) -> tuple[S, bool]:
        """Goes on with the grasp; returns the state, and whether it holds.

        Raises:
            TransferError: the grasp has failed.
        """

    @abstractmethod
    def at_rest(self, state: S, now: M) -> bool:
        """Says whether all that may move is at rest."""

    def lost(self, state: S, now: M) -> str:
        """Returns why what was held is not held any more, or nothing."""
        return ""

    def trouble(self, state: S, now: M) -> str:
        """Returns why the action cannot go on, or nothing."""
        return ""


class Transfer(Generic[S, M]):
    """Carries out one action after the other.

    Idle; approach; grasp; lift; check that it holds; carry it over the tote;
    lower; release; home; settle. Where something fails, abort: back, home, and
    settle. What falls while it is lowered has arrived.
    """

    def __init__(self, actuation: Actuation[S, M]) -> None:
        """Takes what moves, grasps and measures."""
        self._actuation = actuation

    def begin(self, state: S, action: SearchAction, now: M) -> S:
        """Takes up an action; ``state`` is idle."""
        state = replace(
            state,
            action=action,
            began=now.time,
            outcome=Outcome.NONE,
            reason="",
        )
        if not action.grasp:
            return replace(
                state, outcome=Outcome.NO_GRASP, reason=action.why_no_grasp
            )
        try:
            return self._enter(state, Phase.APPROACH, now)
        except TransferError as error:
            return replace(state, outcome=Outcome.FAILED, reason=str(error))

    def advance(self, state: S, now: M) -> S:
        """Returns the state a period later."""
        state = self._actuation.update(state, now)
        while True:
            try:
                following = self._step(state, now)
            except TransferError as error:
                following = self._abort(state, now, str(error))
            if following.phase is state.phase:
                return following
            state = following

    def status(self, state: S) -> GripperStatus:
        """Returns what the policy and the monitor are told."""
        phase, outcome = state.phase, state.outcome
        idle, name = phase is Phase.IDLE, state.action.grasp.object
        failed = outcome in (Outcome.FAILED, Outcome.SLIPPED)
        if outcome is Outcome.FAILED and not self._actuation.touches:
            phase, failed = Phase.APPROACH, False
        settling = phase is Phase.CHECK or (phase is Phase.SETTLE and failed)
        return GripperStatus(
            mode=GripperMode.IDLE if idle else GripperMode.BUSY,
            number=state.action.number,
            outcome=outcome if idle else Outcome.NONE,
            reason=state.reason if idle else "",
            held=name if phase in HOLDING else "",
            stirring=settling
            or phase in (Phase.GRASP, Phase.LIFT, Phase.ABORT)
            or (phase is Phase.HOME and failed),
            settling=settling,
            loose=()
            if idle or phase in (Phase.IDLE, Phase.APPROACH)
            else (name,),
        )

    def _step(self, state: S, now: M) -> S:
        actuation, phase = self._actuation, state.phase
        if phase in _TRYING:
            lost = actuation.lost(state, now) if phase in HOLDING else ""
            if lost and phase is Phase.LOWER:
                return self._enter(state, Phase.RELEASE, now)
            why = lost or actuation.trouble(state, now)
            if why:
                return self._abort(state, now, why)
        if phase is Phase.GRASP:
            state, holds = actuation.grasp(state, now)
            return self._enter(state, Phase.LIFT, now) if holds else state
        if phase is Phase.IDLE or not self._is_over(state, now):
            return state
        return self._enter(state, _NEXT[phase], now)

    def _is_over(self, state: S, now: M) -> bool:
        actuation = self._actuation
        if state.phase not in actuation.waits:
            return actuation.arrived(state, now)
        least, most = actuation.waits[state.phase]
        waited = now.time - state.since
        return waited >= most or (
            waited >= least and actuation.at_rest(state, now)
        )

    def _enter(self, state: S, phase: Phase, now: M) -> S:
        state = replace(state, phase=phase, since=now.time)
        if phase is Phase.RELEASE:
            state = replace(
                state, outcome=Outcome.LIFTED, carried=state.carried + 1
            )
        return self._actuation.move(state, now)

    def _abort(self, state: S, now: M, reason: str) -> S:
        held = state.phase in HOLDING
        outcome = Outcome.SLIPPED if held else Outcome.FAILED
        state = replace(state, outcome=outcome, reason=reason)
        return self._enter(state, Phase.ABORT, now)
