import logging
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial.transform import Rotation

from xray_drake.scene.heap import Heap, HeapConfig, HeapError, drop_heap
from xray_drake.scene.library import make_object
from xray_drake.scene.object_model import ObjectModel
from xray_drake.scene.plant import (
    add_bin,
    add_objects,
    add_plant,
    default_plant_config,
    inside_bin,
)
from xray_drake.scene.rest import box_corners
from xray_drake.scene.targets import target_model

TARGET = target_model("box_2to1")
OBJECTS = [make_object(name) for name in ("brick_003", "disc_001", "star_002")]

WIDE = HeapConfig(
    offset_sigma=0.3,
    offset_limit=0.5,
    drop_height=0.1,
    drop_period=0.1,
    rest_timeout=2.0,
)
"""So wide that some things fall beside the bin."""


@pytest.fixture(scope="module")
def heap() -> Heap:
    return drop_heap(TARGET, OBJECTS, 10_000)


def motion(heap: Heap, duration: float) -> dict[str, float]:
    """Returns how far each object moves from its pose in the heap, m."""
    builder = DiagramBuilder()
    plant, _ = add_plant(builder, default_plant_config())
    add_bin(plant)
    items = add_objects(plant, heap.models)
    for item in items:
        item.joint.SetDefaultPose(RigidTransform(heap.poses[item.name]))
    plant.Finalize()
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(duration)
    context = plant.GetMyContextFromRoot(simulator.get_context())
    moved = {}
    for item in items:
        now = item.body.EvalPoseInWorld(context).GetAsMatrix4()
        step = box_corners(item.model, now) - box_corners(
            item.model, heap.poses[item.name]
        )
        moved[item.name] = float(np.linalg.norm(step, axis=1).max())
    return moved


def lowest(model: ObjectModel, X_WO: np.ndarray) -> float:
    vertices = np.concatenate(model.pieces)
    return float((vertices @ X_WO[2, :3]).min() + X_WO[2, 3])


def test_a_dropped_heap_rests(heap: Heap) -> None:
    assert set(motion(heap, 0.5)) == {"box_2to1", *(m.name for m in OBJECTS)}
    assert max(motion(heap, 0.5).values()) < 1e-3


def test_a_dropped_heap_lies_in_the_bin_and_not_under_its_floor(
    heap: Heap,
) -> None:
    assert heap.models == (TARGET, *OBJECTS)
    assert set(heap.poses) == {model.name for model in heap.models}
    for model in heap.models:
        X_WO = heap.poses[model.name]
        assert inside_bin(X_WO[:3, 3])
        assert -2e-3 < lowest(model, X_WO) < 0.1  # edges sink in a little
        np.testing.assert_allclose(
            X_WO[:3, :3] @ X_WO[:3, :3].T, np.eye(3), atol=1e-9
        )
    assert (heap.seed, heap.num_dropped, heap.attempts) == (10_000, 3, 1)
    assert 4 * 0.28 < heap.settle_time < 4 * 0.28 + 8.0


def test_a_heap_is_made_again_by_its_seed_bit_by_bit(heap: Heap) -> None:
    again = drop_heap(TARGET, OBJECTS, 10_000)
    assert again.settle_time == heap.settle_time
    for name, X_WO in heap.poses.items():
        np.testing.assert_array_equal(again.poses[name], X_WO)


def test_another_seed_makes_another_heap(heap: Heap) -> None:
    other = drop_heap(TARGET, OBJECTS, 10_001)
    for name, X_WO in heap.poses.items():
        step = other.poses[name][:3, 3] - X_WO[:3, 3]
        assert np.linalg.norm(step) > 5e-3


