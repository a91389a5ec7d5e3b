"""The ideal gripper alone with fixed inputs, then on a plant of its own."""

from collections.abc import Mapping

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from scipy.spatial.transform import Rotation

from tests.ports import inputs_of, outputs_of
from xray_drake.grasping.judgement import JudgedGrasp
from xray_drake.gripper.actuation.ideal import (
    DrawnGripper,
    QuasiStaticConfig,
    QuasiStaticGripper,
)
from xray_drake.messages import (
    Grasp,
    GraspKind,
    GripperMode,
    GripperStatus,
    Outcome,
    SearchAction,
)
from xray_drake.scene.object_model import ObjectModel, object_from_pieces
from xray_drake.scene.plant import (
    BIN_WALL_HEIGHT,
    TOTE_POSITION,
    add_bin,
    add_objects,
    add_plant,
    default_plant_config,
)
from xray_drake.scene.shapes import box
from xray_drake.scene.targets import target_model

DOWN = np.diag([1.0, -1.0, -1.0])
DRAWN = DrawnGripper(X_BJ=np.eye(4), X_BC=np.eye(4), opening=0.05)


def brick() -> ObjectModel:
    """40 × 30 × 20 mm, 19 g, its body origin 5 mm beside its centre."""
    return object_from_pieces(
        "brick",
        list(box(0.04, 0.03, 0.02, (0.005, 0.0, 0.0)).surfaces),
        density=800.0,
        recenter=False,
    )


def on_floor(x: float, y: float, z: float = 0.01) -> np.ndarray:
    X_WO = np.eye(4)
    X_WO[:3, 3] = x, y, z
    return X_WO


def take(
    name: str, number: int = 1, X_WO: np.ndarray | None = None
) -> SearchAction:
    """An action: grasp an object from above at its body origin."""
    X_WO = on_floor(0.05, 0.02) if X_WO is None else X_WO
    X_OG = np.eye(4)
    X_OG[:3, :3] = DOWN
    grasp = Grasp(GraspKind.JAW, name, X_WG=X_WO @ X_OG, X_OG=X_OG, width=0.03)
    return SearchAction(number=number, grasp=grasp)


class Judge:
    """Gives a verdict and notes what it is asked."""

    def __init__(self, quality: float = 0.8, reason: str = "") -> None:
        self.quality, self.reason = quality, reason
        self.asked: list[tuple[str, np.ndarray, float]] = []
        self.poses: Mapping[str, np.ndarray] = {}

    def judge(
        self,
        grasp: Grasp,
        poses: Mapping[str, np.ndarray],
        *,
        X_WG_perturbed: np.ndarray,
        friction: float,
    ) -> JudgedGrasp:
        self.asked.append((grasp.object, X_WG_perturbed, friction))
        self.poses = poses
        return JudgedGrasp(self.quality, self.reason, X_WG_perturbed)


class Alone:
    """The gripper with fixed inputs; body 1 is the brick, 2 the target."""

    def __init__(self, judge: Judge, *, seed: int = 0) -> None:
        self.system = QuasiStaticGripper(
            judge=judge,
            objects=[brick(), target_model("box_2to1")],
            bodies={"brick": 1, "box_2to1": 2},
            drawn=DRAWN,
            seed=seed,
        )
        self.simulator = Simulator(self.system)
        self.context = self.simulator.get_mutable_context()
        self.fix("action", SearchAction())
        self.fix_motion(on_floor(0.05, 0.02), np.zeros(6))

    def fix(self, port: str, value: object) -> None:
        self.system.GetInputPort(port).FixValue(
            self.context, AbstractValue.Make(value)
        )

    def fix_motion(self, X_WO: np.ndarray, V_WO: np.ndarray) -> None:
        poses = [
            RigidTransform(),
            RigidTransform(X_WO),
            RigidTransform([-0.1, 0.0, 0.0025]),
        ]
        still = SpatialVelocity.Zero()
        self.fix("body_poses", poses)
        self.fix(
            "body_spatial_velocities",
            [still, SpatialVelocity(w=V_WO[:3], v=V_WO[3:]), still],
        )

    def advance_to(self, time: float) -> GripperStatus:
        """Advances, and handles the events that are due at ``time``."""
        self.simulator.AdvanceTo(time)
        self.simulator.AdvancePendingEvents()
        return self.status

    @property
    def status(self) -> GripperStatus:
        return self.system.GetOutputPort("status").Eval(self.context)

    @property
    def forces(self) -> list[ExternallyAppliedSpatialForce]:
        port = self.system.GetOutputPort("applied_spatial_force")
        return port.Eval(self.context)

    @property
    def position(self) -> np.ndarray:
        return self.system.GetOutputPort("position").Eval(self.context)


