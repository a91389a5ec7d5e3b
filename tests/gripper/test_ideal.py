"""The ideal gripper alone with fixed inputs, then on a plant of its own."""

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from scipy.spatial.transform import Rotation

from tests.alone import Alone
from tests.gripper.cells import (
    TransferCell,
    assert_brought_to_the_tote,
)
from tests.nominal import TOTE
from tests.ports import ports
from tests.poses import at, downwards
from xray_drake.cell.gripper import load_gripper
from xray_drake.grasping.gripper_geometry import gripper_geometry
from xray_drake.grasping.judgement import JudgedGrasp
from xray_drake.gripper.actuation.ideal import (
    QuasiStaticConfig,
    QuasiStaticGripper,
)
from xray_drake.messages import (
    Grasp,
    GraspKind,
    GripperMode,
    Outcome,
    SearchAction,
)
from xray_drake.scene.object_model import object_from_pieces
from xray_drake.scene.shapes import box
from xray_drake.scene.targets import target_model

TARGET = "box_2to1"
BRICK = object_from_pieces(
    "brick",
    list(box(0.04, 0.03, 0.02, (0.005, 0.0, 0.0)).surfaces),
    density=800.0,
    recenter=False,
)
"""40 × 30 × 20 mm, 19 g, its body origin 5 mm beside its centre."""

MODELS = {"brick": BRICK, TARGET: target_model(TARGET)}
POSES = {"brick": at(0.05, 0.02, 0.01), TARGET: at(-0.1, 0, 0.0025)}


def take(name, number=1, X_WO=POSES["brick"]):
    """An action: grasp an object from above at its body origin."""
    X_OG = downwards(0.0, 0.0, 0.0)
    grasp = Grasp(GraspKind.JAW, name, X_WG=X_WO @ X_OG, X_OG=X_OG, width=0.03)
    return SearchAction(number=number, grasp=grasp)


class Judge:
    """Gives a verdict and notes what it is asked."""

    def __init__(self, quality=0.8, reason=""):
        self.quality, self.reason = quality, reason
        self.asked = []

    def judge(self, grasp, poses, *, X_WG_perturbed, friction):
        self.asked.append((grasp.object, X_WG_perturbed, friction))
        self.poses = poses
        return JudgedGrasp(self.quality, self.reason, X_WG_perturbed)


def make(judge, bodies, **more):
    return QuasiStaticGripper(
        judge=judge,
        objects=[MODELS[name] for name in bodies],
        bodies=bodies,
        geometry=gripper_geometry(load_gripper()),
        **more,
    )


def moving(V_WO):
    still = SpatialVelocity.Zero()
    return [still, SpatialVelocity(w=V_WO[:3], v=V_WO[3:]), still]


def alone(judge, action, *, seed=0):
    """The gripper with fixed inputs; body 1 is the brick, 2 the target."""
    return Alone(
        make(judge, {"brick": 1, TARGET: 2}, seed=seed),
        action=action,
        body_poses=[RigidTransform(), *map(RigidTransform, POSES.values())],
        body_spatial_velocities=moving(np.zeros(6)),
    )


def lifting(judge, *, seed=0):
    """A gripper at the instant at which the lift begins."""
    gripper = alone(judge, take("brick"), seed=seed)
    time = 0.0
    while not judge.asked:
        time += 0.02
        assert time < 1.0
        gripper.advance_to(time)
    return gripper


def test_ports_are_named():
    system = make(Judge(), {"brick": 1})
    assert ports(system) == (
        ["action", "body_poses", "body_spatial_velocities"],
        ["status", "applied_spatial_force", "position"],
    )
    assert system.get_name() == "gripper_controller"
    # Or policy and gripper would make an algebraic loop.
    assert not any(system.HasDirectFeedthrough(i, 0) for i in range(3))
    assert not any(system.HasDirectFeedthrough(0, i) for i in range(3))


@pytest.mark.parametrize(
    ("number", "outcome"), [(0, Outcome.NONE), (1, Outcome.NO_GRASP)]
)
def test_without_a_grasp_it_stays_idle(number, outcome):
    judge = Judge()
    gripper = alone(judge, SearchAction(number=number))
    status = gripper.advance_to(0.3)
    assert (status.mode, status.number) == (GripperMode.IDLE, number)
    assert (status.outcome, status.held) == (outcome, "")
    assert bool(status.reason) == (number > 0)
    assert (status.stirring, status.loose) == (False, ())
    assert gripper.output("applied_spatial_force") == []
    assert judge.asked == []


