import logging
from collections.abc import Callable
from dataclasses import replace
from itertools import combinations, pairwise
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.nominal import BIN
from tests.scene.placed import Placed
from xray_drake.geometry.resting import resting_poses
from xray_drake.scene import drop as module
from xray_drake.scene.contact import ContactConfig
from xray_drake.scene.drop import drop_heap
from xray_drake.scene.heap import (
    Heap,
    HeapConfig,
    HeapError,
)
from xray_drake.scene.library import make_object
from xray_drake.scene.object_model import ObjectModel
from xray_drake.scene.plant import PlantObject
from xray_drake.scene.rest import box_corners
from xray_drake.scene.targets import target_model
from xray_drake.seeding import stream

TARGET = target_model("box_2to1")
OBJECTS = [make_object(name) for name in ("brick_003", "disc_001", "star_002")]

MANY = [
    *OBJECTS,
    *map(make_object, ("spoon_001", "bowl_003", "gear_001", "car_002")),
]

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
    placed = Placed(heap.models, heap.poses)
    placed.advance(duration)
    moved = {}
    for model in heap.models:
        corners = box_corners(model, placed.pose(model.name))
        step = corners - box_corners(model, heap.poses[model.name])
        moved[model.name] = float(np.linalg.norm(step, axis=1).max())
    return moved


def lowest(model: ObjectModel, X_WO: np.ndarray) -> float:
    vertices = np.concatenate(model.pieces)
    return float((vertices @ X_WO[2, :3]).min() + X_WO[2, 3])


def test_a_dropped_heap_rests_in_the_bin_and_not_under_its_floor(
    heap: Heap,
) -> None:
    assert max(motion(heap, 0.5).values()) < 1e-3
    assert heap.models == (TARGET, *OBJECTS)
    assert set(heap.poses) == {model.name for model in heap.models}
    for model in heap.models:
        X_WO = heap.poses[model.name]
        assert BIN.is_over(X_WO[:3, 3])
        assert -2e-3 < lowest(model, X_WO) < 0.1  # edges sink in a little
        np.testing.assert_allclose(
            X_WO[:3, :3] @ X_WO[:3, :3].T, np.eye(3), atol=1e-9
        )
    assert (heap.seed, heap.num_dropped, heap.attempts) == (10_000, 3, 1)
    assert 4 * 0.28 < heap.settle_time < 4 * 0.28 + 8.0


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
    assert all(BIN.is_over(X_WO[:3, 3]) for X_WO in heap.poses.values())