def test_the_target_lies_under_what_falls_after_it(tiny_heap: Heap) -> None:
    config = HeapConfig(center_range=0.0, offset_sigma=1e-3, offset_limit=2e-3)
    book = tiny_heap.objects[0]
    stacked = drop_heap(TARGET, [book], 10_000, config=config)
    target, above = stacked.poses["box_2to1"], stacked.poses["book"]
    assert lowest(TARGET, target) == pytest.approx(0.0, abs=1e-3)
    assert stacked.target_tilt < np.deg2rad(5)
    assert above[2, 3] > target[2, 3] + 0.005
    np.testing.assert_allclose(target[:2, 3], 0, atol=0.02)


def first_wide_heap(wanted: Callable[[Heap], bool]) -> Heap:
    """Drops heaps until one is as wanted; nearly every second one is."""
    for seed in range(10_000, 10_008):
        heap = drop_heap(TARGET, OBJECTS, seed, config=WIDE)
        if wanted(heap):
            return heap
    raise AssertionError("none of eight heaps is as wanted")


def test_what_falls_beside_the_bin_is_removed() -> None:
    heap = first_wide_heap(lambda heap: len(heap.objects) < 3)
    assert heap.num_dropped == 3
    assert heap.objects
    assert set(heap.poses) == {model.name for model in heap.models}
    assert all(inside_bin(X_WO[:3, 3]) for X_WO in heap.poses.values())


def test_a_heap_without_its_target_is_drawn_again(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with caplog.at_level(logging.WARNING):
        heap = first_wide_heap(lambda heap: "target left" in caplog.text)
    assert heap.attempts > 1
    X_WT = heap.poses["box_2to1"]
    assert inside_bin(X_WT[:3, 3])
    assert X_WT[2, 3] < 0.1
    failed = [f"seed {heap.seed}, draw {i}" for i in range(1, heap.attempts)]
    assert all(draw in caplog.text for draw in failed)
    assert f"seed {heap.seed}, draw {heap.attempts}" not in caplog.text


def test_a_seed_that_fails_again_and_again(
    caplog: pytest.LogCaptureFixture,
) -> None:
    config = HeapConfig(rest_timeout=0.05, drop_period=0.05, max_attempts=2)
    with (
        caplog.at_level(logging.WARNING),
        pytest.raises(HeapError, match="seed 10003: 2 heaps") as caught,
    ):
        drop_heap(TARGET, OBJECTS[:1], 10_003, config=config)
    assert "\n" not in str(caught.value)
    assert caplog.text.count("no rest within 0.05 s") == 2


def test_nothing_beside_the_target() -> None:
    with pytest.raises(ValueError, match="at least one object"):
        drop_heap(TARGET, [], 1)


def test_two_objects_of_one_name() -> None:
    twin = replace(OBJECTS[0], name="box_2to1")
    with pytest.raises(ValueError, match=r"distinct names.*box_2to1"):
        drop_heap(TARGET, [twin], 1)


def test_progress_goes_up_to_one() -> None:
    shares: list[float] = []
    config = HeapConfig(drop_period=0.1)
    drop_heap(
        TARGET, OBJECTS[:2], 10_000, config=config, progress=shares.append
    )
    assert shares == sorted(shares)
    assert len(shares) == 3
    assert shares[0] > 0
    assert shares[-1] == 1.0


@pytest.mark.parametrize("face", [0.0, np.pi])
def test_tilt_is_measured_from_either_face(
    tiny_heap: Heap, face: float
) -> None:
    X_WO = np.eye(4)
    X_WO[:3, :3] = (
        Rotation.from_euler("z", 1.0)
        * Rotation.from_euler("x", 0.3)
        * Rotation.from_euler("y", face)
    ).as_matrix()
    tilted = replace(tiny_heap, poses=tiny_heap.poses | {"box_2to1": X_WO})
    assert tilted.target_tilt == pytest.approx(0.3)
    assert tiny_heap.target_tilt == 0.0


def test_the_tiny_heap_of_the_tests_rests(tiny_heap: Heap) -> None:
    assert max(motion(tiny_heap, 0.5).values()) < 3e-4