def test_ports_are_named() -> None:
    system = Alone(Judge()).system
    assert inputs_of(system) == [
        "action",
        "body_poses",
        "body_spatial_velocities",
    ]
    assert outputs_of(system) == ["status", "applied_spatial_force", "position"]
    assert system.get_name() == "gripper_controller"


def test_the_status_depends_on_state_alone() -> None:
    """Or policy and gripper would make an algebraic loop."""
    system = Alone(Judge()).system
    status = system.GetOutputPort("status").get_index()
    action = system.GetInputPort("action").get_index()
    assert not any(
        system.HasDirectFeedthrough(i, status)
        for i in range(system.num_input_ports())
    )
    assert not any(
        system.HasDirectFeedthrough(action, i)
        for i in range(system.num_output_ports())
    )


def test_idle_without_a_command() -> None:
    judge = Judge()
    gripper = Alone(judge)
    status = gripper.advance_to(0.3)
    assert (status.mode, status.number) == (GripperMode.IDLE, 0)
    assert (status.outcome, status.held) == (Outcome.NONE, "")
    assert not status.stirring
    assert status.loose == ()
    assert gripper.forces == []
    assert judge.asked == []


def test_a_command_is_taken_up_once() -> None:
    gripper = Alone(Judge())
    gripper.fix("action", take("brick"))
    assert gripper.status.mode is GripperMode.IDLE  # not before an event
    status = gripper.advance_to(0.02)
    assert (status.mode, status.number) == (GripperMode.BUSY, 1)
    assert (status.outcome, status.held) == (Outcome.NONE, "")
    assert not status.stirring
    assert gripper.forces == []
    gripper.fix("action", take("box_2to1", 2))  # too early: it is busy
    assert gripper.advance_to(0.3).number == 1


def test_no_grasp_is_done_at_once() -> None:
    judge = Judge()
    gripper = Alone(judge)
    gripper.fix("action", SearchAction(number=1))
    status = gripper.advance_to(0.02)
    assert (status.mode, status.number) == (GripperMode.IDLE, 1)
    assert status.outcome is Outcome.NO_GRASP
    assert status.reason
    assert status.loose == ()
    assert judge.asked == []


def lifting(judge: Judge, *, seed: int = 0) -> Alone:
    """A gripper at the instant at which the lift begins."""
    gripper = Alone(judge, seed=seed)
    gripper.fix("action", take("brick"))
    time = 0.0
    while not judge.asked:
        time += 0.02
        assert time < 1.0
        gripper.advance_to(time)
    return gripper


def test_the_lift_begins_by_bearing_the_weight() -> None:
    gripper = lifting(Judge())
    (applied,) = gripper.forces
    model = brick()
    assert int(applied.body_index) == 1
    np.testing.assert_allclose(applied.p_BoBq_B, model.p_OCom)
    np.testing.assert_allclose(
        applied.F_Bq_W.translational(), [0, 0, 9.81 * model.mass], atol=1e-9
    )
    np.testing.assert_allclose(applied.F_Bq_W.rotational(), 0, atol=1e-9)


def test_the_spring_sees_the_centre_of_mass_move() -> None:
    """A turn about the centre of mass costs torque, no force."""
    gripper = lifting(Judge())
    model = brick()
    w = np.array([0.0, 0.0, 2.0])
    v = np.cross(w, -model.p_OCom)  # of the body origin
    gripper.fix_motion(on_floor(0.05, 0.02), np.r_[w, v])
    (applied,) = gripper.forces
    np.testing.assert_allclose(
        applied.F_Bq_W.translational(), [0, 0, 9.81 * model.mass], atol=1e-9
    )
    torque = applied.F_Bq_W.rotational()
    assert torque[2] < -1e-4  # against the turn
    np.testing.assert_allclose(torque[:2], 0, atol=1e-9)


def test_what_the_status_says_during_the_lift() -> None:
    status = lifting(Judge()).status
    assert status.mode is GripperMode.BUSY
    assert status.held == "brick"
    assert status.stirring
    assert not status.settling
    assert status.loose == ("brick",)
    assert status.outcome is Outcome.NONE


