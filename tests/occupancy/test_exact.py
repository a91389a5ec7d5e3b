"""Geometric inference of flat targets against brute force, and the laws."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.masks import iou
from tests.occupancy.brute_force import brute_force, render
from tests.occupancy.inferences import (
    TALL,
    inference_of,
    label_inference,
    resting_inference,
)
from tests.occupancy.scenes import CAMERAS, cover, lying, make_camera, occluders
from xray_drake.choices import TARGET_NAMES
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.floor_grid import Floor
from xray_drake.geometry.silhouette import project_mesh_mask
from xray_drake.occupancy.exact import ExactInference
from xray_drake.occupancy.geometric.config import GeometricConfig
from xray_drake.occupancy.geometric.inference import GeometricInference
from xray_drake.scene.object_model import ObjectModel, object_from_pieces
from xray_drake.scene.targets import target_model

NOTHING = np.zeros((384, 512), dtype=bool)
# Fewer orientations than usual, for the sake of the brute force.
COARSE = GeometricConfig("flat", rotations=16, seen_step=0.012)


_BASE = [[-0.025, -0.02, 0.0], [0.035, -0.02, 0.0], [-0.01, 0.03, 0.0]]
_PIECES = {
    # Half a turn does not bring it back onto itself.
    "wedge": trimesh.convex.convex_hull(
        np.vstack([_BASE, np.add(_BASE, [0.0, 0.0, 0.006])])
    ),
    # Its hole shows the floor.
    "ring": trimesh.creation.annulus(r_min=0.018, r_max=0.03, height=0.006),
}
TARGETS = {
    name: object_from_pieces(name, [piece], density=600.0, recenter=False)
    for name, piece in _PIECES.items()
} | {name: target_model(name) for name in TARGET_NAMES}


def amodal_mask(mesh: trimesh.Trimesh, camera: PinholeCamera) -> np.ndarray:
    return project_mesh_mask(mesh.vertices, mesh.faces, np.eye(4), camera)


def candidates(
    inference: GeometricInference,
    target: ObjectModel,
    mask: np.ndarray,
    camera: PinholeCamera,
    center: np.ndarray,
) -> np.ndarray:
    """Returns the (n, 3) candidates: about the mask, or within 45 mm."""
    if mask.any():
        v, u = np.nonzero(mask)
        reach = int(0.25 * np.hypot(*target.extents[:2]) / 0.00125)
        plane = camera.unproject(camera.plane_depth(target.extents[2] / 2))
        near = plane[
            v.min() - reach : v.max() + reach + 1,
            u.min() - reach : u.max() + reach + 1,
        ]
        xy = near[..., :2].reshape(-1, 2)
        angles = inference.poses.seen_angles
    else:
        cell = inference.config.cell
        steps = np.indices((71, 71)).reshape(2, -1).T - 35
        xy = cell * (np.rint(center / cell) + steps)
        angles = inference.poses.angles
    return np.column_stack(
        [np.tile(xy, (len(angles), 1)), np.repeat(angles, len(xy))]
    )


def scene_of(
    target: ObjectModel, rng: np.random.Generator, *, hidden: bool
) -> tuple[list[trimesh.Trimesh], np.ndarray]:
    """Returns what lies there, a seen target first, and the target's place."""
    center = rng.uniform([-0.12, -0.08], [0.12, 0.08])
    angle = rng.uniform(0, np.pi if hidden else 2 * np.pi)
    length, _, height = target.extents
    if hidden:
        # A rectangle over a wedge has room to spare.
        margin = 0.008 if target.name == "wedge" else 0.02
        plate = cover(target.visual, *center, angle, margin=margin)
        others = occluders(rng, 2, center, 0.02, height + 0.002)
        # What is lower than the target does not hide it.
        low = trimesh.creation.box([0.09, 0.09, 0.7 * height])
        aside = center - [0.14 * np.sign(center[0]), 0.0]
        low.apply_translation([*aside, 0.35 * height])
        return [plate, low, *others], center
    # One box over an end leaves some 30 to 60 % to be seen.
    along = np.array([np.cos(angle), np.sin(angle)])
    block = trimesh.creation.box([0.5 * length, 0.08, 0.03])
    block = lying(block, *(center + 0.25 * length * along), angle + 0.3)
    block.apply_translation([0, 0, 0.02])
    return [lying(target.visual, *center, angle), block], center


