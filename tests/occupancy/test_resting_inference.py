"""Exact inference over all resting poses against brute force, and laws."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.masks import iou
from tests.occupancy.brute_force import RestingBruteForce, render
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
SMALL = {
    "nominal": make_camera(
        focal_length=276.25, center=(127.5, 95.5), size=(256, 192)
    ),
    "tilted": make_camera(
        tilt=9,
        azimuth=57,
        roll=5,
        focal_length=276.25,
        center=(127.5, 95.5),
        size=(256, 192),
    ),
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


def near(pixels: np.ndarray, place: np.ndarray, reach: float) -> np.ndarray:
    return pixels[(np.abs(pixels - place) <= reach).all(axis=1)]


# Each view has targets that lie in another way.
SCENES = [
    (name, view, seed) for name in TALL for seed, view in enumerate(SMALL)
]


@pytest.mark.parametrize(("name", "view", "seed"), SCENES)
def test_hidden_support_agrees_with_brute_force(
    name: str, view: str, seed: int
) -> None:
    target, camera = TALL[name], SMALL[view]
    inference = resting_inference(target, COARSE)
    rng = np.random.default_rng(seed)
    body = inference.poses.bodies[seed % len(inference.poses.bodies)]
    xy = rng.uniform([-0.17, -0.12], [0.17, 0.12])
    side = 2 * body.radius + 0.02
    others = occluders(rng, 3, xy, 0.05, 0.0)
    depth, _ = render(camera, [roof(xy, body.height, side), *others])
    nothing = np.zeros(camera.shape, dtype=bool)
    result = inference.infer(depth, nothing, camera)

    place = camera.project(np.array([*xy, body.middle]))[:2]
    poses = [
        poses_at(
            one,
            near(
                Blocks.on_floor(one, camera, FLOOR).pixels(HIDDEN_STEP),
                place,
                60,
            ),
            inference.poses.angles(one),
            camera,
        )
        for one in inference.poses.bodies
    ]
    meshes = [placed(one, np.zeros(2), 0.0) for one in inference.poses.bodies]
    shares = [one.probability for one in inference.poses.bodies]
    truth = RestingBruteForce(meshes, shares, COARSE, depth, nothing, camera)
    expected = truth.infer(poses)
    assert np.count_nonzero(expected) > 100
    assert iou(result.support(), expected > 0) >= 0.96
    either = result.support() | (expected > 0)
    assert np.abs(result.data - expected)[either].mean() <= 0.03


@pytest.mark.parametrize(("name", "view", "seed"), SCENES)
def test_seen_support_agrees_with_brute_force(
    name: str, view: str, seed: int
) -> None:
    target, camera = TALL[name], SMALL[view]
    inference = resting_inference(target, COARSE)
    rng = np.random.default_rng(seed)
    body = inference.poses.bodies[seed % len(inference.poses.bodies)]
    xy = rng.uniform([-0.17, -0.12], [0.17, 0.12])
    mesh = placed(body, xy, rng.uniform(0, 2 * np.pi))
    amodal = amodal_of(mesh, camera)
    aside = xy + 0.6 * body.radius * np.array([1, 0.3])
    depth, label = render(
        camera,
        [
            mesh,
            roof(aside, body.height, 1.2 * body.radius),
            *occluders(rng, 2, aside, 0.02, 0.0),
        ],
    )
    mask = label == 0
    assert 0.2 < np.count_nonzero(mask) / amodal.sum() < 0.95
    result = inference.infer(depth, mask, camera)

    place = camera.project(np.array([*xy, body.middle]))[:2]
    around = np.rint(place) + np.array(
        [[u, v] for u in range(-30, 31) for v in range(-30, 31)]
    )
    poses = [
        poses_at(one, around, inference.poses.seen_angles(one), camera)
        for one in inference.poses.bodies
    ]
    meshes = [placed(one, np.zeros(2), 0.0) for one in inference.poses.bodies]
    shares = [one.probability for one in inference.poses.bodies]
    truth = RestingBruteForce(meshes, shares, COARSE, depth, mask, camera)
    expected = truth.infer(poses)
    assert iou(result.support(), expected > 0) >= 0.95
    either = result.support() | (expected > 0)
    assert np.abs(result.data - expected)[either].mean() <= 0.04


@settings(max_examples=12, deadline=None)
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


def test_pixels_at_the_border_show_the_side() -> None:
    """The numbers behind the rule: 6 cm high, 20 cm aside, 80 cm below."""
    body = inference_of("die").poses.bodies[0]
    camera = CAMERAS["nominal"]
    pixel = camera.project(np.array([0.2, 0.0, body.middle]))[:2].round()
    reach = body.reach(camera, FLOOR)
    drawn = body.draw(0.0, pixel, View.of(camera), reach)
    row = drawn[reach]
    seen = np.flatnonzero(row >= 0)
    # From x = 0.17 on the floor to x = 0.23 at the top.
    expected = 552.5 * (0.23 / 0.74 - 0.17 / 0.8)
    assert len(seen) == pytest.approx(expected, abs=1.5)
    side = np.count_nonzero((row >= 0) & (row < 0.0595))
    assert side == pytest.approx(552.5 * (0.17 / 0.74 - 0.17 / 0.8), abs=1.5)


@settings(max_examples=12, deadline=None)
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


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_taller_occluder_only_enlarges_a_hidden_support(seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = CAMERAS["nominal"]
    inference = inference_of("brick")
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
    flat = GeometricInference(target).infer(depth, nothing, camera).support()
    assert not flat.any()


def test_what_is_seen_decides_between_poses() -> None:
    """A brick whose top is seen whole lies on the face that is seen."""
    inference = inference_of("brick")
    camera = CAMERAS["nominal"]
    for body in inference.poses.bodies:
        mesh = placed(body, np.array([0.03, -0.02]), 0.3)
        depth, label = render(camera, [mesh])
        mask = label == 0
        support = inference.infer(depth, mask, camera).support()
        assert iou(support, mask) >= 0.93


def test_a_thing_at_the_wall_may_lean_over_the_floor_in_the_image() -> None:
    inference = inference_of("die")
    body = inference.poses.bodies[0]
    camera = CAMERAS["nominal"]
    mesh = placed(body, np.array([0.219, 0.0]), 0.0)
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
