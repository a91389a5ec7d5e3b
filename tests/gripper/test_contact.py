"""The state machine against a scripted gripper, without a plant."""

from dataclasses import replace

import numpy as np
import pytest

from tests.gripper.cells import make_gripper, take_brick
from tests.nominal import TOTE
from tests.poses import at
from xray_drake.gripper.actuation.contact import (
    ContactActuation,
    ExecutionConfig,
    Measured,
    Step,
)
from xray_drake.gripper.carriers.carrier import Tracking
from xray_drake.gripper.suction import CupState
from xray_drake.gripper.transfer import Phase, Transfer
from xray_drake.messages import GraspKind, GripperMode, Outcome, SearchAction

PERIOD = 0.01
CONFIG = ExecutionConfig()
WIDTH = 0.03

DESCEND, CLOSE = Step.DESCEND, Step.CLOSE
WHOLE_WAY = [
    Phase.APPROACH,
    DESCEND,
    CLOSE,
    *(Phase.LIFT, Phase.CHECK, Phase.CARRY, Phase.LOWER, Phase.RELEASE),
    *(Phase.HOME, Phase.SETTLE, Phase.IDLE),
]


@pytest.fixture(scope="module")
def gripper():
    return make_gripper()


def stage(state):
    """The phase, or the step of the grasp."""
    return state.step if state.phase is Phase.GRASP else state.phase


class Script:
    """A gripper that goes where it is told, unless the script says else.

    ``width`` of what is between the fingers; ``vacuum`` with suction on;
    ``push`` up on the wrist, N. Each by the stage and the time in it, and the
    push by the flange's height, too.
    """

    def __init__(self, gripper, config=CONFIG, **script):
        self.gripper = gripper
        actuation = ContactActuation(gripper, TOTE, config, period=PERIOD)
        self.transfer = Transfer(actuation)
        self.state = actuation.initial()
        self.time = 0.0
        self.width = lambda at, t: WIDTH
        self.vacuum = lambda at, t: 0.0
        self.push = lambda at, t, z: 0.0
        self.why = ""
        vars(self).update(script)
        self.way = []

    def step(self, action):
        self.time += PERIOD
        before, at = self.state, stage(self.state)
        since = self.time - before.since
        desired, _ = before.path.sample(self.time)
        lag, still = np.zeros(len(desired)), np.zeros(len(desired))
        lag[2] = self.push(at, since, float(desired[2]))
        joints = desired + lag / self.gripper.carrier.limits.stiffness
        shut = self.gripper.finger_travel - self.width(at, since) / 2
        closing = at is not Phase.APPROACH
        finger = min(before.finger, shut) if closing else before.finger
        drawn = self.vacuum(at, since) if before.suction else 0.0
        measured = Measured(
            time=self.time,
            tracking=Tracking(joints, still, desired, still, still),
            finger=finger,
            cup=CupState(vacuum=drawn, lost=self.why),
        )
        if at is Phase.IDLE and action.number != before.action.number:
            self.state = self.transfer.begin(before, action, measured)
        self.state = self.transfer.advance(self.state, measured)
        status = self.transfer.status(self.state)
        self.way.append((self.time, self.state, status, joints))

    def run(self, action):
        """Runs an action to its end."""
        self.way.clear()
        while True:
            self.step(action)
            status = self.way[-1][2]
            if status.mode is GripperMode.IDLE:
                assert status.number == action.number
                return status
            assert self.time < 100.0

    @property
    def stages(self):
        found = []
        for _, state, _, _ in self.way:
            if not found or found[-1] is not stage(state):
                found.append(stage(state))
        return found

    def fingers(self, at):
        """What is commanded to the fingers in a stage."""
        return np.array(
            [state.finger for _, state, *_ in self.way if stage(state) is at]
        )

    def tool(self, at):
        """The (4, 4) pose of the grasp frame when a stage ended."""
        *_, (_, state, _, joints) = (
            entry for entry in self.way if stage(entry[1]) is at
        )
        jaw = state.action.grasp.kind is GraspKind.JAW
        X_BG = self.gripper.X_BJ if jaw else self.gripper.X_BC
        return self.gripper.carrier.pose(joints) @ X_BG


@pytest.fixture(scope="module")
def whole(gripper):
    """A jaw grasp from start to end."""
    script = Script(gripper)
    status = script.run(take_brick())
    assert (status.outcome, status.reason) == (Outcome.LIFTED, "")
    return script


