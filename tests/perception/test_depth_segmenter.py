"""Synthetic heaps whose objects are known."""

from collections.abc import Sequence

import cv2
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.occupancy.brute_force import render
from tests.occupancy.label_scenes import walls
from tests.occupancy.scenes import CAMERAS, lying, make_camera
from tests.perception.segmentation_metrics import score_segmentation
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.messages import InstanceMasks
from xray_drake.perception.depth_noise import DepthNoise
from xray_drake.perception.depth_segmenter import (
    DepthSegmenterConfig,
    segment_depth,
)
from xray_drake.testing.tiny import Observation

CAMERA = CAMERAS["nominal"]
HALF = make_camera(focal_length=276, center=(127.5, 95.5), size=(256, 192))


def block(
    size: Sequence[float],
    x: float,
    y: float,
    angle: float = 0.0,
    z: float = 0.0,
) -> trimesh.Trimesh:
    mesh = lying(trimesh.creation.box(size), x, y, angle)
    return mesh.apply_translation([0, 0, z])


def three_blocks() -> list[trimesh.Trimesh]:
    return [
        block((0.08, 0.05, 0.03), -0.1, 0.05, 0.3),
        block((0.05, 0.05, 0.06), 0.02, -0.04, 0.8),
        block((0.12, 0.02, 0.006), 0.1, 0.08, -0.5),
    ]


def segment(
    meshes: Sequence[trimesh.Trimesh], camera: PinholeCamera = CAMERA
) -> tuple[InstanceMasks, np.ndarray]:
    """Returns what is found, and the truth."""
    depth, label = render(camera, list(meshes))
    return segment_depth(depth.astype(np.float32), camera), label


def assert_one_each(found: InstanceMasks, truth: np.ndarray) -> None:
    """All objects are found, each in one piece, and nothing else is."""
    score = score_segmentation(truth, found.labels)
    assert score.objects == len(np.unique(truth[truth >= 0]))
    assert score.segments == score.objects
    assert score.mean_iou > 0.9


@pytest.mark.parametrize("name", CAMERAS)
def test_blocks_apart(name: str) -> None:
    assert_one_each(*segment(three_blocks(), CAMERAS[name]))


def test_one_across_another() -> None:
    low = block((0.12, 0.06, 0.02), 0, 0, 0.2)
    for thickness in (0.012, 0.03):
        high = block((0.03, 0.16, thickness), 0.01, 0, 0.3, z=0.02)
        found, truth = segment([low, high])
        score = score_segmentation(truth, found.labels)
        # The lower one is seen in two parts.
        assert (score.segments, score.recall) == (3, 1)
        for name in found.names:
            own = truth[found.mask(name)]
            assert max(np.mean(own == 0), np.mean(own == 1)) > 0.95


