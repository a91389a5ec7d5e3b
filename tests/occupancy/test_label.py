"""Laws that the label must keep."""

from typing import Any

import numpy as np
import pytest
import trimesh

from tests.masks import iou
from tests.occupancy.brute_force import render
from tests.occupancy.label_scenes import (
    draw_sample,
    pose_target,
    render_target,
)
from tests.occupancy.scenes import CAMERAS, make_camera
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.occupancy.instances import instance_image
from xray_drake.occupancy.label.ground_truth import LabelConfig, occupancy_label

NOMINAL = CAMERAS["nominal"]


def lay(
    name: str = "box_2to1",
    camera: PinholeCamera = NOMINAL,
    xy: tuple[float, float] = (0.031, 0.022),
    yaw: float = 0.4,
) -> tuple[np.ndarray, np.ndarray]:
    """Returns a flat target's depth image and its origin."""
    mesh, p_WT = pose_target(name, np.array(xy), yaw, 0.0, 0.0)
    return render_target(camera, mesh), p_WT


def clutter(camera: PinholeCamera, height: float = 0.05) -> np.ndarray:
    """Returns the depth of a level surface over everything."""
    return camera.plane_depth(height).astype(np.float32)


def test_a_target_under_its_own_cover_alone_is_there() -> None:
    """A cover that fits the true pose only: nothing else is hidden."""
    target, p_WT = lay("box_10to1")
    floor = clutter(NOMINAL, 0.0)
    scene = np.where(np.isfinite(target), target - np.float32(0.001), floor)
    label = occupancy_label(target, scene, NOMINAL, p_WT)
    assert not label.modal.any()
    assert label.accepted.sum() <= 2
    np.testing.assert_array_equal(label.amodal, np.isfinite(target))
    assert (label.distribution[label.amodal] > 0).all()
    assert iou(label.distribution > 0, label.amodal) >= 0.9


@pytest.mark.parametrize("seed", range(3))
def test_rolling_the_camera_turns_the_label(seed: int) -> None:
    """By 90°: the image turns the other way, and the label with it."""
    sample = draw_sample(seed)
    camera = sample.camera
    K = camera.intrinsics
    # np.rot90: u becomes v, and v becomes W − 1 − u.
    turned_K = np.array(
        [
            [K[1, 1], 0, K[1, 2]],
            [0, K[0, 0], camera.width - 1 - K[0, 2]],
            [0, 0, 1],
        ]
    )
    roll = trimesh.transformations.rotation_matrix(np.pi / 2, [0, 0, 1])
    turned = PinholeCamera(
        camera.height, camera.width, turned_K, camera.X_WC @ roll
    )
    before = occupancy_label(*sample.inputs)
    after = occupancy_label(
        np.rot90(sample.target_depth),
        np.rot90(sample.scene_depth),
        turned,
        sample.p_WT,
    )
    np.testing.assert_array_equal(
        np.rot90(before.distribution), after.distribution
    )


def test_candidates_are_64_by_48_by_16() -> None:
    """A target of one pixel, hidden wherever it is put."""
    target = np.zeros(NOMINAL.shape, np.float32)
    u, v = 290, 176
    target[v, u] = 0.795
    p_WT = NOMINAL.unproject(clutter(NOMINAL, 0.0))[v, u]
    config = LabelConfig(floor=[-1.0, 1.0, -1.0, 1.0])
    label = occupancy_label(
        target, clutter(NOMINAL), NOMINAL, p_WT, config=config
    )
    assert label.accepted.tolist() == 16 * [64 * 48]
    expected = np.zeros(NOMINAL.shape, np.float32)
    expected[v % 8 :: 8, u % 8 :: 8] = 1
    np.testing.assert_array_equal(label.distribution, expected)


def test_candidates_keep_within_the_bin() -> None:
    camera = CAMERAS["tilted"]
    target, p_WT = lay(camera=camera)
    label = occupancy_label(target, clutter(camera), camera, p_WT)
    ground = camera.unproject(camera.plane_depth(0.0))
    x, y = np.abs(ground[..., 0]), np.abs(ground[..., 1])
    support = label.distribution > 0
    assert not (support & ((x > 0.2521) | (y > 0.2021))).any()
    middle = (x < 0.22) & (y < 0.17)
    assert support[middle].all()


def test_candidates_keep_within_the_image() -> None:
    camera = make_camera(focal_length=1100)
    target, p_WT = lay(camera=camera)
    label = occupancy_label(target, clutter(camera), camera, p_WT)
    data = label.distribution
    assert data[192, 256] > 3 * data[192, 3]
    # None was cut off at the border: each covers as many pixels as the first.
    one_way = LabelConfig(rotations=1)
    label = occupancy_label(
        target, clutter(camera), camera, p_WT, config=one_way
    )
    data = label.distribution / label.distribution[label.distribution > 0].min()
    assert np.rint(data).sum() == label.accepted.sum() * label.amodal.sum()


@pytest.mark.parametrize("xy", [(0.28, 0.0), (0.0, 0.25)])
def test_the_true_pose_counts_even_outside_the_bin(
    xy: tuple[float, float],
) -> None:
    target, p_WT = lay(xy=xy)
    for scene in (clutter(NOMINAL, 0.0), clutter(NOMINAL)):
        label = occupancy_label(target, scene, NOMINAL, p_WT)
        assert label.accepted[0] >= 1
        assert (label.distribution[label.amodal] > 0).all()