def test_a_jaw_grasp_from_start_to_end(whole):
    """It closes a little below the grasp: nothing is touched before."""
    assert whole.stages == WHOLE_WAY
    assert whole.time < 15.0
    lowest = at(0, 0, -CONFIG.jaw_overtravel) @ take_brick().grasp.X_WG
    np.testing.assert_allclose(whole.tool(CLOSE), lowest, atol=1e-6)
    over = whole.tool(Phase.CARRY)[:2, 3] - TOTE.position[:2]
    assert np.all(np.abs(over) <= 0.1 + 1e-6)
    down = whole.tool(Phase.LOWER)
    assert down[2, 3] == pytest.approx(0.02 + CONFIG.release_height)
    home = whole.gripper.carrier.home
    np.testing.assert_allclose(whole.way[-1][3], home, atol=1e-6)


def test_a_suction_grasp_from_start_to_end(gripper):
    """It stops where it seals, here just before the end of its descent."""
    script = Script(gripper, width=lambda at, t: 0.0)
    script.vacuum = lambda at, t: {
        Phase.APPROACH: 0.0,
        DESCEND: float(t > 1.7),
    }.get(at, 1.0)
    action = take_brick(GraspKind.SUCTION)
    assert script.run(action).outcome is Outcome.LIFTED
    assert script.stages == WHOLE_WAY
    for _, state, _, _ in script.way:
        assert state.suction == (stage(state) in WHOLE_WAY[1:7])
    assert script.tool(CLOSE)[2, 3] > action.grasp.X_WG[2, 3]


def test_the_wrist_goes_smoothly_and_within_its_limits(whole):
    q = np.array([joints for *_, joints in whole.way])
    v = np.diff(q, axis=0) / PERIOD
    a = np.diff(v, axis=0) / PERIOD
    assert np.all(np.abs(v) <= whole.gripper.carrier.limits.velocity + 1e-6)
    assert np.abs(v[:, :3]).max() <= CONFIG.speed + 1e-6
    # Between two samples of the path; a jump of 1 mm would give 10 m/s².
    assert np.abs(a[:, :3]).max() <= 1.5 * CONFIG.acceleration


def test_the_fingers_open_in_time_and_not_too_fast(whole):
    fingers = np.array([state.finger for _, state, _, _ in whole.way])
    assert np.abs(np.diff(fingers)).max() <= 0.025 * PERIOD + 1e-9
    opening = 0.05 - 2 * whole.fingers(DESCEND)
    np.testing.assert_allclose(opening, WIDTH + 2 * CONFIG.clearance, atol=1e-6)
    squeeze = 2000 * (whole.fingers(Phase.CARRY) - 0.01)
    np.testing.assert_allclose(squeeze, 20.0, atol=1e-6)
    assert fingers[-1] == 0.0


def test_what_the_status_says(whole):
    said = []
    for _, _, status, _ in whole.way:
        now = (status.stirring, status.settling, status.held, status.loose)
        if not said or said[-1] != now:
            said.append(now)
    assert said == [
        (False, False, "", ()),
        (True, False, "", ("brick",)),
        (True, False, "brick", ("brick",)),
        (True, True, "brick", ("brick",)),
        (False, False, "brick", ("brick",)),
        (False, False, "", ("brick",)),
        (False, False, "", ()),
    ]
    busy = [status for *_, status, _ in whole.way][:-1]
    assert all(status.outcome is Outcome.NONE for status in busy)


def failure(script, action):
    """Runs an action that fails; the gripper must come home without a jump."""
    status = script.run(action)
    end = [Phase.ABORT, Phase.HOME, Phase.SETTLE, Phase.IDLE]
    assert script.stages[-4:] == end
    state = script.state
    assert not state.suction
    assert state.finger == 0.0
    np.testing.assert_allclose(state.path.end, script.gripper.carrier.home)
    assert all(
        status.settling
        for _, state, status, _ in script.way
        if state.phase is Phase.SETTLE
    )
    return status


def push(at, force, after=0.0):
    """A force up on the wrist, N, from a time in a stage on."""
    return lambda now, t, z: force * (now is at and t > after)


def slip(phase):
    """The jaw is empty from a time in a phase on."""
    return lambda at, t: WIDTH * (at is not phase or t <= 0.2)


def draw_for_a_while(at, t):
    return float(at is CLOSE or (at is Phase.LIFT and t < 0.3))


def closed(at, t):
    return 0.0


def quiver(at, t):
    return 0.02 + 0.005 * (round(t / 0.05) % 2)