def test_two_boards_that_make_a_valley() -> None:
    boards = []
    for side in (-1, 1):
        board = trimesh.creation.box((0.06, 0.08, 0.01))
        board.apply_transform(
            trimesh.transformations.rotation_matrix(side * 0.9, [0, 1, 0])
        )
        # Their lower edges meet in the middle.
        board.apply_translation(
            [-board.bounds[(1 + side) // 2, 0], 0, -board.bounds[0, 2]]
        )
        boards.append(board)
    assert_one_each(*segment(boards))


def bowl() -> trimesh.Trimesh:
    wall = trimesh.creation.annulus(0.03, 0.04, 0.05)
    bottom = trimesh.creation.cylinder(0.031, 0.01)
    bottom.apply_translation([0, 0, wall.bounds[0, 2] + 0.005])
    return trimesh.util.concatenate([wall, bottom])


@pytest.mark.parametrize(
    ("shape", "tilt"),
    [
        pytest.param(trimesh.creation.icosphere(4, 0.03), 0.0, id="ball"),
        pytest.param(trimesh.creation.cylinder(0.02, 0.1), 0.6, id="cylinder"),
        pytest.param(trimesh.creation.cylinder(0.02, 0.1), 1.57, id="rod"),
        pytest.param(trimesh.creation.box([0.05] * 3), 0.6, id="cube"),
        pytest.param(trimesh.creation.cone(0.04, 0.07), 0.0, id="cone"),
        pytest.param(trimesh.creation.cone(0.04, 0.07), 1.57, id="lying cone"),
        pytest.param(bowl(), 0.0, id="bowl"),
    ],
)
def test_what_is_convex_or_a_bowl_is_one(
    shape: trimesh.Trimesh, tilt: float
) -> None:
    turned = shape.copy().apply_transform(
        trimesh.transformations.rotation_matrix(tilt, [1, 0.3, 0])
    )
    assert_one_each(*segment([lying(turned, 0.05, 0.04, 0.0)]))


def test_what_is_flush_cannot_be_told_apart() -> None:
    found, _ = segment(
        [
            block((0.05, 0.05, 0.03), -0.025, 0),
            block((0.05, 0.05, 0.03), 0.025, 0),
        ]
    )
    assert len(found.names) == 1


@pytest.mark.parametrize("name", CAMERAS)
def test_the_bin_is_no_object(name: str) -> None:
    found, _ = segment(walls(), CAMERAS[name])
    assert found.names == ()
    assert np.all(found.labels == -1)
    beside_a_wall = block((0.05, 0.05, 0.03), 0.22, 0)
    found, truth = segment([beside_a_wall, *walls()], CAMERAS[name])
    assert_one_each(found, np.where(truth == 0, 0, -1))


@pytest.mark.parametrize("nothing", [0.0, np.inf, np.nan, -1.0])
def test_no_reading_at_all(nothing: float) -> None:
    depth = np.full(CAMERA.shape, nothing, np.float32)
    found = segment_depth(depth, CAMERA)
    assert found.names == ()
    target = np.zeros(CAMERA.shape, bool)
    target[100:110, 200:220] = True
    found = segment_depth(depth, CAMERA, target=target)
    np.testing.assert_array_equal(found.labels, np.where(target, 0, -1))


def test_holes() -> None:
    depth, truth = render(CAMERA, three_blocks())
    rng = np.random.default_rng(3)
    lost = rng.random(depth.shape) < 0.05
    lost[:, 250:255] = True
    depth[lost] = 0.0
    score = score_segmentation(truth, segment_depth(depth, CAMERA).labels)
    assert score.recall == 1
    assert score.mean_iou > 0.85


@pytest.mark.parametrize("seed", range(3))
def test_a_noisy_sensor(seed: int) -> None:
    depth, truth = render(CAMERA, three_blocks())
    noisy = DepthNoise().noisy(depth, 552.5, np.random.default_rng(seed))
    found = segment_depth(noisy, CAMERA)
    score = score_segmentation(truth, found.labels)
    assert (score.recall, score.segments) == (1, 3)
    assert score.mean_iou > 0.75


def test_the_target_is_an_instance_whatever_the_depth() -> None:
    depth, _ = render(CAMERA, [block((0.12, 0.1, 0.02), 0, 0)])
    small, large = np.zeros((2, *CAMERA.shape), bool)
    small[180:195, 240:260] = True  # flush with the plate
    small[5:9, 5:9] = True  # and a part outside the bin
    large[150:250, 100:250] = True
    for target, name in ((small, "segment_1"), (large, "segment_0")):
        found = segment_depth(depth, CAMERA, target=target)
        assert found.names == ("segment_0", "segment_1")
        np.testing.assert_array_equal(found.mask(name), target)
    blank = segment_depth(depth, CAMERA, target=np.zeros(CAMERA.shape, bool))
    np.testing.assert_array_equal(
        blank.labels, segment_depth(depth, CAMERA).labels
    )
    assert blank.names == ("segment_0",)


def test_small_things_are_no_instances() -> None:
    pea = block((0.008, 0.008, 0.02), 0.1, 0.1)
    assert segment([pea])[0].names == ()
    depth, _ = render(CAMERA, [pea])
    found = segment_depth(depth, CAMERA, DepthSegmenterConfig(min_area=20))
    assert found.names == ("segment_0",)


def test_images_of_another_camera() -> None:
    depth = np.ones((10, 20), np.float32)
    with pytest.raises(ValueError, match=r"depth image is \(10, 20\)"):
        segment_depth(depth, CAMERA)
    with pytest.raises(ValueError, match=r"target mask is \(10, 20\)"):
        segment_depth(np.ones(CAMERA.shape), CAMERA, target=depth > 0)


def test_a_rendered_heap(recorded_observation: Observation) -> None:
    """The target, the book on it, block and plank; not the bin."""
    seen = recorded_observation
    target = seen.labels == seen.label_of[seen.heap.target.name]
    found = segment_depth(seen.depth, seen.camera, target=target)
    assert_one_each(found, seen.instances.labels)


BLOCKS = st.tuples(
    st.floats(0.02, 0.09),
    st.floats(0.02, 0.09),
    st.floats(0.006, 0.06),
    st.floats(-0.15, 0.15),
    st.floats(-0.1, 0.1),
    st.floats(0, 3.1),
)


@settings(max_examples=30)
@given(
    blocks=st.lists(BLOCKS, min_size=1, max_size=5),
    noise=st.none() | st.integers(0, 1000),
)
def test_whatever_lies_there(
    blocks: list[tuple[float, ...]], noise: int | None
) -> None:
    meshes = [block(b[:3], b[3], b[4], b[5]) for b in blocks]
    depth, truth = render(HALF, meshes)
    if noise is not None:
        depth = DepthNoise().noisy(depth, 276.0, np.random.default_rng(noise))
    found = segment_depth(depth, HALF)
    areas = found.areas()  # the largest is called first
    assert found.names == tuple(f"segment_{i}" for i in range(len(areas)))
    assert np.all(areas >= 50)
    assert np.all(np.diff(areas) <= 0)
    # Blocks are on the floor, so floor is never an object, nor is a block
    # floor, but for a pixel along the edges and what has no reading.
    inner = eroded(truth >= 0) & (depth > 0)
    assert not np.any(found.labels[eroded(truth < 0)] >= 0)
    whole = np.bincount(truth[truth >= 0], minlength=len(blocks)) >= 400
    seen = inner & np.append(whole, False)[truth]
    assert np.mean(found.labels[seen] >= 0) > 0.9 if seen.any() else True


def eroded(mask: np.ndarray) -> np.ndarray:
    kernel = np.ones((5, 5), np.uint8)
    return cv2.erode(mask.astype(np.uint8), kernel) > 0
