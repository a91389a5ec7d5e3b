"""The state machine against a scripted gripper, without a plant."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant

from xray_drake.gripper.execution import (
    ExecutionConfig,
    GraspExecution,
    Motion,
    Phase,
    Senses,
)
from xray_drake.gripper.suction import CupState
from xray_drake.gripper.yumi import YumiGripper, add_gripper
from xray_drake.messages import (
    Grasp,
    GraspKind,
    GripperMode,
    GripperStatus,
    Outcome,
    SearchAction,
)
from xray_drake.scene.plant import TOTE_POSITION

PERIOD = 0.01
CONFIG = ExecutionConfig()
WIDTH = 0.03

WHOLE_WAY = [
    Phase.APPROACH,
    Phase.DESCEND,
    Phase.CLOSE,
    Phase.LIFT,
    Phase.CHECK,
    Phase.CARRY,
    Phase.LOWER,
    Phase.RELEASE,
    Phase.HOME,
    Phase.SETTLE,
    Phase.IDLE,
]


@pytest.fixture(scope="module")
def gripper() -> YumiGripper:
    plant = MultibodyPlant(0.005)
    gripper = add_gripper(plant)
    plant.Finalize()
    return gripper


def take(
    kind: GraspKind = GraspKind.JAW, number: int = 1, z: float = 0.02
) -> SearchAction:
    X_WG = np.diag([1.0, -1.0, -1.0, 1.0])
    X_WG[:3, 3] = 0.05, -0.03, z
    width = WIDTH if kind is GraspKind.JAW else 0.0
    return SearchAction(
        number=number, grasp=Grasp(kind, "brick", X_WG, X_WG, width)
    )


class Script:
    """A gripper that goes where it is told, unless the script says else.

    ``width`` of what is between the fingers; ``vacuum`` with suction on;
    ``push`` on the wrist, N (3,). Each by the phase and the time in it, and the
    push by the flange's height, too.
    """

    def __init__(self, gripper: YumiGripper) -> None:
        self.gripper = gripper
        self.execution = GraspExecution(gripper)
        self.motion: Motion = self.execution.rest()
        self.time = 0.0
        self.width: Callable[[Phase, float], float] = lambda phase, t: WIDTH
        self.vacuum: Callable[[Phase, float], float] = lambda phase, t: 0.0
        self.push: Callable[[Phase, float, float], np.ndarray] = (
            lambda phase, t, z: np.zeros(3)
        )
        self.why = ""
        self.way: list[tuple[float, Motion, GripperStatus, np.ndarray]] = []

    def step(self, action: SearchAction) -> None:
        self.time += PERIOD
        before = self.motion
        since = self.time - before.since
        desired, _ = before.path.sample(self.time)
        lag = np.zeros(len(desired))
        lag[:3] = self.push(before.phase, since, float(desired[2]))
        joints = desired + lag / self.gripper.carrier.stiffness
        shut = self.gripper.finger_travel - self.width(before.phase, since) / 2
        closing = before.phase is not Phase.APPROACH
        finger = min(before.finger, shut) if closing else before.finger
        drawn = self.vacuum(before.phase, since) if before.suction else 0.0
        senses = Senses(
            time=self.time,
            joints=joints,
            desired=desired,
            finger=finger,
            cup=CupState(vacuum=drawn, lost=self.why),
        )
        if before.phase is Phase.IDLE and action.number != (
            before.action.number
        ):
            self.motion = self.execution.begin(before, action, senses)
        self.motion = self.execution.advance(self.motion, senses, PERIOD)
        status = self.execution.status(self.motion)
        self.way.append((self.time, self.motion, status, joints))

    def run(self, action: SearchAction) -> GripperStatus:
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
    def phases(self) -> list[Phase]:
        found: list[Phase] = []
        for _, motion, _, _ in self.way:
            if not found or found[-1] is not motion.phase:
                found.append(motion.phase)
        return found

    def tool(self, phase: Phase) -> np.ndarray:
        """The (4, 4) pose of the grasp frame when a phase ended."""
        *_, (_, motion, _, joints) = (
            entry for entry in self.way if entry[1].phase is phase
        )
        frames = {
            GraspKind.JAW: self.gripper.X_BJ,
            GraspKind.SUCTION: self.gripper.X_BC,
        }
        X_BG = frames[motion.action.grasp.kind]
        return self.gripper.carrier.pose(joints) @ X_BG


def test_nothing_happens_without_a_command(gripper: YumiGripper) -> None:
    script = Script(gripper)
    for _ in range(20):
        script.step(SearchAction())
    assert script.phases == [Phase.IDLE]
    np.testing.assert_allclose(script.way[-1][3], gripper.home)


def test_a_jaw_grasp_from_start_to_end(gripper: YumiGripper) -> None:
    script = Script(gripper)
    status = script.run(take())
    assert script.phases == WHOLE_WAY
    assert (status.outcome, status.reason) == (Outcome.LIFTED, "")
    assert script.time < 15.0
    lowest = np.array(take().grasp.X_WG)
    lowest[2, 3] -= CONFIG.jaw_overtravel  # nothing is touched before
    np.testing.assert_allclose(script.tool(Phase.CLOSE), lowest, atol=1e-6)
    over = script.tool(Phase.CARRY)[:2, 3] - TOTE_POSITION[:2]
    assert np.all(np.abs(over) <= 0.1 + 1e-6)
    down = script.tool(Phase.LOWER)
    assert down[2, 3] == pytest.approx(0.02 + CONFIG.release_height)
    np.testing.assert_allclose(script.way[-1][3], gripper.home, atol=1e-6)


def test_a_suction_grasp_from_start_to_end(gripper: YumiGripper) -> None:
    script = Script(gripper)
    script.width = lambda phase, t: 0.0
    script.vacuum = lambda phase, t: {
        Phase.APPROACH: 0.0,
        Phase.DESCEND: float(t > 1.7),  # just before the end
    }.get(phase, 1.0)
    action = take(GraspKind.SUCTION)
    status = script.run(action)
    assert script.phases == [
        Phase.SEAL if phase is Phase.CLOSE else phase for phase in WHOLE_WAY
    ]
    assert status.outcome is Outcome.LIFTED
    for time, motion, _, _ in script.way:
        drawing = motion.phase in WHOLE_WAY[1:7] or motion.phase is Phase.SEAL
        assert motion.suction == drawing, time
    # It stopped where it sealed.
    assert script.tool(Phase.SEAL)[2, 3] > action.grasp.X_WG[2, 3]


def test_the_wrist_goes_smoothly_and_within_its_limits(
    gripper: YumiGripper,
) -> None:
    script = Script(gripper)
    script.run(take())
    q = np.array([joints for *_, joints in script.way])
    v = np.diff(q, axis=0) / PERIOD
    a = np.diff(v, axis=0) / PERIOD
    assert np.all(np.abs(v) <= gripper.carrier.velocity + 1e-6)
    assert np.abs(v[:, :3]).max() <= CONFIG.speed + 1e-6
    # Between two samples of the path; a jump of 1 mm would give 10 m/s².
    assert np.abs(a[:, :3]).max() <= 1.5 * CONFIG.acceleration


def test_the_fingers_open_in_time_and_not_too_fast(
    gripper: YumiGripper,
) -> None:
    script = Script(gripper)
    script.run(take())
    fingers = np.array([motion.finger for _, motion, _, _ in script.way])
    assert np.abs(np.diff(fingers)).max() <= 0.025 * PERIOD + 1e-9
    descent = [
        m.finger for _, m, _, _ in script.way if m.phase is Phase.DESCEND
    ]
    np.testing.assert_allclose(
        0.05 - 2 * np.array(descent), WIDTH + 2 * CONFIG.clearance, atol=1e-6
    )
    held = [m.finger for _, m, _, _ in script.way if m.phase is Phase.CARRY]
    np.testing.assert_allclose(2000 * (np.array(held) - 0.01), 20.0, atol=1e-6)
    assert fingers[-1] == 0.0


def test_what_the_status_says(gripper: YumiGripper) -> None:
    script = Script(gripper)
    script.run(take())
    said = []
    for _, _, status, _ in script.way:
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
    busy = [status for *_, status, _ in script.way][:-1]
    assert all(status.outcome is Outcome.NONE for status in busy)


def failure(script: Script, action: SearchAction) -> GripperStatus:
    """Runs an action that fails; the gripper must come home without a jump."""
    status = script.run(action)
    assert status.reason
    assert script.phases[-4:] == [
        Phase.ABORT,
        Phase.HOME,
        Phase.SETTLE,
        Phase.IDLE,
    ]
    motion = script.motion
    assert not motion.suction
    assert motion.finger == 0.0
    np.testing.assert_allclose(motion.path.end, script.gripper.home)
    settling = [
        status.settling
        for _, motion, status, _ in script.way
        if motion.phase is Phase.SETTLE
    ]
    assert all(settling)
    return status


def test_a_jaw_that_closes_on_nothing(gripper: YumiGripper) -> None:
    script = Script(gripper)
    script.width = lambda phase, t: 0.0
    status = failure(script, take())
    assert status.outcome is Outcome.FAILED
    assert status.reason == "the jaw closed on nothing"


def test_a_cup_that_does_not_seal(gripper: YumiGripper) -> None:
    script = Script(gripper)
    script.width = lambda phase, t: 0.0
    status = failure(script, take(GraspKind.SUCTION))
    assert status.outcome is Outcome.FAILED
    assert status.reason == "the cup does not seal"
    reached = script.tool(Phase.SEAL)[2, 3]
    assert reached == pytest.approx(0.02 - CONFIG.cup_overtravel)


@pytest.mark.parametrize("kind", [GraspKind.JAW, GraspKind.SUCTION])
def test_something_in_the_way(gripper: YumiGripper, kind: GraspKind) -> None:
    script = Script(gripper)
    script.width = lambda phase, t: WIDTH * (kind is GraspKind.JAW)
    script.push = lambda phase, t, z: np.array(
        [0, 0, 8.0 * (phase is Phase.DESCEND and t > 0.8)]
    )
    status = failure(script, take(kind))
    assert status.outcome is Outcome.FAILED
    assert "before the grasp" in status.reason


def test_touching_a_little_early_is_no_failure(gripper: YumiGripper) -> None:
    script = Script(gripper)
    touching = 0.02 + 0.1142 + 0.004
    script.push = lambda phase, t, z: np.array(
        [0, 0, 8.0 * (phase is Phase.DESCEND and z < touching)]
    )
    assert script.run(take()).outcome is Outcome.LIFTED
    early = script.tool(Phase.CLOSE)[2, 3] - 0.02
    assert early == pytest.approx(0.004, abs=0.001)


@pytest.mark.parametrize("phase", [Phase.LIFT, Phase.CHECK, Phase.CARRY])
def test_what_slips_is_noticed(gripper: YumiGripper, phase: Phase) -> None:
    script = Script(gripper)
    script.width = lambda now, t: 0.0 if now is phase and t > 0.2 else WIDTH
    status = failure(script, take())
    assert status.outcome is Outcome.SLIPPED
    assert status.reason == "it slipped out of the jaw"


def test_what_slips_over_the_tote_has_arrived(gripper: YumiGripper) -> None:
    script = Script(gripper)
    script.width = lambda phase, t: (
        0.0 if phase is Phase.LOWER and t > 0.2 else WIDTH
    )
    assert script.run(take()).outcome is Outcome.LIFTED


def impatient(gripper: YumiGripper, phase: Phase) -> Script:
    """A script whose time for an action is over in the midst of a phase."""
    script = Script(gripper)
    script.run(take())
    times = [t for t, motion, *_ in script.way if motion.phase is phase]
    give_up = float(np.mean(times)) - script.motion.began
    script = Script(gripper)
    script.execution = GraspExecution(gripper, replace(CONFIG, give_up=give_up))
    return script


def test_trouble_over_the_tote_is_no_success(gripper: YumiGripper) -> None:
    script = Script(gripper)
    script.push = lambda phase, t, z: np.array(
        [0, 0, 400.0 * (phase is Phase.LOWER)]
    )
    status = failure(script, take())
    assert status.outcome is Outcome.SLIPPED
    assert status.reason == "the wrist is stuck"

    status = failure(impatient(gripper, Phase.LOWER), take())
    assert status.outcome is Outcome.SLIPPED
    assert status.reason.startswith("gave up after")


def test_what_has_been_set_down_stays_so(gripper: YumiGripper) -> None:
    """Though the time is over before the jaw is open."""
    status = impatient(gripper, Phase.RELEASE).run(take())
    assert (status.outcome, status.reason) == (Outcome.LIFTED, "")


def test_a_lost_seal_is_noticed(gripper: YumiGripper) -> None:
    script = Script(gripper)
    script.width = lambda phase, t: 0.0
    script.vacuum = lambda phase, t: float(
        phase is Phase.SEAL or (phase is Phase.LIFT and t < 0.3)
    )
    script.why = "it slides off"
    status = failure(script, take(GraspKind.SUCTION))
    assert (status.outcome, status.reason) == (Outcome.SLIPPED, "it slides off")


def test_a_wrist_that_is_stuck(gripper: YumiGripper) -> None:
    script = Script(gripper)
    script.push = lambda phase, t, z: np.array(
        [0, 0, -400.0 * (phase is Phase.LIFT)]
    )
    status = failure(script, take())
    assert (status.outcome, status.reason) == (
        Outcome.SLIPPED,
        "the wrist is stuck",
    )


def test_it_gives_up_within_a_time(gripper: YumiGripper) -> None:
    script = Script(gripper)
    # The fingers never come to rest.
    script.width = lambda phase, t: 0.02 + 0.005 * (round(t / 0.05) % 2)
    status = failure(script, take())
    assert status.reason == "the jaw does not come to rest"
    script.execution = GraspExecution(gripper, replace(CONFIG, give_up=1.5))
    script.width = lambda phase, t: WIDTH
    status = failure(script, take(number=2))
    assert status.reason == "gave up after 1.5 s"


def test_lowering_stops_at_what_is_below(gripper: YumiGripper) -> None:
    script = Script(gripper)
    script.push = lambda phase, t, z: np.array(
        [0, 0, 5.0 * (phase is Phase.LOWER and t > 0.7)]
    )
    assert script.run(take()).outcome is Outcome.LIFTED
    assert script.tool(Phase.RELEASE)[2, 3] > 0.1


def test_out_of_reach(gripper: YumiGripper) -> None:
    script = Script(gripper)
    status = script.run(take(z=-0.3))
    assert status.outcome is Outcome.FAILED
    assert status.reason == "out of the wrist's reach: z"
    assert script.phases == [Phase.IDLE]


def test_no_grasp(gripper: YumiGripper) -> None:
    status = Script(gripper).run(SearchAction(number=1))
    assert status.outcome is Outcome.NO_GRASP


def test_no_grasp_on_what_was_chosen(gripper: YumiGripper) -> None:
    action = SearchAction(number=1, invalid=True)
    status = Script(gripper).run(action)
    assert status.outcome is Outcome.NO_GRASP
    assert status.reason == "the choice has no grasp, others have"


def test_the_next_one_goes_to_another_place(gripper: YumiGripper) -> None:
    script = Script(gripper)
    script.run(take())
    first = script.tool(Phase.LOWER)
    script.run(take(number=2))
    second = script.tool(Phase.LOWER)
    assert np.linalg.norm((first - second)[:2, 3]) > 0.05