def test_pixels_without_a_reading_hide_nothing() -> None:
    target, p_WT = lay()
    plate = trimesh.creation.box([0.12, 0.12, 0.02])
    plate.apply_translation([p_WT[0], p_WT[1], 0.02])
    depth, seen = render(NOMINAL, [plate])
    hidden = occupancy_label(target, depth, NOMINAL, p_WT)
    assert hidden.accepted.sum() > 100
    for nothing in (0.0, np.nan, np.inf):
        blind = np.where(seen == 0, np.float32(nothing), depth)
        label = occupancy_label(target, blind, NOMINAL, p_WT)
        np.testing.assert_array_equal(label.modal, label.amodal)
        assert label.accepted.sum() <= 4


def test_in_front_means_by_more_than_a_tenth_of_a_millimetre() -> None:
    target, p_WT = lay()
    for gap, seen in ((0.00005, False), (0.0002, True)):
        scene = np.where(
            np.isfinite(target), target + np.float32(gap), clutter(NOMINAL, 0)
        )
        label = occupancy_label(target, scene, NOMINAL, p_WT)
        assert label.modal.all(where=label.amodal) == seen
        assert label.modal.any() == seen


def test_an_observed_mask_takes_the_place_of_the_computed_one() -> None:
    target, p_WT = lay("box_3to1")
    floor = clutter(NOMINAL, 0.0)
    half = np.isfinite(target)
    half[:, int(NOMINAL.project(p_WT)[0]) :] = False
    label = occupancy_label(target, floor, NOMINAL, p_WT, observed=half)
    np.testing.assert_array_equal(label.modal, half)
    np.testing.assert_array_equal(label.amodal, np.isfinite(target))
    # No candidate shows half of itself on an open floor, but the true pose
    # always counts.
    assert label.accepted.sum() == 1
    np.testing.assert_array_equal(label.distribution > 0, label.amodal)


def test_what_is_returned() -> None:
    """No target is 0 or inf; images stay as they are."""
    target, scene, *camera_and_origin = draw_sample(0).inputs
    for array in (target, scene):
        array.setflags(write=False)
    label = occupancy_label(target, scene, *camera_and_origin)
    assert label.distribution.dtype == np.float32
    assert label.distribution.min() == 0
    assert label.distribution.max() == 1
    assert label.modal.dtype == label.amodal.dtype == bool
    assert label.accepted.shape == (16,)
    zeros = np.where(np.isfinite(target), target, 0.0)
    again = occupancy_label(zeros, scene, *camera_and_origin)
    np.testing.assert_array_equal(label.distribution, again.distribution)


TARGET, P_WT = lay()
FLOOR = clutter(NOMINAL, 0.0)
BELOW = PinholeCamera(512, 384, NOMINAL.intrinsics, np.diag([1.0, -1, -1, 1]))


def with_pixel(image: np.ndarray, value: float) -> np.ndarray:
    changed = image.copy()
    changed[3, 4] = value
    return changed


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"target_depth": TARGET[:9, :9]}, r"target's .* is \(9, 9\)"),
        ({"scene_depth": FLOOR[:4]}, r"scene's .* is \(4, 512\)"),
        ({"observed": np.zeros((2, 3), bool)}, r"modal mask is \(2, 3\)"),
        ({"target_depth": 0 * FLOOR}, "target's image is empty"),
        ({"target_depth": with_pixel(TARGET, np.nan)}, "target's .* has NaN"),
        ({"target_depth": with_pixel(TARGET, -0.5)}, "target's .* negative"),
        ({"scene_depth": with_pixel(FLOOR, -0.5)}, "scene's .* negative"),
        ({"p_WT": [1.0, 0, 0]}, "outside the image"),
        ({"p_WT": [0.0, 0, 2]}, "outside the image"),
        ({"p_WT": [np.nan, 0, 0]}, "three finite numbers"),
        ({"p_WT": [0.0, 0]}, "three finite numbers"),
        ({"camera": BELOW}, "above the floor"),
        ({"config": LabelConfig(step=0)}, "at least one"),
        ({"config": LabelConfig(rotations=0)}, "at least one"),
    ],
    ids=lambda value: value if isinstance(value, str) else next(iter(value)),
)
def test_wrong_input_is_named(change: dict[str, Any], message: str) -> None:
    given = {
        "target_depth": TARGET,
        "scene_depth": FLOOR,
        "camera": NOMINAL,
        "p_WT": P_WT,
    }
    with pytest.raises(ValueError, match=message) as error:
        occupancy_label(**{**given, **change})
    assert "\n" not in str(error.value)


def test_instance_image() -> None:
    labels = np.array([[7, 7, 3], [32766, 5, 5], [9, 9, 3]], np.int16)
    image = instance_image(labels, 5, [9, 3, 8])
    assert image.dtype == np.uint8
    assert image.tolist() == [[0, 0, 3], [0, 1, 1], [2, 2, 3]]
    with pytest.raises(ValueError, match="given twice"):
        instance_image(labels, 5, [5])
    with pytest.raises(ValueError, match="254 objects"):
        instance_image(labels, 0, range(1, 256))