JAW, SUCTION = GraspKind.JAW, GraspKind.SUCTION
FAILED, SLIPPED = Outcome.FAILED, Outcome.SLIPPED
TOUCHES = {"push": push(DESCEND, 8.0, 0.8)}
LEAKS = {"vacuum": draw_for_a_while, "why": "it slides off"}
EMPTY = "it slipped out of the jaw"
STUCK = "the wrist is stuck"


@pytest.mark.parametrize(
    ("kind", "script", "outcome", "reason"),
    [
        (JAW, {"width": closed}, FAILED, "the jaw closed on nothing"),
        (SUCTION, {}, FAILED, "the cup does not seal"),
        (JAW, TOUCHES, FAILED, "before the grasp"),
        (SUCTION, TOUCHES, FAILED, "before the grasp"),
        (JAW, {"width": slip(Phase.LIFT)}, SLIPPED, EMPTY),
        (JAW, {"width": slip(Phase.CHECK)}, SLIPPED, EMPTY),
        (JAW, {"width": slip(Phase.CARRY)}, SLIPPED, EMPTY),
        (SUCTION, LEAKS, SLIPPED, "it slides off"),
        (JAW, {"push": push(Phase.LIFT, -400.0)}, SLIPPED, STUCK),
        (JAW, {"push": push(Phase.LOWER, 400.0)}, SLIPPED, STUCK),
        (JAW, {"width": quiver}, FAILED, "the jaw does not come to rest"),
    ],
)
def test_a_failure_is_noticed(gripper, kind, script, outcome, reason):
    script = {"width": closed} | script if kind is SUCTION else script
    run = Script(gripper, **script)
    status = failure(run, take_brick(kind))
    assert status.outcome is outcome
    assert reason in status.reason
    if reason == "the cup does not seal":
        reached = run.tool(CLOSE)[2, 3]
        assert reached == pytest.approx(0.02 - CONFIG.cup_overtravel)


def test_touching_a_little_early_is_no_failure(gripper):
    touching = 0.02 + 0.1142 + 0.004
    script = Script(gripper)
    script.push = lambda at, t, z: 8.0 * (at is DESCEND and z < touching)
    assert script.run(take_brick()).outcome is Outcome.LIFTED
    early = script.tool(CLOSE)[2, 3] - 0.02
    assert early == pytest.approx(0.004, abs=0.001)


def test_what_slips_over_the_tote_has_arrived(gripper):
    script = Script(gripper, width=slip(Phase.LOWER))
    assert script.run(take_brick()).outcome is Outcome.LIFTED


def test_lowering_stops_at_what_is_below(gripper):
    script = Script(gripper, push=push(Phase.LOWER, 5.0, 0.7))
    assert script.run(take_brick()).outcome is Outcome.LIFTED
    assert script.tool(Phase.RELEASE)[2, 3] > 0.1


@pytest.mark.parametrize(
    ("phase", "outcome"),
    [
        (Phase.APPROACH, Outcome.FAILED),
        (Phase.LOWER, Outcome.SLIPPED),
        (Phase.RELEASE, Outcome.LIFTED),
    ],
    ids=["at first", "over the tote is no success", "once down it stays so"],
)
def test_it_gives_up_within_a_time(whole, phase, outcome):
    """In the midst of a phase."""
    times = [t for t, state, *_ in whole.way if state.phase is phase]
    give_up = float(np.mean(times)) - whole.state.began
    script = Script(whole.gripper, replace(CONFIG, give_up=give_up))
    if outcome is Outcome.LIFTED:
        status, reason = script.run(take_brick()), ""
    else:
        status = failure(script, take_brick())
        reason = f"gave up after {give_up:g} s"
    assert (status.outcome, status.reason) == (outcome, reason)


@pytest.mark.parametrize(
    ("action", "outcome", "reason"),
    [
        (take_brick(z=-0.3), FAILED, "out of the wrist's reach: z"),
        (SearchAction(1), Outcome.NO_GRASP, "no candidate has a grasp"),
        (
            SearchAction(1, invalid=True),
            Outcome.NO_GRASP,
            "the choice has no grasp, others have",
        ),
    ],
)
def test_what_is_not_tried(gripper, action, outcome, reason):
    script = Script(gripper)
    status = script.run(action)
    assert (status.outcome, status.reason) == (outcome, reason)
    assert script.stages == [Phase.IDLE]


def test_the_next_one_goes_to_another_place(gripper):
    script = Script(gripper)
    script.run(take_brick())
    first = script.tool(Phase.LOWER)
    script.run(take_brick(number=2))
    second = script.tool(Phase.LOWER)
    assert np.linalg.norm((first - second)[:2, 3]) > 0.05