def test_the_judge_sees_the_heap_and_a_perturbed_grasp() -> None:
    judge = Judge()
    lifting(judge)
    ((name, X_WG, friction),) = judge.asked
    planned = take("brick").grasp.X_WG
    assert name == "brick"
    np.testing.assert_allclose(judge.poses["brick"], on_floor(0.05, 0.02))
    np.testing.assert_allclose(
        judge.poses["box_2to1"][:3, 3], [-0.1, 0, 0.0025]
    )
    assert 1e-5 < np.linalg.norm(X_WG[:3, 3] - planned[:3, 3]) < 0.02
    turn = Rotation.from_matrix(X_WG[:3, :3].T @ planned[:3, :3])
    assert 1e-4 < turn.magnitude() < 0.3
    assert friction != 0.5
    assert friction == pytest.approx(0.5, abs=0.45)


def test_perturbations_follow_the_seed_and_the_number() -> None:
    first, same, other = Judge(), Judge(), Judge()
    lifting(first)
    lifting(same)
    lifting(other, seed=1)
    np.testing.assert_array_equal(first.asked[0][1], same.asked[0][1])
    assert first.asked[0][2] == same.asked[0][2]
    assert first.asked[0][2] != other.asked[0][2]

    judge = Judge(0.0, "slippery")
    gripper = Alone(judge)
    for number in (1, 2):
        gripper.fix("action", take("brick", number))
        gripper.advance_to(number * 1.5)
    np.testing.assert_array_equal(judge.asked[0][1], first.asked[0][1])
    assert judge.asked[0][2] != judge.asked[1][2]


def test_a_judged_failure_moves_nothing_and_says_why() -> None:
    judge = Judge(0.0, "jaw hits cup")
    gripper = Alone(judge)
    gripper.fix("action", take("brick"))
    busy = 0
    for i in range(1, 76):
        status = gripper.advance_to(0.02 * i)
        assert gripper.forces == []
        assert not status.stirring
        assert not status.settling
        assert status.loose == ()
        assert status.held == ""
        busy += status.mode is GripperMode.BUSY
        if status.mode is GripperMode.BUSY:
            assert status.outcome is Outcome.NONE
            assert status.reason == ""
    assert 10 < busy < 60  # there and back
    assert (status.mode, status.number) == (GripperMode.IDLE, 1)
    assert (status.outcome, status.reason) == (Outcome.FAILED, "jaw hits cup")
    assert len(judge.asked) == 1


def test_an_object_that_does_not_follow_slips() -> None:
    gripper = lifting(Judge())  # its pose stays fixed
    time = gripper.context.get_time()
    while gripper.forces:
        time += 0.02
        assert time < 2.0
        status = gripper.advance_to(time)
    assert status.mode is GripperMode.BUSY
    assert status.held == ""
    assert status.stirring  # what it stirred may still move
    assert status.settling
    assert status.loose == ("brick",)
    status = gripper.advance_to(time + 1.0)
    assert status.mode is GripperMode.IDLE
    assert status.outcome is Outcome.SLIPPED
    assert status.reason
    assert not status.stirring
    assert not status.settling
    assert gripper.forces == []


def test_the_drawn_gripper_goes_to_the_grasp() -> None:
    gripper = Alone(Judge())
    home = gripper.position
    assert home.shape == (9,)
    assert np.linalg.norm(home[:4]) == pytest.approx(1.0)
    gripper.fix("action", take("brick"))
    gripper.advance_to(0.0)
    np.testing.assert_allclose(gripper.position, home, atol=1e-9)
    gripper.advance_to(0.2)  # half way
    way = gripper.position[4:7] - home[4:7]
    goal = np.array([0.05, 0.02, 0.01]) - home[4:7]
    np.testing.assert_allclose(way, 0.5 * goal, atol=1e-6)
    np.testing.assert_array_equal(gripper.position[7:], 0)  # open
    gripper.advance_to(0.42)
    assert gripper.status.held == "brick"
    np.testing.assert_allclose(gripper.position[4:7], [0.05, 0.02, 0.01])
    # 30 mm between the contacts of an opening of 50 mm.
    np.testing.assert_allclose(gripper.position[7:], 0.01, atol=1e-9)


