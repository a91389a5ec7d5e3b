"""Planning at one look, the planners scripted."""

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from xray_drake.messages import Grasp, GraspKind, GraspPlan
from xray_drake.policy.planning import (
    PLACE_RADIUS,
    FailedGrasp,
    place_of,
    planning_on_images,
    planning_on_models,
    still_there,
)
from xray_drake.testing.tiny import Observation


class Planner:
    """Grasps whatever it is asked for, and notes what it was told."""

    def __init__(self) -> None:
        self.known: list[Any] = []
        self.excluded: list[tuple[Grasp, ...]] = []

    def plan(
        self, object_name: str, known: Any, *, excluded: Sequence[Grasp] = ()
    ) -> GraspPlan:
        self.known.append(known)
        self.excluded.append(tuple(excluded))
        return GraspPlan(Grasp(GraspKind.JAW, object_name, quality=0.5))


def grasp_on(observation: Observation, name: str) -> Grasp:
    X_WG = np.diag([1.0, -1.0, -1.0, 1.0])
    X_WG[:3, 3] = observation.heap.poses[name][:3, 3]
    return Grasp(GraspKind.JAW, "segment_7", X_WG, quality=0.4)


def failed_on(seen: Observation, name: str) -> FailedGrasp:
    grasp = grasp_on(seen, name)
    return FailedGrasp(grasp, place_of(grasp, seen.depth, seen.camera))


def without(observation: Observation, name: str) -> np.ndarray:
    """The depth image with the floor where an object is seen."""
    floor = observation.camera.plane_depth(0.0).astype(np.float32)
    gone = observation.labels == observation.label_of[name]
    return np.where(gone, floor, observation.depth)


def test_from_depth_each_instance_is_planned_once(
    recorded_observation: Observation,
) -> None:
    """What failed is excluded, whatever it is called."""
    planner, seen = Planner(), recorded_observation
    failed = failed_on(seen, "book")
    plan = planning_on_images(
        planner, seen.instances, seen.depth, seen.camera, (failed,)
    )
    planned = plan("book")
    assert (planned.grasp.object, plan("book")) == ("book", planned)
    assert planner.excluded == [(failed.grasp,)]
    (known,) = planner.known
    book = seen.labels == seen.label_of["book"]
    np.testing.assert_array_equal(known.mask, book)
    np.testing.assert_array_equal(known.depth, seen.depth)


def test_an_object_thought_away_is_not_in_the_image(
    recorded_observation: Observation,
) -> None:
    planner, seen = Planner(), recorded_observation
    plan = planning_on_images(
        planner, seen.instances, seen.depth, seen.camera, ()
    )
    plan("block")
    plan("block", without=("book",))
    plan("block", without=["book"])
    now, then = planner.known
    book = seen.labels == seen.label_of["book"]
    before, after = (np.nan_to_num(k.depth, posinf=0.0) for k in (now, then))
    np.testing.assert_array_equal(after[~book], before[~book])
    # It lies 25 mm high; its edge may stand on what is seen beside it.
    assert np.percentile((after - before)[book], 5) > 0.015
    # Its mask is what is seen of it still.
    np.testing.assert_array_equal(now.mask, then.mask)


def test_models_exclude_by_name() -> None:
    planner = Planner()
    failed = [FailedGrasp(Grasp(GraspKind.JAW, name)) for name in ("a", "b")]
    plan = planning_on_models(planner, {"a": np.eye(4), "b": np.eye(4)}, failed)
    plan("a")
    plan("b", without=("a",))
    assert [set(poses) for poses in planner.known] == [{"a", "b"}, {"b"}]
    assert planner.excluded == [(failed[0].grasp,), (failed[1].grasp,)]


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
    seen, camera = recorded_observation, recorded_observation.camera
    failed = failed_on(seen, "book")
    rng = np.random.default_rng(0)
    noisy = seen.depth + rng.normal(scale=0.001, size=seen.depth.shape)
    noisy[rng.random(noisy.shape) < 0.3] = 0.0
    for same in (seen.depth, without(seen, "block"), noisy):
        assert still_there(failed, same, camera)
    for other in (without(seen, "book"), np.full_like(seen.depth, np.nan)):
        assert not still_there(failed, other, camera)
    # Without a place it is for good.
    placeless = FailedGrasp(failed.grasp)
    assert still_there(placeless, without(seen, "book"), camera)


@pytest.mark.parametrize(("pixels", "lasts"), [(8, True), (14, False)])
def test_a_thin_thing_that_has_gone_changes_its_place(
    recorded_observation: Observation, pixels: int, lasts: bool
) -> None:
    """As thin as a target, 12 or 20 mm wide, beside a grasp."""
    seen = recorded_observation
    failed = failed_on(seen, "block")
    p_WG = failed.grasp.X_WG[:3, 3]
    u, v, _ = np.rint(seen.camera.project(p_WG)).astype(int)
    depth = seen.depth.copy()
    depth[v : v + pixels, u : u + pixels] += 0.005
    assert still_there(failed, depth, seen.camera) == lasts


def test_a_failure_is_not_copied() -> None:
    """Drake copies all state at each event."""
    failed = FailedGrasp(Grasp(), np.ones((5, 3)))
    assert copy.deepcopy(failed) is failed
    with pytest.raises(ValueError, match="read-only"):
        failed.place[0] = 0.0
