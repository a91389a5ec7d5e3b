"""The SearchPolicy alone: inputs fixed, the planner scripted."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.sensors import ImageDepth32F

from tests.ports import inputs_of
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.messages import (
    Grasp,
    GraspKind,
    GraspPlan,
    GripperMode,
    GripperStatus,
    InstanceMasks,
    OccupancyDistribution,
    Outcome,
    Rejection,
    SearchAction,
    TargetMask,
)
from xray_drake.policy.ranking import (
    Ranking,
    Scores,
    SearchView,
    largest,
    random,
    xray,
)
from xray_drake.policy.system import Foresight, SearchPolicy

NAMES = ("box", "book", "cup")
BODIES = {"box": 4, "book": 2, "cup": 3}
LABELS = np.repeat([[0] * 6 + [1] * 10 + [2] * 8], 12, axis=0)  # (12, 24)
RHO = np.linspace(0, 1, 12 * 24).reshape(12, 24)
DONE = GripperStatus(GripperMode.IDLE, 1, Outcome.LIFTED)


NO_GRASP = (Rejection(GraspKind.JAW, "too wide", 7),)


def names(action: SearchAction) -> list[str]:
    return [candidate.name for candidate in action.ranking]


class Planner:
    """Has one grasp for each name in ``graspable``, and notes who asks."""

    def __init__(
        self, *graspable: str, quality: Mapping[str, float] | None = None
    ) -> None:
        self.graspable = graspable
        self.quality = quality or {}
        self.asked: list[tuple[str, tuple[Grasp, ...]]] = []
        self.poses: Mapping[str, np.ndarray] = {}

    def plan(
        self,
        object_name: str,
        poses: Mapping[str, np.ndarray],
        *,
        excluded: Sequence[Grasp] = (),
    ) -> GraspPlan:
        self.asked.append((object_name, tuple(excluded)))
        self.poses = poses
        if object_name not in self.graspable:
            return GraspPlan(rejections=NO_GRASP)
        return GraspPlan(
            Grasp(
                GraspKind.JAW,
                object_name,
                width=0.01 * len(self.asked),
                quality=self.quality.get(object_name, 1.0),
            )
        )

    @property
    def names_asked(self) -> list[str]:
        return [name for name, _ in self.asked]


class Policy:
    """A SearchPolicy with all inputs fixed, under simulation."""

    def __init__(
        self,
        planner: Planner,
        *,
        ranking: Ranking = largest,
        target_first: bool = False,
        min_visible_pixels: int = 50,
        min_grasp_quality: float = 0.0,
        foresight: Foresight | None = None,
        truth: bool = False,
        seed: int = 0,
    ) -> None:
        self.system = SearchPolicy(
            ranking=ranking,
            planner=planner,
            bodies=BODIES,
            target_first=target_first,
            min_visible_pixels=min_visible_pixels,
            min_grasp_quality=min_grasp_quality,
            foresight=foresight,
            truth=truth,
            seed=seed,
        )
        self.simulator = Simulator(self.system)
        self.context = self.simulator.get_mutable_context()
        self.fix("occupancy", OccupancyDistribution(RHO))
        self.fix("instances", InstanceMasks(LABELS, NAMES))
        self.fix("target_mask", TargetMask(np.zeros(LABELS.shape)))
        self.fix("status", GripperStatus())
        self.fix_poses(0.0)

    def fix(self, port: str, message: Any) -> None:
        self.system.GetInputPort(port).FixValue(
            self.context, AbstractValue.Make(message)
        )

    def fix_poses(self, shift: float) -> None:
        poses = [RigidTransform([shift, 0.0, 0.1 * i]) for i in range(6)]
        self.system.GetInputPort("body_poses").FixValue(
            self.context, AbstractValue.Make(poses)
        )

    def advance(self, duration: float = 0.2) -> SearchAction:
        self.simulator.AdvanceTo(self.context.get_time() + duration)
        return self.action

    @property
    def action(self) -> SearchAction:
        return self.system.GetOutputPort("action").Eval(self.context)


def test_ports_are_named() -> None:
    system = Policy(Planner()).system
    assert inputs_of(system) == [
        "occupancy",
        "instances",
        "target_mask",
        "status",
        "body_poses",
    ]
    assert system.num_output_ports() == 1
    assert system.get_output_port().get_name() == "action"
    assert system.get_name() == "search_policy"


def test_the_action_depends_on_state_alone() -> None:
    """Or policy and gripper would make an algebraic loop."""
    system = Policy(Planner()).system
    assert not system.HasAnyDirectFeedthrough()


def test_nothing_is_decided_before_the_first_event() -> None:
    planner = Planner("book")
    policy = Policy(planner)
    assert policy.action.number == 0
    assert not policy.action.grasp
    assert planner.asked == []


def test_the_first_decision_and_what_it_says() -> None:
    planner = Planner("cup", "book")
    policy = Policy(planner)
    target = np.zeros(LABELS.shape, bool)
    target[:4, :6] = True
    policy.fix("target_mask", TargetMask(target))
    action = policy.advance()
    assert action.number == 1
    assert action.grasp.object == "book"
    assert names(action) == ["book", "cup", "box"]
    assert [c.score for c in action.ranking] == [120.0, 96.0, 72.0]
    assert action.score == 120.0
    assert not action.is_target
    assert action.support == np.count_nonzero(RHO)
    assert action.support_01 == np.count_nonzero(RHO.astype("f4") > 0.1)
    assert action.target_pixels == 24
    stages = dict(action.seconds)
    assert list(stages) == ["perception", "occupancy", "ranking", "planning"]
    assert min(stages.values()) >= 0
    assert planner.names_asked == ["book"]


def test_the_planner_gets_the_poses_of_the_bodies() -> None:
    planner = Planner("book")
    policy = Policy(planner)
    policy.fix_poses(0.3)
    policy.advance()
    assert set(planner.poses) == set(NAMES)
    for name, index in BODIES.items():
        expected = RigidTransform([0.3, 0.0, 0.1 * index])
        np.testing.assert_array_equal(
            planner.poses[name], expected.GetAsMatrix4()
        )


def test_it_waits_until_the_gripper_has_done_the_action() -> None:
    planner = Planner("book")
    policy = Policy(planner)
    assert policy.advance().number == 1
    for status in (
        GripperStatus(),  # not taken up yet
        GripperStatus(GripperMode.BUSY, 1),
        GripperStatus(GripperMode.BUSY, 0),
    ):
        policy.fix("status", status)
        assert policy.advance().number == 1
    assert len(planner.asked) == 1
    policy.fix("status", DONE)
    assert policy.advance().number == 2
    assert len(planner.asked) == 2


@pytest.mark.parametrize(
    "status",
    [GripperStatus(GripperMode.BUSY, 0), GripperStatus(GripperMode.IDLE, 3)],
)
def test_it_does_not_look_while_it_waits(status: GripperStatus) -> None:
    """Inputs other than the status are not even connected."""
    system = SearchPolicy(ranking=largest, planner=Planner(), bodies=BODIES)
    simulator = Simulator(system)
    port = system.GetInputPort("status")
    context = simulator.get_mutable_context()
    port.FixValue(context, AbstractValue.Make(status))
    simulator.AdvanceTo(0.2)
    port.FixValue(context, AbstractValue.Make(GripperStatus()))
    with pytest.raises(RuntimeError, match="not connected"):
        simulator.AdvanceTo(0.4)


def test_it_takes_the_next_in_the_ranking_that_has_a_grasp() -> None:
    planner = Planner("box")
    action = Policy(planner).advance()
    assert planner.names_asked == ["book", "cup", "box"]
    assert action.grasp.object == "box"
    assert names(action) == ["book", "cup", "box"]
    assert action.score == 72.0


@pytest.mark.parametrize(
    ("quality", "chosen", "score"),
    [
        ({"book": 0.5, "cup": 0.9}, "book", 120.0),  # good enough
        ({"book": 0.2, "cup": 0.3, "box": 0.5}, "box", 72.0),
        ({"book": 0.2, "cup": 0.3, "box": 0.1}, "book", 120.0),  # all weak
    ],
)
def test_a_weak_grasp_where_there_is_no_better_one(
    quality: dict[str, float], chosen: str, score: float
) -> None:
    planner = Planner(*quality, quality=quality)
    action = Policy(planner, min_grasp_quality=0.4).advance()
    assert action.grasp.object == chosen
    assert action.score == score


@pytest.mark.parametrize(
    ("quality", "chosen"),
    [
        ({"cup": 0.2, "box": 0.9}, "cup"),  # the book has no grasp
        ({"cup": 0.9, "box": 0.9}, "cup"),
        ({"book": 0.2, "cup": 0.3, "box": 0.9}, "book"),
        ({"box": 0.3}, "box"),
    ],
)
def test_what_hides_nothing_is_not_worth_a_good_grasp(
    quality: dict[str, float], chosen: str
) -> None:
    planner = Planner(*quality, quality=quality)
    policy = Policy(planner, ranking=xray, min_grasp_quality=0.4)
    under = {"book": 1.0, "cup": 0.5, "box": 0.001}
    rho = np.choose(LABELS, [under[name] for name in NAMES])
    policy.fix("occupancy", OccupancyDistribution(rho))
    action = policy.advance()
    assert names(action) == ["book", "cup", "box"]
    assert action.grasp.object == chosen
    # It is not even planned on, where anything else can be grasped.
    assert ("box" in planner.names_asked) == (chosen == "box")


@pytest.mark.parametrize("unit", [1e-3, 1e3])
def test_a_scores_unit_does_not_matter(unit: float) -> None:
    """Nor where in the order what hides nothing stands."""

    def ranking(view: SearchView, rng: np.random.Generator) -> Scores:
        values = {"book": 3 * unit, "cup": 2 * unit, "box": unit}
        hides = {"book": True, "cup": False, "box": True}
        return Scores(
            np.array([[values[name]] for name in view.candidates]),
            np.array([hides[name] for name in view.candidates]),
        )

    quality = {"book": 0.2, "cup": 0.9, "box": 0.9}
    planner = Planner(*quality, quality=quality)
    policy = Policy(planner, ranking=ranking, min_grasp_quality=0.4)
    assert policy.advance().grasp.object == "box"
    assert planner.names_asked == ["book", "box"]
    planner.quality = {**quality, "box": 0.3}
    policy.fix("status", DONE)
    assert policy.advance().grasp.object == "book"


def test_whoever_is_passed_over_is_told_why() -> None:
    quality = {"cup": 0.2, "box": 0.9}
    planner = Planner(*quality, quality=quality)
    policy = Policy(planner, min_grasp_quality=0.4)
    assert [c.passed_over for c in policy.advance().ranking] == [
        "jaw: 7 × too wide",
        "quality 0.20 < 0.4",
        "",
    ]
    planner.quality = {**quality, "box": 0.1}
    policy.fix("status", DONE)
    told = [c.passed_over for c in policy.advance().ranking]
    assert told == ["jaw: 7 × too wide", "", "quality 0.10 < 0.4"]


def test_no_grasp_at_all_is_an_action_too() -> None:
    planner = Planner()
    action = Policy(planner).advance()
    assert action.number == 1
    assert action.grasp.kind is GraspKind.NONE
    assert not action.is_target
    assert planner.names_asked == ["book", "cup", "box"]
    assert {c.passed_over for c in action.ranking} == {"jaw: 7 × too wide"}


def test_nothing_seen_is_no_grasp() -> None:
    planner = Planner(*NAMES)
    policy = Policy(planner)
    policy.fix("instances", InstanceMasks(np.full(LABELS.shape, -1), ()))
    action = policy.advance()
    assert (action.number, action.ranking) == (1, ())
    assert action.grasp.kind is GraspKind.NONE
    assert planner.asked == []


def test_objects_seen_too_little_are_not_candidates() -> None:
    planner = Planner("box")
    action = Policy(planner, min_visible_pixels=73).advance()
    assert names(action) == ["book", "cup"]
    assert not action.grasp


@pytest.mark.parametrize("outcome", [Outcome.FAILED, Outcome.SLIPPED])
def test_grasps_that_failed_are_excluded_from_then_on(
    outcome: Outcome,
) -> None:
    planner = Planner("book", "cup")
    policy = Policy(planner)
    first = policy.advance().grasp
    policy.fix("status", GripperStatus(GripperMode.IDLE, 1, outcome))
    second = policy.advance().grasp
    assert planner.asked[-1] == ("book", (first,))
    policy.fix("status", GripperStatus(GripperMode.IDLE, 2, outcome))
    planner.graspable = ("cup",)
    third = policy.advance().grasp
    assert planner.asked[-2:] == [("book", (first, second)), ("cup", ())]
    policy.fix("status", GripperStatus(GripperMode.IDLE, 3, Outcome.LIFTED))
    policy.advance()
    assert planner.asked[-2:] == [("book", (first, second)), ("cup", ())]
    policy.fix("status", GripperStatus(GripperMode.IDLE, 4, outcome))
    policy.advance()
    excluded = planner.asked[-1][1]
    assert planner.asked[-1][0] == "cup"
    assert len(excluded) == 1
    assert third not in excluded  # it had lifted


@pytest.mark.parametrize("target_first", [True, False])
@pytest.mark.parametrize("graspable", [("box", "book"), ("book",)])
def test_target_first(target_first: bool, graspable: tuple[str, ...]) -> None:
    planner = Planner(*graspable)
    policy = Policy(planner, target_first=target_first)
    policy.fix("target_mask", TargetMask(LABELS == 0))
    action = policy.advance()
    expected = graspable[0] if target_first else "book"
    assert action.grasp.object == expected
    assert action.is_target == (expected == "box")
    assert action.ranking[0].name == ("box" if target_first else "book")
    assert action.score == {"box": 72.0, "book": 120.0}[expected]


def test_the_target_by_its_rank_is_the_target_too() -> None:
    policy = Policy(Planner("box"))
    policy.fix("target_mask", TargetMask(LABELS == 0))
    action = policy.advance()
    assert action.is_target
    assert names(action) == ["book", "cup", "box"]


def recorder(
    draws: list[float],
) -> Ranking:
    def ranking(view: SearchView, rng: np.random.Generator) -> Scores:
        draws.append(rng.random())
        return largest(view, rng)

    return ranking


def test_each_decision_has_a_generator_of_its_own() -> None:
    draws: dict[int, list[float]] = {0: [], 1: []}
    for seed, seen in draws.items():
        policy = Policy(Planner("book"), ranking=recorder(seen), seed=seed)
        policy.advance()
        policy.fix("status", DONE)
        policy.advance()
    again: list[float] = []
    Policy(Planner(), ranking=recorder(again), seed=0).advance()
    assert len({*draws[0], *draws[1]}) == 4
    assert again == draws[0][:1]


def test_reading_the_action_decides_nothing() -> None:
    planner = Planner(*NAMES)
    policy = Policy(planner, ranking=random)
    first = policy.advance()
    policy.context.SetTime(7.0)
    policy.fix("occupancy", OccupancyDistribution(0 * RHO))
    assert policy.action is first
    assert len(planner.asked) == 1


def test_masks_of_another_image() -> None:
    policy = Policy(Planner("book"))
    policy.fix("target_mask", TargetMask(np.zeros((5, 5))))
    with pytest.raises(ValueError, match=r"\(5, 5\)"):
        policy.advance()


class Inference:
    """Answers with the mask and notes what it is asked."""

    def __init__(self) -> None:
        self.asked: list[tuple[np.ndarray, np.ndarray, PinholeCamera]] = []

    def infer(
        self, depth: np.ndarray, target_mask: np.ndarray, camera: PinholeCamera
    ) -> OccupancyDistribution:
        self.asked.append((depth, target_mask, camera))
        return OccupancyDistribution(target_mask)


def viewed(
    views: list[SearchView],
) -> Ranking:
    def ranking(view: SearchView, rng: np.random.Generator) -> Scores:
        views.append(view)
        return largest(view, rng)

    return ranking


def test_without_foresight_or_truth_a_ranking_has_neither() -> None:
    views: list[SearchView] = []
    policy = Policy(Planner("book"), ranking=viewed(views))
    policy.fix("target_mask", TargetMask(LABELS == 2))
    policy.advance()
    (view,) = views
    assert view.outlook is None
    assert view.true_mask is None
    assert view.target == "cup"


def test_with_foresight_it_can_infer_from_other_images() -> None:
    views: list[SearchView] = []
    inference = Inference()
    size = np.array([0.04, 0.02, 0.005])
    policy = Policy(
        Planner("book"),
        ranking=viewed(views),
        foresight=Foresight(inference, size, width=24, height=12),
    )
    image = ImageDepth32F(24, 12)
    image.mutable_data[:, :, 0] = RHO + 0.5
    camera = PinholeCamera(24, 12, np.eye(3), np.eye(4))
    policy.fix("depth_image", image)
    policy.fix("camera", camera)
    policy.fix("target_mask", TargetMask(LABELS == 2))
    policy.advance()
    outlook = views[0].outlook
    assert outlook is not None
    np.testing.assert_allclose(outlook.depth, RHO + 0.5, rtol=1e-6)
    np.testing.assert_array_equal(outlook.target_mask, LABELS == 2)
    assert outlook.camera is camera
    np.testing.assert_array_equal(outlook.target_size, size)
    answer = outlook.infer(RHO, LABELS == 1)
    np.testing.assert_array_equal(answer.data, LABELS == 1)
    ((depth, mask, asked),) = inference.asked
    assert depth is RHO
    np.testing.assert_array_equal(mask, LABELS == 1)
    assert asked is camera
    # The image may change; what the ranking was shown does not.
    image.mutable_data[:] = 0
    np.testing.assert_allclose(outlook.depth, RHO + 0.5, rtol=1e-6)


def test_with_truth_it_knows_where_the_target_is() -> None:
    views: list[SearchView] = []
    policy = Policy(Planner("book"), ranking=viewed(views), truth=True)
    policy.fix("true_target", TargetMask(LABELS == 1))
    policy.advance()
    assert views[0].true_mask is not None
    np.testing.assert_array_equal(views[0].true_mask, LABELS == 1)


def test_a_grasp_that_the_ranking_asked_for_is_planned_once() -> None:
    planner = Planner("book", "cup")

    def ranking(view: SearchView, rng: np.random.Generator) -> Scores:
        assert view.plan is not None
        plans = [view.plan(name) for name in view.candidates]
        values = np.array([[plan.grasp.quality] for plan in plans])
        return Scores(values, np.ones(len(values), bool))

    action = Policy(planner, ranking=ranking).advance()
    assert planner.names_asked == ["box", "book", "cup"]
    assert action.grasp.object == "book"
    assert action.grasp.width == pytest.approx(0.02)  # of the second question


def test_a_ranking_can_think_objects_away() -> None:
    planner = Planner("book", "cup")
    poses: list[Mapping[str, np.ndarray]] = []

    def ranking(view: SearchView, rng: np.random.Generator) -> Scores:
        assert view.plan is not None
        for without in (("book",), (), ("book",)):
            view.plan("cup", without=without)
            poses.append(planner.poses)
        return largest(view, rng)

    Policy(planner, ranking=ranking).advance()
    assert [set(p) for p in poses] == [{"box", "cup"}, set(NAMES), set(NAMES)]
    assert planner.names_asked == ["cup", "cup", "book"]


def test_grasps_that_failed_are_excluded_for_the_ranking_too() -> None:
    planner = Planner("book", "cup")

    def ranking(view: SearchView, rng: np.random.Generator) -> Scores:
        assert view.plan is not None
        view.plan("book", without=("cup",))
        return largest(view, rng)

    policy = Policy(planner, ranking=ranking)
    first = policy.advance().grasp
    policy.fix("status", GripperStatus(GripperMode.IDLE, 1, Outcome.FAILED))
    policy.advance()
    assert planner.asked[-2:] == [("book", (first,)), ("book", (first,))]