class Cell:
    """A bin, a tote, objects, and the gripper that moves them."""

    def __init__(
        self,
        judge: Judge,
        poses: dict[str, np.ndarray],
        *models: ObjectModel,
        config: QuasiStaticConfig | None = None,
    ) -> None:
        builder = DiagramBuilder()
        self.plant, _ = add_plant(builder, default_plant_config())
        add_bin(self.plant, with_tote=True)
        items = add_objects(self.plant, models)
        for item in items:
            item.joint.SetDefaultPose(RigidTransform(poses[item.name]))
        self.plant.Finalize()
        self.items = {item.name: item for item in items}
        self.gripper = builder.AddSystem(
            QuasiStaticGripper(
                judge=judge,
                objects=models,
                bodies={item.name: int(item.body.index()) for item in items},
                drawn=DRAWN,
                config=config,
            )
        )
        plant, gripper = self.plant, self.gripper
        for source, target in (
            (plant.get_body_poses_output_port(), "body_poses"),
            (
                plant.get_body_spatial_velocities_output_port(),
                "body_spatial_velocities",
            ),
        ):
            builder.Connect(source, gripper.GetInputPort(target))
        builder.Connect(
            gripper.GetOutputPort("applied_spatial_force"),
            plant.get_applied_spatial_force_input_port(),
        )
        builder.ExportInput(gripper.GetInputPort("action"), "action")
        self.diagram: Diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        self.context: Context = self.simulator.get_mutable_context()
        self.command(SearchAction())

    def command(self, action: SearchAction) -> None:
        self.diagram.GetInputPort("action").FixValue(
            self.context, AbstractValue.Make(action)
        )

    def pose(self, name: str) -> np.ndarray:
        context = self.plant.GetMyContextFromRoot(self.context)
        return self.items[name].body.EvalPoseInWorld(context).GetAsMatrix4()

    def lock(self, name: str) -> None:
        self.items[name].joint.Lock(
            self.plant.GetMyMutableContextFromRoot(self.context)
        )

    @property
    def status(self) -> GripperStatus:
        return self.gripper.GetOutputPort("status").Eval(
            self.gripper.GetMyContextFromRoot(self.context)
        )

    def advance_until(self, *, stirring: bool) -> float:
        """Advances until the status says so; returns the time."""
        end = self.context.get_time() + 5.0
        while self.status.stirring is not stirring:
            self.simulator.AdvanceTo(self.context.get_time() + 0.02)
            assert self.context.get_time() < end
        return self.context.get_time()

    def run(self, action: SearchAction, limit: float = 8.0) -> list[np.ndarray]:
        """Runs an action to its end; returns the object's way, (n, 3)."""
        self.command(action)
        way = []
        end = self.context.get_time() + limit
        while True:
            self.simulator.AdvanceTo(self.context.get_time() + 0.05)
            way.append(self.pose(action.grasp.object)[:3, 3])
            done = self.status.mode is GripperMode.IDLE
            if done and self.status.number == action.number:
                return way
            assert self.context.get_time() < end


def in_tote(p_W: np.ndarray) -> bool:
    away = np.abs(p_W[:2] - TOTE_POSITION[:2])
    return bool((away < 0.18).all() and 0.0 < p_W[2] < BIN_WALL_HEIGHT)


@pytest.mark.parametrize("name", ["brick", "box_2to1"])
def test_it_lifts_carries_and_releases(name: str) -> None:
    models = {"brick": brick(), "box_2to1": target_model("box_2to1")}
    poses = {
        "brick": on_floor(0.05, 0.02),
        "box_2to1": on_floor(-0.1, 0.0, 0.0025),
    }
    cell = Cell(Judge(), poses, *models.values())
    (other,) = set(models) - {name}
    way = np.array(cell.run(take(name, X_WO=poses[name])))
    assert cell.status.outcome is Outcome.LIFTED
    assert cell.status.reason == ""
    assert in_tote(way[-1])
    # Over the walls it is 5 cm clear, all of it, and it bumps into nothing.
    over = (way[:, 0] > 0.23) & (way[:, 0] < 0.29)
    assert over.any()
    assert way[over, 2].min() > BIN_WALL_HEIGHT + 0.05
    np.testing.assert_allclose(
        cell.pose(other)[:3, 3], poses[other][:3, 3], atol=5e-4
    )
    cell.simulator.AdvanceTo(cell.context.get_time() + 0.3)
    np.testing.assert_allclose(cell.pose(name)[:3, 3], way[-1], atol=1e-3)


