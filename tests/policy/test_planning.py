"""Planning at one look, the planners scripted."""

import copy
from collections.abc import Sequence

import numpy as np
import pytest

from xray_drake.grasping.evidence.depth import SeenObject
from xray_drake.messages import Grasp, GraspKind, GraspPlan, InstanceMasks
from xray_drake.policy.planning import (
    PLACE_RADIUS,
    DepthPlanning,
    FailedGrasp,
    ModelPlanning,
    place_of,
    still_there,
)
from xray_drake.testing.tiny import Observation


class SeenPlanner:
    """Grasps whatever it is asked for, and notes what it was shown."""

    def __init__(self) -> None:
        self.masks: list[np.ndarray] = []
        self.depths: list[np.ndarray] = []
        self.excluded: list[tuple[Grasp, ...]] = []

    def plan(
        self,
        object_name: str,
        known: SeenObject,
        *,
        excluded: Sequence[Grasp] = (),
    ) -> GraspPlan:
        self.masks.append(known.mask)
        self.depths.append(known.depth)
        self.excluded.append(tuple(excluded))
        return GraspPlan(Grasp(GraspKind.JAW, object_name, quality=0.5))


@pytest.fixture
def instances(recorded_observation: Observation) -> InstanceMasks:
    """The tiny heap's objects, as segments."""
    seen = recorded_observation
    labels = np.full(seen.labels.shape, -1)
    for index, label in enumerate(seen.label_of.values()):
        labels[seen.labels == label] = index
    return InstanceMasks(
        labels, tuple(f"segment_{i}" for i in range(len(seen.label_of)))
    )


def segment(observation: Observation, name: str) -> str:
    return f"segment_{list(observation.label_of).index(name)}"


def grasp_on(observation: Observation, name: str, **shift: float) -> Grasp:
    X_WG = np.diag([1.0, -1.0, -1.0, 1.0])
    X_WG[:3, 3] = observation.heap.poses[name][:3, 3]
    X_WG[0, 3] += shift.get("x", 0.0)
    return Grasp(GraspKind.JAW, "segment_7", X_WG, quality=0.4)


def without(observation: Observation, name: str) -> np.ndarray:
    """The depth image with the floor where an object is seen."""
    floor = observation.camera.plane_depth(0.0).astype(np.float32)
    gone = observation.labels == observation.label_of[name]
    return np.where(gone, floor, observation.depth)


def test_each_instance_is_planned_once(
    recorded_observation: Observation, instances: InstanceMasks
) -> None:
    planner, seen = SeenPlanner(), recorded_observation
    plan = DepthPlanning(planner, instances, seen.depth, seen.camera, ())
    book = segment(seen, "book")
    planned = plan(book)
    assert (planned.grasp.object, plan(book)) == (book, planned)
    assert len(planner.masks) == 1
    np.testing.assert_array_equal(
        planner.masks[0], seen.labels == seen.label_of["book"]
    )
    np.testing.assert_array_equal(planner.depths[0], seen.depth)


def test_an_object_thought_away_is_not_in_the_image(
    recorded_observation: Observation, instances: InstanceMasks
) -> None:
    planner, seen = SeenPlanner(), recorded_observation
    plan = DepthPlanning(planner, instances, seen.depth, seen.camera, ())
    plan(segment(seen, "pad"))
    plan(segment(seen, "pad"), without=(segment(seen, "book"),))
    plan(segment(seen, "pad"), without=[segment(seen, "book")])
    assert len(planner.depths) == 2
    book = seen.labels == seen.label_of["book"]
    before, after = (np.nan_to_num(d, posinf=0.0) for d in planner.depths)
    np.testing.assert_array_equal(after[~book], before[~book])
    # It lies 25 mm high; its edge may stand on what is seen beside it.
    assert np.percentile((after - before)[book], 5) > 0.015
    # Its mask is what is seen of it still.
    np.testing.assert_array_equal(planner.masks[0], planner.masks[1])


def test_what_failed_is_excluded_whatever_it_is_called(
    recorded_observation: Observation, instances: InstanceMasks
) -> None:
    planner, seen = SeenPlanner(), recorded_observation
    failed = FailedGrasp(grasp_on(seen, "book"))
    plan = DepthPlanning(planner, instances, seen.depth, seen.camera, (failed,))
    plan("segment_0")
    assert planner.excluded == [(failed.grasp,)]


