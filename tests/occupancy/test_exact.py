"""Geometric inference of flat targets against brute force, and the laws."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.masks import iou
from tests.occupancy.brute_force import brute_force, render
from tests.occupancy.inferences import TALL, inference_of, label_inference
from tests.occupancy.scenes import CAMERAS, cover, lying, make_camera, occluders
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.silhouette import project_mesh_mask
from xray_drake.occupancy.exact import ExactInference
from xray_drake.occupancy.geometric.config import GeometricConfig
from xray_drake.occupancy.geometric.inference import GeometricInference
from xray_drake.scene.object_model import ObjectModel, object_from_pieces
from xray_drake.scene.targets import target_model

NOTHING = np.zeros((384, 512), dtype=bool)
# Fewer orientations than usual, for the sake of the brute force.
COARSE = GeometricConfig(rotations=16, seen_step=0.012)


def wedge() -> ObjectModel:
    """Half a turn does not bring it back onto itself."""
    base = [[-0.025, -0.02, 0.0], [0.035, -0.02, 0.0], [-0.01, 0.03, 0.0]]
    piece = trimesh.convex.convex_hull(
        np.vstack([base, np.add(base, [0.0, 0.0, 0.006])])
    )
    return object_from_pieces("wedge", [piece], density=600.0)


def target_of(name: str) -> ObjectModel:
    return wedge() if name == "wedge" else target_model(name)


def amodal_mask(mesh: trimesh.Trimesh, camera: PinholeCamera) -> np.ndarray:
    return project_mesh_mask(mesh.vertices, mesh.faces, np.eye(4), camera)


def lattice_poses(
    inference: GeometricInference, center: np.ndarray, reach: float
) -> np.ndarray:
    """Returns the (n, 3) candidates of a hidden target around a place."""
    cell = inference.config.cell
    steps = np.arange(-int(reach / cell), int(reach / cell) + 1)
    middle = np.rint(center / cell)
    x, y, angle = np.meshgrid(
        (steps + middle[0]) * cell,
        (steps + middle[1]) * cell,
        inference.poses.angles,
        indexing="ij",
    )
    return np.stack([x, y, angle], axis=-1).reshape(-1, 3)


def pixel_poses(
    inference: GeometricInference,
    mask: np.ndarray,
    camera: PinholeCamera,
    extents: np.ndarray,
) -> np.ndarray:
    """Returns the (n, 3) candidates of a target that is seen."""
    v, u = np.nonzero(mask)
    reach = int(0.25 * np.hypot(*extents[:2]) / 0.00125)
    around = (
        slice(v.min() - reach, v.max() + reach + 1),
        slice(u.min() - reach, u.max() + reach + 1),
    )
    plane = camera.unproject(camera.plane_depth(extents[2] / 2))
    xy = plane[around].reshape(-1, 3)[:, :2]
    return np.concatenate(
        [
            np.column_stack([xy, np.full(len(xy), angle)])
            for angle in inference.poses.seen_angles
        ]
    )


# Each camera and each kind of silhouette.
AGREEMENT = [
    ("box_2to1", "high", 1),
    ("wedge", "tilted", 0),
    ("box_5to1", "rolled", 1),
    ("box_10to1", "low", 1),
    ("lid", "tilted", 1),
    ("flute", "nominal", 1),
]


@pytest.mark.parametrize(("name", "view", "seed"), AGREEMENT)
def test_hidden_support_agrees_with_brute_force(
    name: str, view: str, seed: int
) -> None:
    target = target_of(name)
    camera = CAMERAS[view]
    rng = np.random.default_rng(seed)
    center = rng.uniform([-0.12, -0.08], [0.12, 0.08])
    angle = rng.uniform(0, np.pi)
    # A rectangle over a wedge has room to spare.
    margin = 0.008 if name == "wedge" else 0.02
    plate = cover(target.visual, *center, angle, margin=margin)
    height = target.extents[2] + 0.002
    others = occluders(rng, 2, center, 0.02, height)
    # What is lower than the target does not hide it.
    low = trimesh.creation.box([0.09, 0.09, 0.7 * target.extents[2]])
    aside = center - [0.14 * np.sign(center[0]), 0.0]
    low.apply_translation([*aside, 0.35 * target.extents[2]])
    depth, _ = render(camera, [plate, low, *others])
    inference = GeometricInference(target, COARSE)
    result = inference.infer(depth, NOTHING, camera)

    poses = lattice_poses(inference, center, 0.045)
    expected = brute_force(
        [target.visual], [poses], COARSE, depth, NOTHING, camera
    )
    # All that is accepted is among the poses the reference was given.
    assert np.count_nonzero(expected) > 500
    assert iou(result.support(), expected > 0) >= 0.98
    either = result.support() | (expected > 0)
    assert np.abs(result.data - expected)[either].mean() <= 0.025


@pytest.mark.parametrize(("name", "view", "seed"), AGREEMENT)
def test_seen_support_agrees_with_brute_force(
    name: str, view: str, seed: int
) -> None:
    target = target_of(name)
    camera = CAMERAS[view]
    rng = np.random.default_rng(seed)
    center = rng.uniform([-0.12, -0.08], [0.12, 0.08])
    angle = rng.uniform(0, 2 * np.pi)
    mesh = lying(target.visual, *center, angle)
    # One box over an end leaves some 30 to 60 % to be seen.
    side = 0.5 * target.extents[0]
    block = trimesh.creation.box([side, 0.08, 0.03])
    X_WB = trimesh.transformations.rotation_matrix(angle + 0.3, [0, 0, 1])
    along = np.array([np.cos(angle), np.sin(angle)])
    X_WB[:2, 3] = center + 0.5 * side * along
    X_WB[2, 3] = 0.035
    block.apply_transform(X_WB)
    depth, label = render(camera, [mesh, block])
    mask = label == 0
    seen = np.count_nonzero(mask) / np.count_nonzero(amodal_mask(mesh, camera))
    assert 0.25 < seen < 0.7
    inference = GeometricInference(target, COARSE)
    result = inference.infer(depth, mask, camera)

    poses = pixel_poses(inference, mask, camera, target.extents)
    expected = brute_force(
        [target.visual], [poses], COARSE, depth, mask, camera
    )
    assert iou(result.support(), expected > 0) >= 0.98
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
    target = target_model("box_2to1")
    config = GeometricConfig(floor=[-0.1, 0.1, -0.05, 0.05])
    inference = GeometricInference(target, config)
    camera = CAMERAS["tilted"]
    depth = camera.plane_depth(0.05).astype(np.float32)
    support = inference.infer(depth, NOTHING, camera).support()
    ground = camera.unproject(camera.plane_depth(0.0))
    inside = (np.abs(ground[..., 0]) < 0.1) & (np.abs(ground[..., 1]) < 0.05)
    nearly = (np.abs(ground[..., 0]) < 0.103) & (np.abs(ground[..., 1]) < 0.053)
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
    target = target_model("box_2to1")
    camera = CAMERAS["low"]
    quarter = trimesh.transformations.rotation_matrix(np.pi / 2, [0, 0, 1])
    turned_camera = PinholeCamera(
        camera.width, camera.height, camera.intrinsics, quarter @ camera.X_WC
    )
    rng = np.random.default_rng(5)
    scene = [
        lying(target.visual, 0.17, 0.02, 0.4),
        *occluders(rng, 8, np.array([0.21, 0.05]), 0.02, 0.008),
    ]
    if not seen:
        scene = scene[1:]
    turned_scene = [mesh.copy().apply_transform(quarter) for mesh in scene]
    floors = [-0.25, 0.25, -0.20, 0.20], [-0.20, 0.20, -0.25, 0.25]
    supports = []
    for floor, meshes, view in zip(
        floors, (scene, turned_scene), (camera, turned_camera), strict=True
    ):
        depth, label = render(view, meshes)
        mask = (label == 0) & seen
        assert mask.any() == seen
        inference = GeometricInference(target, GeometricConfig(floor=floor))
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


def test_target_with_a_hole() -> None:
    """A ring whose hole shows the floor, hidden and seen."""
    ring = trimesh.creation.annulus(r_min=0.018, r_max=0.03, height=0.006)
    pieces = [ring]
    target = object_from_pieces("ring", pieces, density=600.0, recenter=False)
    inference = GeometricInference(target)
    assert len(inference.poses.angles) < 32
    camera = CAMERAS["tilted"]
    mesh = lying(target.visual, 0.03, 0.02, 0.0)
    depth, label = render(camera, [mesh])
    result = inference.infer(depth, label == 0, camera)
    assert iou(result.support(), label == 0) >= 0.9
    plate = cover(target.visual, 0.03, 0.02, 0.0)
    depth, _ = render(camera, [plate])
    hidden = inference.infer(depth, NOTHING, camera).support()
    assert np.count_nonzero(hidden & (label == 0)) >= 0.99 * (label == 0).sum()


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


@pytest.mark.parametrize("name", ["box_2to1", "die"])
def test_wrong_input_is_named(name: str) -> None:
    inference, camera = inference_of(name), CAMERAS["nominal"]
    depth, _ = render(camera, [])
    X_WC = camera.X_WC.copy()
    X_WC[2, 3] = 0.001
    low = PinholeCamera(512, 384, camera.intrinsics, X_WC)
    wrong: list[tuple[np.ndarray, np.ndarray, PinholeCamera, str]] = [
        (depth, np.zeros((2, 3), bool), camera, r"target mask is \(2, 3\)"),
        (depth[:4, :4], NOTHING, camera, r"depth image is \(4, 4\)"),
        (np.full_like(depth, 0.001), NOTHING, low, "above the target"),
    ]
    for nothing in (0.0, np.nan, np.inf):
        blind = np.full_like(depth, nothing)
        wrong.append((blind, NOTHING, camera, "no reading at all"))
    for image, mask, view, said in wrong:
        with pytest.raises(ValueError, match=said):
            inference.infer(image, mask, view)


def test_wrong_numbers_are_named() -> None:
    for poses in ("flat", "resting"):
        with pytest.raises(ValueError, match="at least one rotation"):
            GeometricInference(
                TALL["die"], GeometricConfig(poses=poses, rotations=0)
            )
    with pytest.raises(ValueError, match=r"'upright': choose one of flat, res"):
        GeometricInference(TALL["die"], GeometricConfig(poses="upright"))
    with pytest.raises(ValueError, match=r"'resting': choose one of flat$"):
        label_inference(TALL["die"], GeometricConfig(poses="resting"))


def test_the_old_name_is_taken_for_a_version() -> None:
    with pytest.warns(DeprecationWarning, match="make_inference"):
        old = ExactInference(target_model("box_2to1"))
    assert type(old) is GeometricInference