def test_the_next_object_goes_to_another_place() -> None:
    models = brick(), target_model("box_2to1")
    poses = {
        "brick": on_floor(0.05, 0.02),
        "box_2to1": on_floor(-0.1, 0.0, 0.0025),
    }
    cell = Cell(Judge(), poses, *models)
    for number, name in enumerate(poses, 1):
        cell.run(take(name, number, cell.pose(name)))
        assert cell.status.number == number
        assert cell.status.outcome is Outcome.LIFTED
    places = [cell.pose(name)[:3, 3] for name in poses]
    assert all(in_tote(place) for place in places)
    assert np.linalg.norm(places[0] - places[1]) > 0.05


def test_a_failure_leaves_the_plant_as_it_is() -> None:
    poses = {
        "brick": on_floor(0.05, 0.02),
        "box_2to1": on_floor(-0.1, 0.0, 0.0025),
    }
    cell = Cell(Judge(0.0, "no"), poses, brick(), target_model("box_2to1"))
    cell.run(take("brick"))
    assert cell.status.outcome is Outcome.FAILED
    for name, X_WO in poses.items():
        np.testing.assert_allclose(
            cell.pose(name)[:3, 3], X_WO[:3, 3], atol=5e-4
        )


def test_an_object_that_is_stuck_slips_and_stays() -> None:
    poses = {
        "brick": on_floor(0.05, 0.02),
        "box_2to1": on_floor(-0.1, 0.0, 0.0025),
    }
    cell = Cell(Judge(), poses, brick(), target_model("box_2to1"))
    cell.lock("brick")
    cell.run(take("brick"))
    assert cell.status.outcome is Outcome.SLIPPED
    np.testing.assert_array_equal(cell.pose("brick"), poses["brick"])


def test_it_holds_until_the_rest_is_at_rest() -> None:
    """A second object still falls while the first is lifted."""
    waiting = {}
    for height in (0.0025, 6.0):
        poses = {
            "brick": on_floor(0.05, 0.02),
            "box_2to1": on_floor(-0.1, 0.0, height),
        }
        cell = Cell(Judge(), poses, brick(), target_model("box_2to1"))
        cell.command(take("brick"))
        start = cell.advance_until(stirring=True)
        waiting[height] = cell.advance_until(stirring=False) - start
        assert cell.status.held == "brick"
        lowest = cell.pose("box_2to1")[2, 3]
    assert waiting[6.0] > waiting[0.0025] + 0.2
    assert lowest < 0.05  # it has landed meanwhile


def test_it_does_not_wait_for_ever() -> None:
    poses = {
        "brick": on_floor(0.05, 0.02),
        "box_2to1": on_floor(-0.1, 0.0, 200.0),  # falls into the bin
    }
    cell = Cell(
        Judge(),
        poses,
        brick(),
        target_model("box_2to1"),
        config=QuasiStaticConfig(rest_timeout=0.5),
    )
    cell.run(take("brick"), limit=5.0)
    assert cell.status.outcome is Outcome.LIFTED


def test_what_fell_out_of_the_cell_is_left_alone() -> None:
    """It falls on below the tote; the gripper neither follows nor waits."""
    poses = {
        "brick": on_floor(0.05, 0.02),
        "box_2to1": on_floor(0.0, 5.0, -0.2),
    }
    cell = Cell(Judge(), poses, brick(), target_model("box_2to1"))
    way = np.array(cell.run(take("brick"), limit=4.0))
    assert cell.pose("box_2to1")[2, 3] < -10.0
    assert cell.status.outcome is Outcome.LIFTED
    assert in_tote(way[-1])
    assert way[:, 2].min() > 0.0


def test_it_settles_between_the_lift_and_the_way_to_the_tote() -> None:
    cell = Cell(Judge(), {"brick": on_floor(0.05, 0.02)}, brick())
    cell.command(take("brick"))
    said: list[tuple[bool, bool, str]] = []
    while cell.context.get_time() < 4.0:
        cell.simulator.AdvanceTo(cell.context.get_time() + 0.02)
        status = cell.status
        now = (status.stirring, status.settling, status.held)
        if not said or said[-1] != now:
            said.append(now)
            if status.settling:  # all the way up
                assert cell.pose("brick")[2, 3] > BIN_WALL_HEIGHT + 0.05
    assert said == [
        (False, False, ""),
        (True, False, "brick"),
        (True, True, "brick"),
        (False, False, "brick"),
        (False, False, ""),
    ]


def test_an_object_alone_in_the_bin() -> None:
    cell = Cell(Judge(), {"brick": on_floor(0.05, 0.02)}, brick())
    way = cell.run(take("brick"))
    assert cell.status.outcome is Outcome.LIFTED
    assert in_tote(way[-1])
