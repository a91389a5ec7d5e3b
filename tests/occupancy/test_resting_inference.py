"""Exact inference over all resting poses against brute force, and laws."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.masks import iou
from tests.occupancy.brute_force import brute_force, render
from tests.occupancy.inferences import (
    TALL,
    block,
    inference_of,
    resting_inference,
)
from tests.occupancy.scenes import CAMERAS, make_camera, occluders
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.floor_grid import Floor
from xray_drake.occupancy.geometric.blocks import Blocks
from xray_drake.occupancy.geometric.config import GeometricConfig
from xray_drake.occupancy.geometric.inference import GeometricInference
from xray_drake.occupancy.geometric.resting import HIDDEN_STEP
from xray_drake.occupancy.geometric.standing import StandingTarget
from xray_drake.occupancy.geometric.standing_drawing import View
from xray_drake.scene.targets import target_model

# Few orientations and pixels, for the sake of the brute force.
COARSE = GeometricConfig(rotations=8, seen_step=0.02)
SMALL_IMAGE = {
    "focal_length": 276.25,
    "center": (127.5, 95.5),
    "size": (256, 192),
}
SMALL = {
    "nominal": make_camera(**SMALL_IMAGE),
    "tilted": make_camera(tilt=9, azimuth=57, roll=5, **SMALL_IMAGE),
}
FLOOR = Floor((-0.25, 0.25), (-0.20, 0.20))


def placed(
    body: StandingTarget, xy: np.ndarray, angle: float
) -> trimesh.Trimesh:
    return trimesh.Trimesh(
        body.turned(angle) + [*xy, 0.0], body.faces, process=False
    )


def amodal_of(mesh: trimesh.Trimesh, camera: PinholeCamera) -> np.ndarray:
    return render(camera, [mesh])[1] == 0


def roof(xy: np.ndarray, height: float, side: float) -> trimesh.Trimesh:
    plate = trimesh.creation.box([side, side, 0.01])
    return plate.apply_translation([*xy, height + 0.007])


def poses_at(
    body: StandingTarget,
    pixels: np.ndarray,
    angles: np.ndarray,
    camera: PinholeCamera,
) -> np.ndarray:
    """Returns (n, 3) x, y, angle where the axis is seen at pixels."""
    homogeneous = np.column_stack([pixels, np.ones(len(pixels))])
    ray = homogeneous @ np.linalg.inv(camera.plane_homography(body.middle)).T
    xy = ray[:, :2] / ray[:, 2:]
    return np.concatenate(
        [np.column_stack([xy, np.full(len(xy), a)]) for a in angles]
    )


def candidates(
    inference: GeometricInference,
    body: StandingTarget,
    place: np.ndarray,
    camera: PinholeCamera,
    *,
    hidden: bool,
) -> np.ndarray:
    """Returns the (n, 3) poses of one way to lie around a pixel."""
    if hidden:
        pixels = Blocks.on_floor(body, camera, FLOOR).pixels(HIDDEN_STEP)
        near = (np.abs(pixels - place) <= 60).all(axis=1)
        return poses_at(
            body, pixels[near], inference.poses.angles(body), camera
        )
    around = np.rint(place) + np.indices((61, 61)).reshape(2, -1).T - 30
    return poses_at(body, around, inference.poses.seen_angles(body), camera)


@pytest.mark.parametrize("hidden", [False, True], ids=["seen", "hidden"])
@pytest.mark.parametrize("name", TALL)
@pytest.mark.parametrize("seed", [0, 1])
def test_support_agrees_with_brute_force(
    name: str, seed: int, hidden: bool
) -> None:
    """Each view has targets that lie in another way."""
    camera = list(SMALL.values())[seed]
    inference = resting_inference(TALL[name], COARSE)
    bodies = inference.poses.bodies
    body = bodies[seed % len(bodies)]
    rng = np.random.default_rng(seed)
    xy = rng.uniform([-0.17, -0.12], [0.17, 0.12])
    if hidden:
        over, side = xy, 2 * body.radius + 0.02
        scene = occluders(rng, 3, xy, 0.05, 0.0)
    else:
        mesh = placed(body, xy, rng.uniform(0, 2 * np.pi))
        over, side = (
            xy + 0.6 * body.radius * np.array([1, 0.3]),
            1.2 * body.radius,
        )
        scene = [mesh, *occluders(rng, 2, over, 0.02, 0.0)]
    depth, label = render(camera, [*scene, roof(over, body.height, side)])
    mask = (label == 0) & (not hidden)
    if not hidden:
        amodal = amodal_of(mesh, camera)
        assert 0.2 < np.count_nonzero(mask) / amodal.sum() < 0.95
    result = inference.infer(depth, mask, camera)

    place = camera.project(np.array([*xy, body.middle]))[:2]
    expected = brute_force(
        [placed(one, np.zeros(2), 0.0) for one in bodies],
        [
            candidates(inference, one, place, camera, hidden=hidden)
            for one in bodies
        ],
        COARSE,
        depth,
        mask,
        camera,
        probabilities=[one.probability for one in bodies],
        walls=True,
    )
    assert np.count_nonzero(expected) > 100
    assert iou(result.support(), expected > 0) >= (0.96 if hidden else 0.95)
    either = result.support() | (expected > 0)
    most = 0.03 if hidden else 0.04
    assert np.abs(result.data - expected)[either].mean() <= most


@settings(max_examples=12)
@given(
    st.sampled_from(sorted(TALL)),
    st.integers(0, 2**32 - 1),
    st.sampled_from(sorted(CAMERAS)),
)
def test_drawing_agrees_with_rays_up_to_the_image_border(
    name: str, seed: int, view: str
) -> None:
    """Its sides count: at the border, a tall thing leans far out."""
    camera = CAMERAS[view]
    rng = np.random.default_rng(seed)
    bodies = inference_of(name).poses.bodies
    body = bodies[rng.integers(len(bodies))]
    angle = rng.uniform(0, 2 * np.pi)
    u, v = np.rint(rng.uniform([60, 60], [450, 320]))
    x, y, _ = poses_at(body, np.array([[u, v]]), np.array([angle]), camera)[0]
    depth, label = render(camera, [placed(body, np.array([x, y]), angle)])
    height = camera.unproject(depth.astype(float))[..., 2]

    reach = body.reach(camera, FLOOR)
    drawn = body.draw(angle, np.array([u, v]), View.of(camera), reach)
    rows, columns = np.nonzero(drawn >= 0)
    ours = np.zeros(camera.shape, dtype=bool)
    heights = np.zeros(camera.shape)
    at = rows + int(v) - reach, columns + int(u) - reach
    ours[at] = True
    heights[at] = drawn[rows, columns]
    truth = label == 0
    # A pixel whose ray grazes the outline may go either way.
    assert np.count_nonzero(ours ^ truth) <= 0.004 * truth.sum() + 1
    differ = np.abs(heights - height)[ours & truth] > 1e-4
    assert np.count_nonzero(differ) <= 0.01 * truth.sum()


@settings(max_examples=12)
@given(st.sampled_from(["die", "brick"]), st.integers(0, 2**32 - 1))
def test_support_holds_the_true_pose(name: str, seed: int) -> None:
    """Hidden under a roof of its own height, or peeping out."""
    rng = np.random.default_rng(seed)
    inference = inference_of(name)
    body = inference.poses.bodies[rng.integers(len(inference.poses.bodies))]
    xy = rng.uniform([-0.15, -0.1], [0.15, 0.1])
    mesh = placed(body, xy, rng.uniform(0, 2 * np.pi))
    camera = CAMERAS["rolled"]
    amodal = amodal_of(mesh, camera)
    hidden = bool(rng.integers(2))
    aside = xy if hidden else xy + rng.normal(0, body.radius, 2)
    # Wide enough to hide its sides, too.
    scene = [mesh, roof(aside, body.height, 2 * body.radius + 0.06)]
    depth, label = render(camera, scene)
    support = inference.infer(depth, label == 0, camera).support()
    assert np.count_nonzero(support & amodal) >= 0.97 * amodal.sum()


@settings(max_examples=8)
@given(seed=st.integers(0, 2**32 - 1))
@pytest.mark.parametrize("name", ["box_2to1", "brick"])
def test_a_taller_occluder_only_enlarges_a_hidden_support(
    name: str, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    camera = CAMERAS["nominal"]
    inference = inference_of(name)
    nothing = np.zeros(camera.shape, dtype=bool)
    rough = camera.plane_depth(0.0).astype(np.float32)
    sides = rng.uniform(30, 120, (3, 2)).astype(int)
    low, high = rough.copy(), rough.copy()
    for height, width in sides:
        v, u = rng.integers([50, 80], [200, 300])
        tall = rng.uniform(0.02, 0.06)
        box = slice(v, v + height), slice(u, u + width)
        low[box] = np.minimum(low[box], 0.8 - tall)
        high[box] = np.minimum(high[box], 0.8 - tall - rng.uniform(0, 0.04))
    small = inference.infer(low, nothing, camera).support()
    large = inference.infer(high, nothing, camera).support()
    assert not (small & ~large).any()


def test_what_lies_fits_under_what_is_too_low_for_it_upright() -> None:
    """A brick under a roof lower than it is long: only resting poses fit."""
    target = block(0.03, 0.045, 0.08)
    inference = resting_inference(target)
    lying = inference.poses.bodies[0]
    assert lying.height == pytest.approx(0.03)
    camera = CAMERAS["nominal"]
    mesh = placed(lying, np.array([0.05, 0.02]), 0.4)
    depth, label = render(
        camera, [mesh, roof(np.array([0.05, 0.02]), 0.03, 0.13)]
    )
    assert not (label == 0).any()
    nothing = label == 0
    amodal = amodal_of(mesh, camera)
    found = inference.infer(depth, nothing, camera).support()
    assert np.count_nonzero(found & amodal) >= 0.99 * amodal.sum()
    flat_only = GeometricInference(target, GeometricConfig("flat"))
    flat = flat_only.infer(depth, nothing, camera).support()
    assert not flat.any()


@pytest.mark.parametrize(
    ("name", "index", "x"),
    [
        *(("brick", index, 0.03) for index in range(3)),
        pytest.param("die", 0, 0.219, id="at a wall, leaning in the image"),
    ],
)
def test_what_is_seen_decides_between_poses(
    name: str, index: int, x: float
) -> None:
    """A brick whose top is seen whole lies on the face that is seen."""
    inference, camera = inference_of(name), CAMERAS["nominal"]
    body = inference.poses.bodies[index]
    mesh = placed(body, np.array([x, -0.02]), 0.3 * (x < 0.1))
    depth, label = render(camera, [mesh])
    support = inference.infer(depth, label == 0, camera).support()
    assert iou(support, label == 0) >= 0.93


def test_a_flat_target_is_found_where_flat_inference_finds_it() -> None:
    target = target_model("box_2to1")
    camera = CAMERAS["nominal"]
    depth, _ = render(camera, [roof(np.array([0.03, 0.01]), 0.01, 0.08)])
    nothing = np.zeros(camera.shape, dtype=bool)
    config = GeometricConfig(least_share=0.5)
    resting = resting_inference(target, config).infer(depth, nothing, camera)
    flat = GeometricInference(target).infer(depth, nothing, camera)
    assert iou(resting.support(), flat.support()) >= 0.97
