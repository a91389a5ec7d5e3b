"""Laws that the label must keep."""

from typing import Any

import numpy as np
import pytest

from tests.occupancy.label_scenes import (
    draw_sample,
    pose_target,
    render_target,
)
from tests.occupancy.scenes import CAMERAS
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.floor_grid import Floor
from xray_drake.occupancy.instances import instance_image
from xray_drake.occupancy.label.ground_truth import LabelConfig, occupancy_label

NOMINAL = CAMERAS["nominal"]


def lay() -> tuple[np.ndarray, np.ndarray]:
    """Returns a flat target's depth image and its origin."""
    mesh, p_WT = pose_target("box_2to1", np.array([0.031, 0.022]), 0.4, 0, 0)
    return render_target(NOMINAL, mesh), p_WT


TARGET, P_WT = lay()
FLOOR, CLUTTER = (NOMINAL.plane_depth(z).astype(np.float32) for z in (0, 0.05))


def test_candidates_are_64_by_48_by_16() -> None:
    """A target of one pixel, hidden wherever it is put."""
    target = np.zeros(NOMINAL.shape, np.float32)
    u, v = 290, 176
    target[v, u] = 0.795
    p_WT = NOMINAL.unproject(FLOOR)[v, u]
    floor = Floor((-1.0, 1.0), (-1.0, 1.0))
    label = occupancy_label(target, CLUTTER, NOMINAL, p_WT, floor=floor)
    assert label.accepted.tolist() == 16 * [64 * 48]
    expected = np.zeros(NOMINAL.shape, np.float32)
    expected[v % 8 :: 8, u % 8 :: 8] = 1
    np.testing.assert_array_equal(label.distribution, expected)


@pytest.mark.parametrize(("gap", "seen"), [(0.00005, False), (0.0002, True)])
def test_in_front_means_by_more_than_a_tenth_of_a_millimetre(
    gap: float, seen: bool
) -> None:
    there = np.isfinite(TARGET)
    scene = np.where(there, TARGET + np.float32(gap), FLOOR)
    label = occupancy_label(TARGET, scene, NOMINAL, P_WT)
    np.testing.assert_array_equal(label.modal, there & seen)


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
        ({"config": LabelConfig(step=0)}, "label: step is 0: it must be"),
        ({"config": LabelConfig(rotations=0)}, "label: rotations is 0: it"),
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