def test_a_command_is_taken_up_once():
    gripper = alone(Judge(), take("brick"))
    assert gripper.output("status").mode is GripperMode.IDLE  # before an event
    status = gripper.advance_to(0.02)
    assert (status.mode, status.number) == (GripperMode.BUSY, 1)
    assert (status.outcome, status.held) == (Outcome.NONE, "")
    assert not status.stirring
    assert gripper.output("applied_spatial_force") == []
    gripper.fix(action=take(TARGET, 2))  # too early: it is busy
    assert gripper.advance_to(0.3).number == 1


@pytest.mark.parametrize("spin", [0.0, 2.0])
def test_the_spring_pulls_at_the_centre_of_mass(spin):
    """It bears the weight; a turn about that costs torque, no force."""
    gripper = lifting(Judge())
    w = np.array([0.0, 0.0, spin])
    v = np.cross(w, -BRICK.p_OCom)  # of the body origin
    gripper.fix(body_spatial_velocities=moving(np.r_[w, v]))
    (applied,) = gripper.output("applied_spatial_force")
    assert int(applied.body_index) == 1
    np.testing.assert_allclose(applied.p_BoBq_B, BRICK.p_OCom)
    weight = [0, 0, 9.81 * BRICK.mass]
    force, torque = applied.F_Bq_W.translational(), applied.F_Bq_W.rotational()
    np.testing.assert_allclose(force, weight, atol=1e-9)
    np.testing.assert_allclose(torque[:2], 0, atol=1e-9)
    against = torque[2] < -1e-4
    assert against if spin else abs(torque[2]) < 1e-9


def test_the_judge_sees_the_heap_and_a_perturbed_grasp():
    judge = Judge()
    lifting(judge)
    ((name, X_WG, friction),) = judge.asked
    planned = take("brick").grasp.X_WG
    assert name == "brick"
    for other, X_WO in POSES.items():
        np.testing.assert_allclose(judge.poses[other], X_WO)
    assert 1e-5 < np.linalg.norm(X_WG[:3, 3] - planned[:3, 3]) < 0.02
    turn = Rotation.from_matrix(X_WG[:3, :3].T @ planned[:3, :3])
    assert 1e-4 < turn.magnitude() < 0.3
    assert friction != 0.5
    assert friction == pytest.approx(0.5, abs=0.45)


def test_perturbations_follow_the_seed_and_the_number():
    first, same, other = Judge(), Judge(), Judge()
    for judge, seed in ((first, 0), (same, 0), (other, 1)):
        lifting(judge, seed=seed)
    judge = Judge(0.0, "slippery")
    gripper = alone(judge, SearchAction())
    for number in (1, 2):
        gripper.fix(action=take("brick", number))
        gripper.advance_to(number * 1.5)
    (_, X_WG, friction), (_, _, of_the_next) = judge.asked
    for _, X, mu in (*first.asked, *same.asked):
        np.testing.assert_array_equal(X, X_WG)
        assert mu == friction
    assert friction != other.asked[0][2]
    assert friction != of_the_next


def test_a_judged_failure_moves_nothing_and_says_why():
    judge = Judge(0.0, "jaw hits cup")
    gripper = alone(judge, take("brick"))
    busy = 0
    for i in range(1, 76):
        status = gripper.advance_to(0.02 * i)
        assert gripper.output("applied_spatial_force") == []
        assert not (status.stirring or status.settling)
        assert (status.loose, status.held) == ((), "")
        if status.mode is GripperMode.BUSY:
            busy += 1
            assert (status.outcome, status.reason) == (Outcome.NONE, "")
    assert 10 < busy < 60  # there and back
    assert (status.mode, status.number) == (GripperMode.IDLE, 1)
    assert (status.outcome, status.reason) == (Outcome.FAILED, "jaw hits cup")
    assert len(judge.asked) == 1