def test_models_exclude_by_name() -> None:
    class Models:
        def __init__(self) -> None:
            self.asked: list[tuple[set[str], tuple[Grasp, ...]]] = []

        def plan(self, object_name, poses, *, excluded=()) -> GraspPlan:  # type: ignore[no-untyped-def]
            self.asked.append((set(poses), tuple(excluded)))
            return GraspPlan(Grasp(GraspKind.JAW, object_name))

    planner = Models()
    failed = [FailedGrasp(Grasp(GraspKind.JAW, name)) for name in ("a", "b")]
    plan = ModelPlanning(planner, {"a": np.eye(4), "b": np.eye(4)}, failed)
    plan("a")
    plan("b", without=("a",))
    assert planner.asked == [
        ({"a", "b"}, (failed[0].grasp,)),
        ({"b"}, (failed[1].grasp,)),
    ]


def test_a_place_is_what_is_seen_around_a_grasp(
    recorded_observation: Observation,
) -> None:
    seen = recorded_observation
    grasp = grasp_on(seen, "block")
    place = place_of(grasp, seen.depth, seen.camera)
    away = np.hypot(*(place - grasp.X_WG[:3, 3])[:, :2].T)
    assert away.max() < PLACE_RADIUS
    # A disc of pixels 1.45 mm apart, less where the block is nearer.
    assert len(place) == pytest.approx(np.pi * 0.04**2 / 0.00145**2, rel=0.2)
    assert 0.05 < place[:, 2].max() < 0.061
    assert len(place_of(Grasp(), seen.depth, seen.camera)) == 0


def test_a_place_lasts_until_something_there_has_gone(
    recorded_observation: Observation,
) -> None:
    seen = recorded_observation
    camera = seen.camera
    failed = FailedGrasp(
        grasp_on(seen, "book"),
        place_of(grasp_on(seen, "book"), seen.depth, camera),
    )
    assert still_there(failed, seen.depth, camera)
    assert still_there(failed, without(seen, "block"), camera)
    assert not still_there(failed, without(seen, "book"), camera)


@pytest.mark.parametrize(("pixels", "lasts"), [(8, True), (14, False)])
def test_a_thin_thing_that_has_gone_changes_its_place(
    recorded_observation: Observation, pixels: int, lasts: bool
) -> None:
    """As thin as a target, 12 or 20 mm wide, beside a grasp."""
    seen = recorded_observation
    grasp = grasp_on(seen, "block")
    failed = FailedGrasp(grasp, place_of(grasp, seen.depth, seen.camera))
    u, v, _ = np.rint(seen.camera.project(grasp.X_WG[:3, 3])).astype(int)
    depth = seen.depth.copy()
    depth[v : v + pixels, u : u + pixels] += 0.005
    assert still_there(failed, depth, seen.camera) == lasts


def test_noise_and_lost_readings_change_no_place(
    recorded_observation: Observation,
) -> None:
    seen = recorded_observation
    failed = FailedGrasp(
        grasp_on(seen, "book"),
        place_of(grasp_on(seen, "book"), seen.depth, seen.camera),
    )
    rng = np.random.default_rng(0)
    noisy = seen.depth + rng.normal(scale=0.001, size=seen.depth.shape)
    noisy[rng.random(noisy.shape) < 0.3] = 0.0
    assert still_there(failed, noisy, seen.camera)
    nothing = np.full_like(seen.depth, np.nan)
    assert not still_there(failed, nothing, seen.camera)


def test_without_a_place_it_is_for_good(
    recorded_observation: Observation,
) -> None:
    seen = recorded_observation
    failed = FailedGrasp(grasp_on(seen, "book"))
    assert still_there(failed, without(seen, "book"), seen.camera)


def test_a_failure_is_not_copied() -> None:
    """Drake copies all state at each event."""
    failed = FailedGrasp(Grasp(), np.ones((5, 3)))
    assert copy.deepcopy(failed) is failed
    with pytest.raises(ValueError, match="read-only"):
        failed.place[0] = 0.0
