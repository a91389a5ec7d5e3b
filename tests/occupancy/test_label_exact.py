"""The label of exact placement against brute force."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from tests.occupancy.brute_force import BruteForce, render
from tests.occupancy.label_scenes import pose_target
from tests.occupancy.scenes import CAMERAS, cover
from tests.occupancy.test_exact import (
    COARSE,
    NOTHING,
    amodal_mask,
    iou,
    lattice_poses,
    pixel_poses,
)
from xray_drake.occupancy.geometric.flat import ExactInference
from xray_drake.occupancy.label.exact_placement import exact_label
from xray_drake.scene.targets import target_model


def block_over_one_end(
    name: str, center: np.ndarray, angle: float
) -> trimesh.Trimesh:
    length = target_model(name).extents[0]
    block = trimesh.creation.box([0.5 * length, 0.08, 0.03])
    X_WB = trimesh.transformations.rotation_matrix(angle + 0.3, [0, 0, 1])
    along = np.array([np.cos(angle), np.sin(angle)])
    X_WB[:2, 3] = center + 0.25 * length * along
    X_WB[2, 3] = 0.035
    return block.apply_transform(X_WB)


@pytest.mark.parametrize(("name", "view"), [("box_5to1", "low")])
def test_hidden_label_agrees_with_brute_force(name: str, view: str) -> None:
    target = target_model(name)
    camera = CAMERAS[view]
    center = np.array([0.07, -0.04])
    scene, _ = render(camera, [cover(target.visual, *center, 0.7)])
    inference = ExactInference(target, COARSE)
    label = exact_label(inference, scene, NOTHING, camera)

    poses = lattice_poses(inference, center, 0.035)
    truth = BruteForce(target.visual, COARSE, scene, NOTHING, camera)
    expected = truth.infer(poses)
    assert label.method == "exact label"
    assert np.count_nonzero(expected) > 500
    assert iou(label.support(), expected > 0) >= 0.98
    either = label.support() | (expected > 0)
    assert np.abs(label.data - expected)[either].mean() <= 0.03
    mesh, _ = pose_target(name, center, 0.7, 0.0, 0.0)
    amodal = amodal_mask(mesh, camera)
    assert np.count_nonzero(label.support() & amodal) >= 0.99 * amodal.sum()


@pytest.mark.parametrize(("name", "view"), [("box_3to1", "rolled")])
def test_seen_label_agrees_with_brute_force(name: str, view: str) -> None:
    target = target_model(name)
    camera = CAMERAS[view]
    center, angle = np.array([-0.05, 0.06]), 0.9
    mesh, _ = pose_target(name, center, angle, 0.0, 0.0)
    block = block_over_one_end(name, center, angle)
    _, shown = render(camera, [mesh, block])
    modal = shown == 0
    scene, _ = render(camera, [block])
    config = replace(COARSE, seen_step=0.006)
    inference = ExactInference(target, config)
    label = exact_label(inference, scene, modal, camera)

    poses = pixel_poses(inference, modal, camera, target.extents)
    truth = BruteForce(target.visual, config, scene, modal, camera)
    assert iou(label.support(), truth.infer(poses) > 0) >= 0.98
    amodal = amodal_mask(mesh, camera)
    assert np.count_nonzero(label.support() & amodal) >= 0.98 * amodal.sum()


def test_fully_visible_target_is_where_it_is_seen() -> None:
    target = target_model("box_3to1")
    camera = CAMERAS["low"]
    mesh, _ = pose_target("box_3to1", np.array([0.05, 0.02]), 0.3, 0.0, 0.0)
    scene, _ = render(camera, [])
    modal = amodal_mask(mesh, camera)
    label = exact_label(ExactInference(target), scene, modal, camera)
    assert iou(label.support(), modal) >= 0.9


def test_inference_finds_the_label_of_a_flat_target() -> None:
    """What is under the visible part changes next to nothing."""
    target = target_model("box_2to1")
    camera = CAMERAS["nominal"]
    center, angle = np.array([0.0, 0.03]), 0.2
    mesh, _ = pose_target("box_2to1", center, angle, 0.0, 0.0)
    block = block_over_one_end("box_2to1", center, angle)
    depth, shown = render(camera, [mesh, block])
    modal = shown == 0
    scene, _ = render(camera, [block])
    inference = ExactInference(target)
    label = exact_label(inference, scene, modal, camera)
    inferred = inference.infer(depth, modal, camera)
    assert (label.method, inferred.method) == ("exact label", "exact")
    assert iou(label.support(), inferred.support()) >= 0.95


def test_wrong_input_is_named() -> None:
    inference = ExactInference(target_model("box_2to1"))
    camera = CAMERAS["nominal"]
    scene, _ = render(camera, [])
    with pytest.raises(ValueError, match=r"depth image is \(4, 4\)"):
        exact_label(inference, scene[:4, :4], NOTHING, camera)
