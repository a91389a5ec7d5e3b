"""The SearchPolicy that plans from depth: inputs fixed, planner scripted."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator
from pydrake.systems.sensors import ImageDepth32F

from tests.policy.test_system import Planner
from tests.ports import inputs_of
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
    SearchAction,
    TargetMask,
)
from xray_drake.policy.ranking import largest
from xray_drake.policy.system import DepthGrasps, SearchPolicy

WIDTH, HEIGHT = 64, 48
X_WC = np.diag([1.0, -1.0, -1.0, 1.0])
X_WC[2, 3] = 0.8
K = np.array([[100.0, 0, 31.5], [0, 100.0, 23.5], [0, 0, 1]])
CAMERA = PinholeCamera(WIDTH, HEIGHT, K, X_WC)
FLAT = np.full((HEIGHT, WIDTH), 0.8, np.float32)
LEFT = np.s_[10:30, 5:25]
RIGHT = np.s_[15:25, 40:50]


class SeenPlanner:
    """Grasps the middle of a mask, and notes who asks."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, tuple[Grasp, ...]]] = []
        self.depths: list[np.ndarray] = []

    def plan(
        self,
        object_name: str,
        known: SeenObject,
        *,
        excluded: Sequence[Grasp] = (),
    ) -> GraspPlan:
        self.asked.append((object_name, tuple(excluded)))
        mask, depth, camera = known
        self.depths.append(depth)
        X_WG = np.diag([1.0, -1.0, -1.0, 1.0])
        X_WG[:3, 3] = camera.unproject(depth)[mask].mean(axis=0)
        return GraspPlan(
            Grasp(GraspKind.SUCTION, object_name, X_WG, quality=0.8)
        )


def heap(*names: str, left: float = 0.03) -> tuple[np.ndarray, InstanceMasks]:
    """Two blocks and how they are called: the left one, the right one."""
    depth, labels = FLAT.copy(), np.full(FLAT.shape, -1)
    depth[LEFT] -= left
    depth[RIGHT] -= 0.02
    labels[LEFT], labels[RIGHT] = 0, 1
    return depth, InstanceMasks(labels, names)


class Policy:
    """A SearchPolicy that plans from depth, under simulation."""

    def __init__(self, planner: SeenPlanner, **options: Any) -> None:
        self.system = SearchPolicy(
            ranking=largest,
            planner=DepthGrasps(planner, WIDTH, HEIGHT),
            **options,
        )
        self.simulator = Simulator(self.system)
        self.context = self.simulator.get_mutable_context()
        self.fix("occupancy", OccupancyDistribution(np.zeros(FLAT.shape)))
        self.fix("target_mask", TargetMask(np.zeros(FLAT.shape)))
        self.fix("status", GripperStatus())
        self.fix("camera", CAMERA)

    def fix(self, port: str, message: Any) -> None:
        self.system.GetInputPort(port).FixValue(
            self.context, AbstractValue.Make(message)
        )

    def show(self, depth: np.ndarray, instances: InstanceMasks) -> None:
        image = ImageDepth32F(WIDTH, HEIGHT)
        image.mutable_data[:, :, 0] = depth
        self.fix("seen_depth_image", image)
        self.fix("instances", instances)

    def done(self, outcome: Outcome) -> SearchAction:
        """Lets the action end, and returns the next."""
        number = self.action.number
        self.fix("status", GripperStatus(GripperMode.IDLE, number, outcome))
        return self.advance()

    def advance(self) -> SearchAction:
        self.simulator.AdvanceTo(self.context.get_time() + 0.2)
        return self.action

    @property
    def action(self) -> SearchAction:
        return self.system.GetOutputPort("action").Eval(self.context)


def test_it_needs_no_poses() -> None:
    system = Policy(SeenPlanner()).system
    assert inputs_of(system) == [
        *("occupancy", "instances", "target_mask", "status"),
        *("seen_depth_image", "camera"),
    ]
    assert not system.HasAnyDirectFeedthrough()


def test_models_need_bodies() -> None:
    with pytest.raises(ValueError, match="bodies"):
        SearchPolicy(ranking=largest, planner=Planner())


def test_it_plans_on_what_is_seen() -> None:
    planner = SeenPlanner()
    policy = Policy(planner)
    depth, instances = heap("segment_0", "segment_1")
    policy.show(depth, instances)
    action = policy.advance()
    assert action.grasp.object == "segment_0"
    assert planner.asked == [("segment_0", ())]
    np.testing.assert_array_equal(planner.depths[0], depth)


def test_the_target_is_the_segment_that_the_detector_sees() -> None:
    policy = Policy(SeenPlanner())
    policy.show(*heap("segment_0", "segment_1"))
    mask = np.zeros(FLAT.shape, bool)
    mask[16:25, 41:52] = True
    policy.fix("target_mask", TargetMask(mask))
    action = policy.advance()
    assert (action.grasp.object, action.is_target) == ("segment_1", True)


@pytest.mark.parametrize("outcome", [Outcome.FAILED, Outcome.SLIPPED])
def test_a_failed_place_is_excluded_under_any_name(outcome: Outcome) -> None:
    planner = SeenPlanner()
    policy = Policy(planner)
    policy.show(*heap("segment_0", "segment_1"))
    first = policy.advance().grasp
    policy.show(*heap("segment_1", "segment_0"))
    second = policy.done(outcome).grasp
    assert planner.asked[-1] == ("segment_1", (first,))
    policy.done(outcome)
    assert planner.asked[-1] == ("segment_1", (first, second))


def test_a_place_that_has_changed_is_not() -> None:
    planner = SeenPlanner()
    policy = Policy(planner)
    policy.show(*heap("segment_0", "segment_1"))
    policy.advance()
    policy.show(*heap("segment_0", "segment_1", left=0.01))
    policy.done(Outcome.FAILED)
    assert planner.asked[-1] == ("segment_0", ())
    # And what is forgotten stays so.
    policy.show(*heap("segment_0", "segment_1"))
    policy.done(Outcome.LIFTED)
    assert planner.asked[-1] == ("segment_0", ())


def test_what_lifted_is_not_excluded() -> None:
    planner = SeenPlanner()
    policy = Policy(planner)
    policy.show(*heap("segment_0", "segment_1"))
    policy.advance()
    policy.done(Outcome.LIFTED)
    assert planner.asked[-1] == ("segment_0", ())