@pytest.mark.parametrize("hidden", [False, True], ids=["seen", "hidden"])
@pytest.mark.parametrize(
    ("name", "view", "seed"),
    [
        ("box_2to1", "high", 1),
        ("wedge", "tilted", 0),
        ("box_5to1", "rolled", 1),
        ("box_10to1", "low", 1),
        ("lid", "tilted", 1),
        ("flute", "nominal", 1),
        ("ring", "tilted", 0),
    ],
)
def test_support_agrees_with_brute_force(
    name: str, view: str, seed: int, hidden: bool
) -> None:
    """Each camera and each kind of silhouette."""
    target, camera = TARGETS[name], CAMERAS[view]
    meshes, center = scene_of(
        target, np.random.default_rng(seed), hidden=hidden
    )
    depth, label = render(camera, meshes)
    mask = (label == 0) & (not hidden)
    if not hidden:
        amodal = np.count_nonzero(amodal_mask(meshes[0], camera))
        assert 0.25 < np.count_nonzero(mask) / amodal < 0.7
    inference = GeometricInference(target, COARSE)
    result = inference.infer(depth, mask, camera)

    poses = candidates(inference, target, mask, camera, center)
    expected = brute_force(
        [target.visual], [poses], COARSE, depth, mask, camera
    )
    # All that is accepted is among the poses the reference was given.
    assert np.count_nonzero(expected) > 300
    assert iou(result.support(), expected > 0) >= 0.98
    either = result.support() | (expected > 0)
    if hidden:
        assert np.abs(result.data - expected)[either].mean() <= 0.025
    else:
        assert np.count_nonzero(result.support() & mask) >= 0.95 * mask.sum()


@pytest.mark.parametrize(
    ("name", "view", "tilt"),
    [
        ("box_2to1", "nominal", 0),
        ("box_10to1", "tilted", 0),
        ("box_2to1", "low", 0),
        ("lid", "low", 0),
        pytest.param("lid", "nominal", 50, id="tilted: held by coverage"),
    ],
)
def test_fully_visible_target_is_where_it_is_seen(
    name: str, view: str, tilt: float
) -> None:
    camera, mesh = CAMERAS[view], target_model(name).visual.copy()
    turn = trimesh.transformations.rotation_matrix
    mesh.apply_transform(turn(np.deg2rad(tilt), [1, 0, 0]))
    depth, label = render(camera, [lying(mesh, 0.04, -0.03, 0.37)])
    truth = label == 0
    support = inference_of(name).infer(depth, truth, camera).support()
    assert np.count_nonzero(support & truth) >= 0.9 * truth.sum()
    assert tilt or iou(support, truth) >= 0.9


ANY = ("box_2to1", "box_10to1", "lid", "die", "brick", "cup")


@pytest.mark.parametrize("name", ANY)
def test_a_blank_scene_and_too_small_a_hiding_place_are_empty(
    name: str,
) -> None:
    block = trimesh.creation.box([0.02, 0.02, 0.04])
    block.apply_translation([0.03, 0.02, 0.02])
    for scene in ([], [block]):
        depth, _ = render(CAMERAS["nominal"], scene)
        result = inference_of(name).infer(depth, NOTHING, CAMERAS["nominal"])
        assert not result.data.any()
        assert result.method == "geometric"


@pytest.mark.parametrize("name", ["box_2to1", "die"])
def test_pixels_without_a_reading_hide_nothing(name: str) -> None:
    inference, camera = inference_of(name), CAMERAS["nominal"]
    plate = trimesh.creation.box([0.15, 0.15, 0.01])
    plate.apply_translation([0, 0, 0.067])
    depth, label = render(camera, [plate])
    assert inference.infer(depth, NOTHING, camera).support_size() > 1000
    for nothing in (0.0, np.nan, np.inf):
        blind = np.where(label == 0, np.float32(nothing), depth)
        assert not inference.infer(blind, NOTHING, camera).data.any()


def test_candidates_keep_within_the_bin() -> None:
    floor = Floor((-0.1, 0.1), (-0.05, 0.05))
    inference = GeometricInference(target_model("box_2to1"), floor=floor)
    camera = CAMERAS["tilted"]
    depth = camera.plane_depth(0.05).astype(np.float32)
    support = inference.infer(depth, NOTHING, camera).support()
    ground = np.abs(camera.unproject(camera.plane_depth(0.0))[..., :2])
    inside = (ground < [0.1, 0.05]).all(axis=-1)
    nearly = (ground < [0.103, 0.053]).all(axis=-1)
    assert not (support & ~nearly).any()
    assert np.count_nonzero(support & inside) >= 0.99 * inside.sum()


def test_candidates_keep_within_the_image() -> None:
    """A camera that sees half the bin: all it sees may hide the target."""
    inference = inference_of("box_2to1")
    camera = make_camera(focal_length=1100)
    depth = camera.plane_depth(0.05).astype(np.float32)
    data = inference.infer(depth, NOTHING, camera).data
    middle, edge = data[192, 256], data[192, 1]
    assert 0 < edge < 0.3 * middle


@settings(max_examples=25)
@given(
    seed=st.integers(0, 2**32 - 1),
    name=st.sampled_from(["box_1to1", "box_2to1", "box_10to1", "lid", "flute"]),
    view=st.sampled_from(sorted(CAMERAS)),
    hidden=st.booleans(),
)
def test_support_holds_the_target(
    seed: int, name: str, view: str, hidden: bool
) -> None:
    rng = np.random.default_rng(seed)
    mesh, camera = target_model(name).visual, CAMERAS[view]
    x, y = rng.uniform([-0.15, -0.1], [0.15, 0.1])
    angle = rng.uniform(0, 2 * np.pi)
    target = lying(mesh, x, y, angle)
    truth = amodal_mask(target, camera)
    height = mesh.extents[2] + 0.002
    scene = [target, *occluders(rng, 3, np.array([x, y]), 0.03, height)]
    if hidden:
        scene[0] = cover(mesh, x, y, angle)
    depth, label = render(camera, scene)
    mask = (label == 0) & (not hidden)
    support = inference_of(name).infer(depth, mask, camera).support()
    share = 0.9 if mask.any() else 0.99
    assert np.count_nonzero(support & truth) >= share * truth.sum()


