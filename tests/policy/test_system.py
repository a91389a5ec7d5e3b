"""The SearchPolicy alone: inputs fixed, the planner scripted."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydrake.math import RigidTransform

from tests.alone import Alone
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.grasping.evidence.depth import SeenObject
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
from xray_drake.policy.choice_system import valid_options
from xray_drake.policy.ranking import Ranking, Scores, SearchView, largest
from xray_drake.policy.system import Foresight, SearchPolicy

NAMES = ("box", "book", "cup")
BODIES = {"box": 4, "book": 2, "cup": 3}
LABELS = np.repeat([[0] * 6 + [1] * 10 + [2] * 8], 12, axis=0)  # (12, 24)
RHO = np.linspace(0, 1, 12 * 24).reshape(12, 24)
K = np.array([[100.0, 0, 11.5], [0, 100.0, 5.5], [0, 0, 1]])
X_WC = np.diag([1.0, -1.0, -1.0, 1.0])
X_WC[2, 3] = 0.8
CAMERA = PinholeCamera(24, 12, K, X_WC)
NO_GRASP = (Rejection(GraspKind.JAW, "too wide", 7),)
TOO_WIDE = "jaw: 7 × too wide"
BUSY, IDLE = GripperMode.BUSY, GripperMode.IDLE


def names(action: SearchAction) -> list[str]:
    return [candidate.name for candidate in action.ranking]


class Planner:
    """Grasps some objects, and notes who asks for what, knowing what."""

    def __init__(self, *graspable: str, **quality: float) -> None:
        self.quality = dict.fromkeys(graspable, 1.0) | quality
        self.asked: list[tuple[str, tuple[Grasp, ...]]] = []
        self.known: list[Any] = []

    def plan(
        self,
        object_name: str,
        known: Any,
        *,
        excluded: Sequence[Grasp] = (),
    ) -> GraspPlan:
        self.asked.append((object_name, tuple(excluded)))
        self.known.append(known)
        if object_name not in self.quality:
            return GraspPlan(rejections=NO_GRASP)
        return GraspPlan(
            Grasp(
                GraspKind.JAW,
                object_name,
                width=0.01 * len(self.asked),
                quality=self.quality[object_name],
            )
        )

    @property
    def names_asked(self) -> list[str]:
        return [name for name, _ in self.asked]


class SeenPlanner(Planner):
    """Grasps the middle of a mask."""

    def plan(
        self,
        object_name: str,
        known: SeenObject,
        *,
        excluded: Sequence[Grasp] = (),
    ) -> GraspPlan:
        plan = super().plan(object_name, known, excluded=excluded)
        X_WG = np.diag([1.0, -1.0, -1.0, 1.0])
        points = known.camera.unproject(known.depth)
        X_WG[:3, 3] = points[known.mask].mean(axis=0)
        return GraspPlan(replace(plan.grasp, X_WG=X_WG))


class Policy(Alone):
    """A SearchPolicy with all inputs fixed, under simulation."""

    def __init__(
        self,
        planner: Planner,
        *,
        ranking: Ranking = largest,
        target_first: bool = False,
        bodies: dict[str, int] | None = BODIES,
        **options: Any,
    ) -> None:
        super().__init__(
            SearchPolicy(
                ranking=ranking,
                planner=planner,
                bodies=bodies,
                width=24,
                height=12,
                target_first=target_first,
                **options,
            ),
            occupancy=OccupancyDistribution(RHO),
            instances=InstanceMasks(LABELS, NAMES),
            target_mask=TargetMask(np.zeros(LABELS.shape)),
            status=GripperStatus(),
        )
        if bodies:
            self.fix(body_poses=[RigidTransform([0, 0, i]) for i in range(6)])

    def decide(self) -> SearchAction:
        self.advance()
        return self.output("action")

    def done(self, outcome: Outcome = Outcome.LIFTED) -> SearchAction:
        """Lets the action end, and returns the next."""
        number = self.output("action").number
        self.fix(status=GripperStatus(IDLE, number, outcome))
        return self.decide()


def test_the_first_decision_and_what_it_says() -> None:
    planner = Planner("cup", "book")
    policy = Policy(planner)
    target = np.zeros(LABELS.shape, bool)
    target[:4, :6] = True
    policy.fix(target_mask=TargetMask(target))
    action = policy.decide()
    assert (action.number, action.grasp.object) == (1, "book")
    assert names(action) == ["book", "cup", "box"]
    assert [c.score for c in action.ranking] == [120.0, 96.0, 72.0]
    assert (action.score, action.is_target) == (120.0, False)
    assert action.support == np.count_nonzero(RHO)
    assert action.support_01 == np.count_nonzero(RHO.astype("f4") > 0.1)
    assert action.target_pixels == 24
    stages = dict(action.seconds)
    assert list(stages) == ["perception", "occupancy", "ranking", "planning"]
    assert min(stages.values()) >= 0
    assert planner.names_asked == ["book"]
    (poses,) = planner.known
    assert {n: X[2, 3] for n, X in poses.items()} == BODIES


def test_it_waits_until_the_gripper_has_done_the_action() -> None:
    planner = Planner("book")
    policy = Policy(planner)
    assert policy.decide().number == 1
    for status in (
        GripperStatus(),  # not taken up yet
        GripperStatus(BUSY, 1),
        GripperStatus(BUSY, 0),
    ):
        policy.fix(status=status)
        assert policy.decide().number == 1
    assert len(planner.asked) == 1
    policy.fix(status=GripperStatus(IDLE, 1, Outcome.LIFTED))
    assert policy.decide().number == 2
    assert len(planner.asked) == 2


@pytest.mark.parametrize(
    "status", [GripperStatus(BUSY, 0), GripperStatus(IDLE, 3)]
)
def test_it_does_not_look_while_it_waits(status: GripperStatus) -> None:
    """Inputs other than the status are not even connected."""
    system = SearchPolicy(ranking=largest, planner=Planner(), bodies=BODIES)
    policy = Alone(system, status=status)
    policy.advance()
    policy.fix(status=GripperStatus())
    with pytest.raises(RuntimeError, match="not connected"):
        policy.advance()


WEAK = "quality {:.2f} < 0.4"


@pytest.mark.parametrize(
    ("quality", "chosen", "told"),
    [
        ({"box": 1.0}, "box", [TOO_WIDE, TOO_WIDE, ""]),
        ({"book": 0.5, "cup": 0.9}, "book", ["", "", ""]),  # good enough
        (
            {"book": 0.2, "cup": 0.3, "box": 0.5},
            "box",
            [WEAK.format(0.2), WEAK.format(0.3), ""],
        ),
        ({"cup": 0.2, "box": 0.9}, "box", [TOO_WIDE, WEAK.format(0.2), ""]),
        ({"cup": 0.2, "box": 0.1}, "cup", [TOO_WIDE, "", WEAK.format(0.1)]),
        ({}, "", [TOO_WIDE] * 3),
    ],
)
def test_the_first_with_a_good_grasp_else_with_any_and_why_not_the_others(
    quality: dict[str, float], chosen: str, told: list[str]
) -> None:
    planner = Planner(**quality)
    action = Policy(planner, min_grasp_quality=0.4).decide()
    assert (action.number, action.grasp.object) == (1, chosen)
    assert action.grasp.kind is (GraspKind.JAW if chosen else GraspKind.NONE)
    areas = {"book": 120.0, "cup": 96.0, "box": 72.0}
    assert action.score == areas.get(chosen, 0.0)
    assert names(action) == [*areas]
    assert [c.passed_over for c in action.ranking] == told
    assert not action.is_target


@pytest.mark.parametrize("unit", [1e-3, 1e3])
@pytest.mark.parametrize(
    ("hides", "quality", "chosen", "asked"),
    [
        ("book cup", {"cup": 0.2, "box": 0.9}, "cup", "book cup"),
        ("book cup", {"cup": 0.9, "box": 0.9}, "cup", "book cup"),
        (
            "book cup",
            {"book": 0.2, "cup": 0.3, "box": 0.9},
            "book",
            "book cup",
        ),
        # Where a weak grasp is on what hides nothing either, it is.
        ("book", {"cup": 0.2, "box": 0.9}, "box", "book cup box"),
        # What hides nothing is planned on where nothing else can be grasped.
        ("book cup", {"box": 0.3}, "box", "book cup box"),
        # Wherever it stands in the order.
        ("book box", {"book": 0.2, "cup": 0.9, "box": 0.9}, "box", "book box"),
        ("book box", {"book": 0.2, "cup": 0.9, "box": 0.3}, "book", "book box"),
    ],
)
def test_what_hides_nothing_is_not_worth_a_good_grasp(
    hides: str, quality: dict[str, float], chosen: str, asked: str, unit: float
) -> None:
    """In whatever unit the scores are."""

    def ranking(view: SearchView, rng: np.random.Generator) -> Scores:
        values = {"book": 3 * unit, "cup": 2 * unit, "box": unit}
        return Scores(
            np.array([[values[name]] for name in view.candidates]),
            np.array([name in hides for name in view.candidates]),
        )

    planner = Planner(**quality)
    policy = Policy(planner, ranking=ranking, min_grasp_quality=0.4)
    assert policy.decide().grasp.object == chosen
    assert planner.names_asked == asked.split()


@pytest.mark.parametrize(("least", "seen"), [(73, ["book", "cup"]), (1000, [])])
def test_objects_seen_too_little_are_not_candidates(
    least: int, seen: list[str]
) -> None:
    planner = Planner("box")
    action = Policy(planner, min_visible_pixels=least).decide()
    assert names(action) == planner.names_asked == seen
    assert (action.number, action.grasp.kind) == (1, GraspKind.NONE)


@pytest.mark.parametrize("outcome", [Outcome.FAILED, Outcome.SLIPPED])
def test_grasps_that_failed_are_excluded_from_then_on(
    outcome: Outcome,
) -> None:
    planner = Planner("book", "cup")
    policy = Policy(planner)
    first = policy.decide().grasp
    second = policy.done(outcome).grasp
    assert planner.asked[-1] == ("book", (first,))
    del planner.quality["book"]
    third = policy.done(outcome).grasp
    assert planner.asked[-2:] == [("book", (first, second)), ("cup", ())]
    policy.done(Outcome.LIFTED)
    assert planner.asked[-2:] == [("book", (first, second)), ("cup", ())]
    policy.done(outcome)
    name, excluded = planner.asked[-1]
    assert (name, len(excluded)) == ("cup", 1)
    assert third not in excluded  # it had lifted


@pytest.mark.parametrize("target_first", [True, False])
@pytest.mark.parametrize(
    ("graspable", "by_rank"),
    [(("box", "book"), "book"), (("book",), "book"), (("box",), "box")],
)
def test_target_first(
    target_first: bool, graspable: tuple[str, ...], by_rank: str
) -> None:
    policy = Policy(Planner(*graspable), target_first=target_first)
    policy.fix(target_mask=TargetMask(LABELS == 0))
    action = policy.decide()
    expected = graspable[0] if target_first else by_rank
    assert action.grasp.object == expected
    assert action.is_target == (expected == "box")
    assert action.ranking[0].name == ("box" if target_first else "book")
    assert action.score == {"box": 72.0, "book": 120.0}[expected]


def test_each_decision_has_a_generator_of_its_own() -> None:
    draws: list[float] = []

    def ranking(view: SearchView, rng: np.random.Generator) -> Scores:
        draws.append(rng.random())
        return largest(view, rng)

    for seed in (0, 1, 0):
        policy = Policy(Planner("book"), ranking=ranking, seed=seed)
        policy.decide()
        policy.done()
    assert len({*draws}) == 4
    assert draws[4:] == draws[:2]


class Inference:
    """Answers with the mask and notes what it is asked."""

    def __init__(self) -> None:
        self.asked: list[tuple[np.ndarray, np.ndarray, PinholeCamera]] = []

    def infer(
        self, depth: np.ndarray, target_mask: np.ndarray, camera: PinholeCamera
    ) -> OccupancyDistribution:
        self.asked.append((depth, target_mask, camera))
        return OccupancyDistribution(target_mask)


def test_what_a_ranking_is_given_beside_what_all_see() -> None:
    views: list[SearchView] = []

    def ranking(view: SearchView, rng: np.random.Generator) -> Scores:
        views.append(view)
        return largest(view, rng)

    inference = Inference()
    size = np.array([0.04, 0.02, 0.005])
    foresight = Foresight(inference, size)
    knowing = Policy(
        Planner("book"), ranking=ranking, foresight=foresight, truth=True
    )
    knowing.fix(
        depth_image=RHO + 0.5, camera=CAMERA, true_target=TargetMask(LABELS > 0)
    )
    for policy in (Policy(Planner("book"), ranking=ranking), knowing):
        policy.fix(target_mask=TargetMask(LABELS == 2))
        policy.decide()
    plain, view = views
    assert plain.target == view.target == "cup"
    assert plain.outlook is plain.true_mask is None
    np.testing.assert_array_equal(view.true_mask, LABELS > 0)
    outlook = view.outlook
    assert outlook is not None
    # The image may change; what the ranking was shown does not.
    knowing.fix(depth_image=RHO)
    np.testing.assert_allclose(outlook.depth, RHO + 0.5, rtol=1e-6)
    np.testing.assert_array_equal(outlook.target_mask, LABELS == 2)
    assert outlook.camera is CAMERA
    np.testing.assert_array_equal(outlook.target_size, size)
    answer = outlook.infer(RHO, LABELS == 1)
    np.testing.assert_array_equal(answer.data, LABELS == 1)
    ((depth, mask, camera),) = inference.asked
    assert (depth is RHO, camera is CAMERA) == (True, True)
    np.testing.assert_array_equal(mask, LABELS == 1)


def test_a_ranking_can_plan_and_each_grasp_is_planned_once() -> None:
    """With an object thought away it is another grasp."""
    planner = Planner("book", "cup")

    def ranking(view: SearchView, rng: np.random.Generator) -> Scores:
        assert view.plan is not None
        for without in (("book",), (), ("book",)):
            view.plan("cup", without=without)
        plans = [view.plan(name) for name in view.candidates]
        values = np.array([[plan.grasp.quality] for plan in plans])
        return Scores(values, np.ones(len(values), bool))

    action = Policy(planner, ranking=ranking).decide()
    assert planner.names_asked == ["cup", "cup", "box", "book"]
    assert [set(poses) for poses in planner.known] == [
        {"box", "cup"},
        *[set(NAMES)] * 3,
    ]
    assert action.grasp.object == "book"
    assert action.grasp.width == pytest.approx(0.04)  # of the fourth question


class BlindPolicy(Policy):
    """A SearchPolicy that plans from depth."""

    def __init__(self) -> None:
        self.planner = SeenPlanner("s0", "s1", "s2")
        super().__init__(self.planner, bodies=None)
        self.fix(camera=CAMERA)

    def see(self, *names: str, book: float = 0.03) -> np.ndarray:
        """Shows box, book and cup by these names; the book is so high."""
        depth = (0.8 - np.choose(LABELS, [0.02, book, 0.02])).astype("f4")
        self.fix(seen_depth_image=depth, instances=InstanceMasks(LABELS, names))
        return depth


def test_from_depth_it_plans_on_what_is_seen() -> None:
    """The target is the segment that the detector sees."""
    policy = BlindPolicy()
    depth = policy.see("s0", "s1", "s2")
    seen = LABELS == 1
    seen[:2] = False
    policy.fix(target_mask=TargetMask(seen))
    action = policy.decide()
    assert (action.grasp.object, action.is_target) == ("s1", True)
    assert policy.planner.asked == [("s1", ())]
    np.testing.assert_array_equal(policy.planner.known[0].depth, depth)
    np.testing.assert_array_equal(policy.planner.known[0].mask, LABELS == 1)


@pytest.mark.parametrize("outcome", [Outcome.FAILED, Outcome.SLIPPED])
def test_from_depth_a_failed_place_is_excluded_under_any_name(
    outcome: Outcome,
) -> None:
    policy = BlindPolicy()
    asked = policy.planner.asked
    policy.see("s0", "s1", "s2")
    policy.decide()
    policy.done(Outcome.LIFTED)
    assert asked[-1] == ("s1", ())
    first = policy.output("action").grasp
    policy.see("s1", "s2", "s0")
    second = policy.done(outcome).grasp
    assert asked[-1] == ("s2", (first,))
    policy.done(outcome)
    assert asked[-1] == ("s2", (first, second))
    # Not where it has changed; and what is forgotten stays so.
    policy.see("s0", "s1", "s2", book=0.01)
    policy.done(outcome)
    assert asked[-1] == ("s1", ())
    policy.see("s0", "s1", "s2")
    policy.done(Outcome.LIFTED)
    assert asked[-1] == ("s1", ())


@pytest.mark.parametrize(
    ("qualities", "least", "valid"),
    [
        ((0.9, 0.2, 0.1), 0.2, "ab"),  # good enough, at the bound too
        ((0.1, 0.0, 0.05), 0.2, "ac"),  # none is good: any grasp
        ((0.0, 0.0, 0.0), 0.2, ""),
        ((0.0, 0.01, 0.0), 0.0, "b"),  # without a bound
    ],
)
def test_what_some_ranking_would_have_grasped(
    qualities: tuple[float, ...], least: float, valid: str
) -> None:
    assert valid_options("abc", qualities, min_quality=least) == (*valid,)