def test_an_object_that_is_stuck_slips():
    gripper = lifting(Judge())  # its pose stays fixed
    time = gripper.context.get_time()
    while gripper.output("applied_spatial_force"):
        time += 0.02
        assert time < 2.0
        status = gripper.advance_to(time)
    assert (status.mode, status.held) == (GripperMode.BUSY, "")
    assert status.stirring  # what it stirred may still move
    assert status.settling
    assert status.loose == ("brick",)
    status = gripper.advance_to(time + 1.0)
    assert (status.mode, status.outcome) == (GripperMode.IDLE, Outcome.SLIPPED)
    assert status.reason
    assert not (status.stirring or status.settling)
    assert gripper.output("applied_spatial_force") == []


def test_the_drawn_gripper_goes_to_the_grasp():
    gripper = alone(Judge(), take("brick"))
    home = gripper.output("position")
    assert home.shape == (9,)
    assert np.linalg.norm(home[:4]) == pytest.approx(1.0)
    gripper.advance_to(0.0)
    np.testing.assert_allclose(gripper.output("position"), home, atol=1e-9)
    gripper.advance_to(0.2)  # half way
    way = gripper.output("position") - home
    goal = np.array([0.05, 0.02, 0.01 + 0.1142]) - home[4:7]
    np.testing.assert_allclose(way[4:7], 0.5 * goal, atol=1e-6)
    np.testing.assert_array_equal(gripper.output("position")[7:], 0)  # open
    assert gripper.advance_to(0.42).held == "brick"
    there = gripper.output("position")
    np.testing.assert_allclose(there[4:7], [0.05, 0.02, 0.01 + 0.1142])
    # 30 mm between the contacts of an opening of 50 mm.
    np.testing.assert_allclose(there[7:], 0.01, atol=1e-9)


class Cell(TransferCell):
    """A bin, a tote, objects, and the ideal gripper."""

    def __init__(self, poses=POSES, **more):
        super().__init__(*(MODELS[name] for name in poses), poses=poses)
        gripper = self.builder.AddSystem(make(Judge(), self.bodies, **more))
        self.connect(gripper)
        self.build(gripper)

    def advance_until(self, *, stirring):
        """Advances until the status says so; returns the time."""
        end = self.context.get_time() + 5.0
        while self.status.stirring is not stirring:
            self.advance(0.02)
            assert self.context.get_time() < end
        return self.context.get_time()


def test_it_brings_one_after_the_other_to_places_of_their_own():
    cell = Cell()
    for number, name in enumerate(POSES, 1):
        way = cell.run(take(name, number, cell.pose(name)))
        assert cell.status.number == number
        assert (cell.status.outcome, cell.status.reason) == (Outcome.LIFTED, "")
        assert_brought_to_the_tote(way)
        if number == 1:  # it bumped into nothing
            np.testing.assert_allclose(
                cell.pose(TARGET)[:3, 3], POSES[TARGET][:3, 3], atol=5e-4
            )
    cell.advance(0.3)
    np.testing.assert_allclose(cell.pose(name)[:3, 3], way[-1], atol=1e-3)
    places = [cell.pose(name)[:3, 3] for name in POSES]
    assert all(map(TOTE.holds, places))
    assert np.linalg.norm(places[0] - places[1]) > 0.05


def test_it_holds_until_the_rest_is_at_rest():
    """A second object still falls while the first is lifted."""
    waiting = {}
    for height in (0.0025, 6.0):
        cell = Cell(POSES | {TARGET: at(-0.1, 0.0, height)})
        cell.fix(action=take("brick"))
        start = cell.advance_until(stirring=True)
        waiting[height] = cell.advance_until(stirring=False) - start
        assert cell.status.held == "brick"
    assert waiting[6.0] > waiting[0.0025] + 0.2
    assert cell.height(TARGET) < 0.05  # it has landed meanwhile


@pytest.mark.parametrize(
    ("X_WO", "timeout", "height"),
    [(at(-0.1, 0.0, 200.0), 0.5, 220.0), (at(0.0, 5.0, -0.2), 3.0, -10.0)],
    ids=["no rest in time", "fell out of the cell: on below the tote"],
)
def test_it_does_not_wait_for_ever_nor_follow(X_WO, timeout, height):
    config = QuasiStaticConfig(rest_timeout=timeout)
    cell = Cell(POSES | {TARGET: X_WO}, config=config)
    way = cell.run(take("brick"), limit=4.0)
    assert cell.height(TARGET) < height
    assert cell.status.outcome is Outcome.LIFTED
    assert TOTE.holds(way[-1])
    assert way[:, 2].min() > 0.0