def test_a_heap_without_its_target_is_drawn_again(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with caplog.at_level(logging.WARNING):
        heap = first_wide_heap(lambda heap: "target left" in caplog.text)
    assert heap.attempts > 1
    assert BIN.is_over(heap.poses["box_2to1"][:3, 3])
    assert lowest(TARGET, heap.poses["box_2to1"]) < 0.1
    assert len(heap.failures) == heap.attempts - 1
    for attempt, failure in enumerate(heap.failures, start=1):
        assert f"seed {heap.seed}, draw {attempt}" in failure
        assert failure in caplog.text
    assert f"seed {heap.seed}, draw {heap.attempts}" not in caplog.text


@pytest.mark.parametrize(
    ("config", "contact", "reason"),
    [
        (
            {"rest_timeout": 0.05, "drop_period": 0.05},
            {},
            "no rest within 0.05 s",
        ),
        ({"drop_height": np.nan}, {}, "NaN"),
        ({"drop_height": np.nan, "sleep": True}, {}, "NaN"),
        ({}, {"pressure_gradient": 1e30}, "stopped"),
    ],
)
def test_a_seed_that_fails_again_and_again(
    config: dict[str, Any],
    contact: dict[str, float],
    reason: str,
    caplog: pytest.LogCaptureFixture,
) -> None:
    with (
        caplog.at_level(logging.WARNING),
        pytest.raises(HeapError, match="seed 10003: 2 heaps") as caught,
    ):
        drop_heap(
            TARGET,
            OBJECTS[:1],
            10_003,
            config=HeapConfig(max_attempts=2, **config),
            contact=ContactConfig(**contact),
        )
    assert "\n" not in str(caught.value)
    assert caplog.text.count("seed 10003, draw") == 2
    assert caplog.text.count(reason) == 2


def test_a_growing_heap_is_remembered() -> None:
    """What was there before has at most been pushed by what fell on it."""
    grown = drop_heap(TARGET, OBJECTS, 10_000, snapshots=(1, 2, 3))
    heaps = (*grown.growth, grown)
    assert [heap.num_dropped for heap in heaps] == [1, 2, 3]
    times = [heap.settle_time for heap in heaps]
    assert times == sorted(times)
    for heap in grown.growth:
        assert heap.models == (TARGET, *OBJECTS[: heap.num_dropped])
        assert set(heap.poses) == {model.name for model in heap.models}
        assert all(BIN.is_over(X_WO[:3, 3]) for X_WO in heap.poses.values())
        assert (heap.seed, heap.attempts, heap.growth) == (10_000, 1, ())
    for before, after in pairwise(heaps):
        for name in before.poses:
            step = after.poses[name][:3, 3] - before.poses[name][:3, 3]
            assert np.linalg.norm(step) < 0.1
    assert max(motion(grown, 0.5).values()) < 1e-3


@pytest.mark.parametrize(
    ("config", "snapshots"),
    [
        (HeapConfig(), (2,)),
        (HeapConfig(sleep=True), ()),
        (HeapConfig(arrangement="dump"), ()),
        (HeapConfig(arrangement="dump", sleep=True), ()),
    ],
    ids=["snapshots", "sleep", "dump", "dump and sleep"],
)
def test_however_it_is_dropped_the_seed_makes_the_same_heap(
    config: HeapConfig, snapshots: tuple[int, ...]
) -> None:
    one, other = (
        drop_heap(TARGET, OBJECTS, 10_001, config=config, snapshots=snapshots)
        for _ in range(2)
    )
    assert len(one.growth) == len(other.growth) == len(snapshots)
    for a, b in zip((*one.growth, one), (*other.growth, other), strict=True):
        assert a.settle_time == b.settle_time
        assert list(a.poses) == list(b.poses)
        for name, X_WO in a.poses.items():
            np.testing.assert_array_equal(b.poses[name], X_WO)


def test_what_is_dumped_overlaps_nothing_before_it_falls(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bounds: list[tuple[np.ndarray, np.ndarray]] = []
    release = module._Drop._release

    def noted(drop: Any, item: PlantObject, *where: Any) -> None:
        release(drop, item, *where)
        X_WO = drop._pose(item)
        points = item.model.visual.vertices @ X_WO[:3, :3].T + X_WO[:3, 3]
        bounds.append((points.min(axis=0), points.max(axis=0)))

    monkeypatch.setattr(module._Drop, "_release", noted)
    config = HeapConfig(arrangement="dump")
    assert drop_heap(TARGET, OBJECTS, 10_001, config=config).attempts == 1
    target, *dumped = bounds
    assert target[0][2] == pytest.approx(0.05)  # alone
    assert min(low[2] for low, _ in dumped) == pytest.approx(0.25, abs=2e-3)
    for (low, high), (other_low, other_high) in combinations(dumped, 2):
        assert ((low >= other_high) | (other_low >= high)).any()
    half = np.array([config.tray_length, config.tray_width]) / 2
    for low, high in dumped:
        fits = (high - low)[:2] < 2 * half
        assert (np.maximum(-low, high)[:2] < half + 1e-9)[fits].all()


@pytest.mark.parametrize(
    ("arrangement", "sleep", "seed"),
    [
        ("one_by_one", True, 10_002),
        ("dump", True, 10_002),
        ("dump", False, 10_003),
    ],
)
def test_however_it_is_dropped_a_heap_rests_when_all_are_awake(
    arrangement: str, sleep: bool, seed: int
) -> None:
    config = HeapConfig(arrangement=arrangement, sleep=sleep)
    heap = drop_heap(TARGET, MANY, seed, config=config)
    assert heap.attempts == 1
    assert heap.num_dropped == len(MANY)
    assert len(heap.objects) >= len(MANY) - 1
    assert max(motion(heap, 1.0).values()) < 1e-3
    for model in heap.models:
        X_WO = heap.poses[model.name]
        assert BIN.is_over(X_WO[:3, 3])
        assert -3e-3 < lowest(model, X_WO) < 0.1
    if arrangement == "dump":  # all fell at once
        assert heap.settle_time < len(MANY) * 0.28 + 4.0


DUMP = {"config": HeapConfig(arrangement="dump")}
PILE = {"config": HeapConfig(arrangement="pile")}
TWIN = replace(OBJECTS[0], name="box_2to1")


@pytest.mark.parametrize(
    ("objects", "options", "reason"),
    [
        ([], {}, "at least one object"),
        ([TWIN], {}, "distinct names.*box_2to1"),
        (OBJECTS, {**DUMP, "snapshots": (1,)}, "no snapshots"),
        (OBJECTS, {"snapshots": (1, 4)}, "each must be from 1 to 3"),
        (OBJECTS, PILE, "pile.*one_by_one, dump"),
    ],
)
def test_a_heap_that_cannot_be_asked_for(
    objects: list[ObjectModel], options: dict[str, Any], reason: str
) -> None:
    with pytest.raises(ValueError, match=reason):
        drop_heap(TARGET, objects, 1, **options)


@pytest.mark.parametrize(
    ("seed", "contact"),
    [
        (10_001, ContactConfig()),
        (10_000, ContactConfig(tumble_time=0.1, dissipation=10.0)),
    ],
    ids=["seed", "material"],
)
def test_another_seed_or_material_makes_another_heap(
    heap: Heap, seed: int, contact: ContactConfig
) -> None:
    other = drop_heap(TARGET, OBJECTS, seed, contact=contact)
    steps = [
        np.abs(other.poses[name] - X_WO)[:3, 3].max()
        for name, X_WO in heap.poses.items()
    ]
    assert (min if seed != heap.seed else max)(steps) > 1e-6


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


@pytest.mark.parametrize(
    ("target", "turned"),
    [
        ("box_2to1", [0.0, 0.0]),
        ("box_2to1", [0.0, np.pi]),
        ("cube", [np.pi / 2, 0]),
    ],
)
def test_tilt_is_measured_from_either_face(
    tiny_heap: Heap, target: str, turned: list[float]
) -> None:
    """Of a tall target from any face on which it can lie."""
    X_WO = np.eye(4)
    turn = Rotation.from_euler("zx", [1.0, 0.3])
    X_WO[:3, :3] = (turn * Rotation.from_euler("xy", turned)).as_matrix()
    tilted = replace(
        tiny_heap, target=target_model(target), poses={target: X_WO}
    )
    assert tilted.target_tilt == pytest.approx(0.3, abs=1e-6)
    assert tiny_heap.target_tilt == 0.0


@pytest.mark.parametrize(
    ("target", "more"), [("box_2to1", []), ("cube", [(7, "resting pose", 1)])]
)
def test_a_flat_target_draws_from_no_other_stream(
    target: str, more: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """So heaps over flat targets are as if there were no tall ones."""
    asked = []

    def recorded(*arguments: Any) -> Any:
        asked.append(arguments)
        return stream(*arguments)

    monkeypatch.setattr(module, "stream", recorded)
    drop_heap(target_model(target), OBJECTS[:1], 7)
    assert asked == [(7, "heap", 1), *more]


def test_a_tall_target_falls_in_its_resting_poses() -> None:
    mug = target_model("mug")
    poses = resting_poses(mug.visual, mug.p_OCom)
    drawn = [module._lying(mug, seed, 1).matrix() for seed in range(300)]
    assert np.array_equal(module._lying(mug, 5, 1).matrix(), drawn[5])
    share = [
        np.mean([np.allclose(R, pose.R_WO, atol=1e-9) for R in drawn])
        for pose in poses
    ]
    assert sum(share) == pytest.approx(1)
    expected = np.array([pose.probability for pose in poses])
    # Three standard deviations and a half.
    slack = 3.5 * np.sqrt(expected * (1 - expected) / len(drawn))
    assert (np.abs(np.array(share) - expected) <= slack).all()