@pytest.mark.parametrize("seen", [False, True])
def test_turning_scene_bin_and_camera_turns_nothing_in_the_image(
    seen: bool,
) -> None:
    """The floor is a rectangle, so it has to turn too."""
    target, camera = target_model("box_2to1"), CAMERAS["low"]
    place = np.array([0.21, 0.05])
    scene = occluders(np.random.default_rng(5), 8, place, 0.02, 0.008)
    if seen:
        scene.insert(0, lying(target.visual, 0.17, 0.02, 0.4))
    supports = []
    for angle, floor in (
        (0.0, Floor((-0.25, 0.25), (-0.20, 0.20))),
        (np.pi / 2, Floor((-0.20, 0.20), (-0.25, 0.25))),
    ):
        turn = trimesh.transformations.rotation_matrix(angle, [0, 0, 1])
        view = replace(camera, X_WC=turn @ camera.X_WC)
        turned = [mesh.copy().apply_transform(turn) for mesh in scene]
        depth, label = render(view, turned)
        mask = (label == 0) & seen
        assert mask.any() == seen
        inference = GeometricInference(target, floor=floor)
        supports.append(inference.infer(depth, mask, view).support())
    assert iou(*supports) >= 0.98


def test_mask_outside_the_floor_is_ignored() -> None:
    inference = inference_of("box_2to1")
    camera = CAMERAS["nominal"]
    plate = trimesh.creation.box([0.1, 0.1, 0.02])
    plate.apply_translation([0, 0, 0.02])
    depth, _ = render(camera, [plate])
    outside = NOTHING.copy()
    outside[2:12, 3:20] = True
    ignored = inference.infer(depth, outside, camera)
    expected = inference.infer(depth, NOTHING, camera)
    np.testing.assert_array_equal(ignored.data, expected.data)
    assert ignored.support_size() > 1000


def test_what_lies_under_the_visible_part_changes_next_to_nothing() -> None:
    """So exact labels, of the scene without the target, are its answers."""
    target, camera = target_model("box_2to1"), CAMERAS["nominal"]
    mesh = lying(target.visual, 0.0, 0.03, 0.2)
    block = trimesh.creation.box([0.5 * target.extents[0], 0.08, 0.03])
    block.apply_translation([0.01, 0.03, 0.035])
    depth, label = render(camera, [mesh, block])
    scene, _ = render(camera, [block])
    inference = inference_of("box_2to1")
    without = inference.infer(scene, label == 0, camera).support()
    support = inference.infer(depth, label == 0, camera).support()
    assert iou(without, support) >= 0.95
    amodal = amodal_mask(mesh, camera)
    assert np.count_nonzero(without & amodal) >= 0.98 * amodal.sum()


DEPTH = CAMERAS["nominal"].plane_depth(0.0).astype(np.float32)


@pytest.mark.parametrize("name", ["box_2to1", "die"])
@pytest.mark.parametrize(
    ("depth", "mask", "height", "said"),
    [
        (DEPTH, np.zeros((2, 3), bool), 0.8, r"target mask is \(2, 3\)"),
        (DEPTH[:4, :4], NOTHING, 0.8, r"depth image is \(4, 4\)"),
        (0.001 + 0 * DEPTH, NOTHING, 0.001, "above the target"),
        (0 * DEPTH, NOTHING, 0.8, "no reading at all"),
        (np.nan * DEPTH, NOTHING, 0.8, "no reading at all"),
        (np.inf * DEPTH, NOTHING, 0.8, "no reading at all"),
    ],
)
def test_wrong_input_is_named(
    name: str, depth: np.ndarray, mask: np.ndarray, height: float, said: str
) -> None:
    camera = make_camera(radius=height)
    with pytest.raises(ValueError, match=said):
        inference_of(name).infer(depth, mask, camera)


@pytest.mark.parametrize(
    ("infer", "config", "said"),
    [
        (GeometricInference, {"rotations": 0}, "rotations is 0: it must"),
        (GeometricInference, {"cell": 0}, "cell is 0: it must"),
        (resting_inference, {"rotations": 0}, "rotations is 0: it must"),
        (
            GeometricInference,
            {"poses": "up"},
            "'up': .* of auto, flat, resting",
        ),
        (
            label_inference,
            {"poses": "resting"},
            "takes flat poses, .* are resting$",
        ),
    ],
)
def test_wrong_numbers_are_named(
    infer: Any, config: dict[str, Any], said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        infer(TALL["die"], GeometricConfig(**config))


def test_the_old_name_is_taken_for_a_version() -> None:
    with pytest.warns(DeprecationWarning, match="make_inference"):
        old = ExactInference(target_model("box_2to1"))
    assert type(old) is GeometricInference
