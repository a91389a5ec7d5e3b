"""Evidence of depth: what is planned on what a camera sees."""

import cv2
import numpy as np
import pytest

from tests.grasping.depth_scenes import (
    ball,
    block,
    clutter,
    model_block,
    rod,
    see,
    turned,
)
from tests.grasping.test_depth_free_space import depth_inside
from tests.occupancy.scenes import CAMERAS
from tests.poses import at
from xray_drake.grasping.evidence.depth import (
    DepthEvidence,
    DepthPlannerConfig,
    SeenObject,
    guess_weight,
)
from xray_drake.grasping.evidence.depth_surface import observe
from xray_drake.grasping.evidence.model import ModelEvidence
from xray_drake.grasping.judgement import GRAVITY, GripperModel
from xray_drake.grasping.planner import GraspPlanner
from xray_drake.messages import GraspKind
from xray_drake.scene.library import make_object, object_names
from xray_drake.scene.packaging import PACKAGED, flattest_side

CAMERA = CAMERAS["nominal"]
FLAT = [0.042, 0.021, 0.005]
PLATE = [0.08, 0.08, 0.01]


@pytest.fixture(scope="module")
def planner():
    return GraspPlanner(DepthEvidence(seed=3))


@pytest.fixture(scope="module")
def truth():
    return GraspPlanner(ModelEvidence([model_block("flat", *FLAT)]))


def look(*meshes, camera=CAMERA):
    """The first of them, as a camera sees it."""
    depth, mask = see(camera, *meshes)
    return SeenObject(mask, depth, camera)


def test_grasps_on_a_thin_box_hold(planner, truth):
    """The model of the box says so of nearly all.

    Of 211 poses 209: where the pads meet a corner of it first, they touch in a
    point, and a box that is not held in its middle turns about that.
    """
    rng = np.random.default_rng(0)
    cameras = [CAMERAS[name] for name in ("nominal", "tilted", "low")]
    held = 0
    for index in range(24):
        x, y, yaw = rng.uniform(-1, 1, 3) * [0.15, 0.10, np.pi]
        X_WO = at(x, y, 0.0025, yaw=yaw)
        seen = look(block(FLAT, X_WO), camera=cameras[index % 3])
        grasp = planner.plan("flat", seen).grasp
        judged = truth.judge(
            grasp, {"flat": X_WO}, X_WG_perturbed=grasp.X_WG, friction=0.5
        )
        held += grasp.quality > 0.2 and judged.quality > 0
    assert held >= 23


@pytest.mark.parametrize("camera", ["nominal", "tilted"])
@pytest.mark.parametrize(
    "mesh",
    [
        block(PLATE, at(0.05, 0, 0.005)),
        block(FLAT, at(0.02, 0.01, 0.0025)),
        block([0.03, 0.03, 0.03], at(0, 0, 0.015)),
        ball(0.018, 0.06, 0, 0.018),
    ],
    ids=["plate", "flat", "cube", "ball"],
)
def test_no_plan_hangs_on_the_last_digit_of_a_reading(planner, mesh, camera):
    """Of what is symmetric many grasps are as good: rounding, which is the
    processor's, does not choose among them."""
    seen = look(mesh, camera=CAMERAS[camera])
    depth = seen.depth.astype(np.float32)
    grasp = planner.plan("it", seen._replace(depth=depth)).grasp
    assert grasp
    for seed in range(3):
        up = np.random.default_rng(seed).random(depth.shape) < 0.5
        other = np.nextafter(depth, np.where(up, np.inf, 0).astype(np.float32))
        again = planner.plan("it", seen._replace(depth=other)).grasp
        assert again.kind is grasp.kind
        np.testing.assert_allclose(again.X_WG, grasp.X_WG, atol=1e-4)


X_ROD = at(0, 0.03, 0.012, np.pi / 2, 0, 0.5)


@pytest.mark.parametrize(
    ("camera", "mesh", "middle", "width"),
    [
        ("nominal", ball(0.018, 0.06, 0, 0.018), (0.06, 0, 0.018), 0.036),
        ("tilted", ball(0.018, 0.06, 0, 0.018), (0.06, 0, 0.018), 0.036),
        ("nominal", rod(0.012, 0.09, X_ROD), None, 0.024),
    ],
    ids=["ball", "ball from aside", "lying rod"],
)
def test_what_is_round_is_squeezed_across(planner, camera, mesh, middle, width):
    seen = look(mesh, camera=CAMERAS[camera])
    grasp = planner.plan("it", seen).grasp
    assert grasp.kind is GraspKind.JAW
    assert grasp.width == pytest.approx(width, abs=0.003)
    if middle is None:
        assert abs(grasp.X_WG[:3, 1] @ X_ROD[:3, 2]) < 0.2
    else:
        # The pads reach from 3 mm beyond the origin to 7 mm behind it.
        pads = grasp.X_WG[:3, 3] - 0.002 * grasp.X_WG[:3, 2]
        np.testing.assert_allclose(pads, middle, atol=0.005)


@pytest.mark.parametrize("seed", range(3))
def test_turning_scene_and_camera_turns_the_grasps(seed):
    """Without rehearsals, whose errors are drawn in the world's axes."""
    config = DepthPlannerConfig(rehearsals=0)
    planner = GraspPlanner(DepthEvidence(config=config))
    rng = np.random.default_rng(seed)
    meshes = clutter(rng, 3, spread=0.03)
    X = at(yaw=rng.uniform(0.3, 6.0))
    seen = look(*meshes, camera=CAMERAS["tilted"])
    found, again = (
        planner.find_grasps("it", seen._replace(camera=camera))
        for camera in (seen.camera, turned(seen.camera, X))
    )
    assert len(found) == len(again) > 0
    for a, b in zip(found, again, strict=True):
        # Of a jaw and the same jaw half turned, either may come first.
        turns = np.array([at(), at(yaw=np.pi)])
        error = np.abs(X @ a.X_WG @ turns - b.X_WG).max(axis=(1, 2))
        assert error.min() < 1e-6
        assert a.quality == pytest.approx(b.quality, abs=1e-6)
        assert a.width == pytest.approx(b.width, abs=1e-6)


def test_no_grasp_has_a_point_of_the_image_in_the_gripper(planner):
    camera = CAMERAS["tilted"]
    gripper, found = GripperModel(), 0
    least = np.cos(planner.evidence.config.max_tilt) - 1e-9
    for seed in range(6):
        seen = look(*clutter(np.random.default_rng(seed), 7), camera=camera)
        points = camera.unproject(seen.depth.astype(float)).reshape(-1, 3)
        points = points[points[:, 2] > 0.002]
        for grasp in planner.find_grasps("it", seen):
            opening = float(gripper.opening(np.asarray(grasp.width)))
            inside = depth_inside(points, grasp.X_WG, grasp.kind, opening)
            assert inside < 0.0005
            assert -grasp.X_WG[2, 2] >= least
            assert 0 < grasp.quality <= 1
            assert 0 <= grasp.width <= gripper.spec.opening
            found += 1
    assert found > 15


def test_what_cannot_be_seen_has_no_grasp(planner):
    seen = look(block(FLAT, at(0, 0, 0.0025)))
    planned = planner.plan("it", seen._replace(mask=seen.mask & False))
    assert not planned
    assert "too little is seen" in planned.why_not()


def test_odd_masks_do_no_harm(planner):
    """Of everything, of the border, of the floor alone, of a line."""
    seen = look(block(PLATE, at(0, 0, 0.005)))
    mask = seen.mask
    border, line, speckles = np.ones_like(mask), mask & False, mask & False
    border[3:-3, 3:-3] = False
    line[190] = True
    speckles[::7, ::5] = True
    for odd in (np.ones_like(mask), border, ~mask, line, speckles):
        grasp = planner.plan("it", seen._replace(mask=odd)).grasp
        assert np.isfinite(grasp.X_WG).all()
    only = seen._replace(depth=np.where(mask, seen.depth, np.nan))
    assert planner.plan("it", only).grasp.kind is GraspKind.SUCTION


def test_lost_readings_cost_no_grasp(planner):
    """One pixel in fifty, and a shadow 6 mm wide beside the object."""
    seen = look(block(FLAT, at(0, 0, 0.0025)))
    rng, depth = np.random.default_rng(0), np.array(seen.depth)
    depth[rng.random(depth.shape) < 0.02] = 0.0
    last = np.flatnonzero(seen.mask.any(axis=0)).max()
    depth[150:240, last + 1 : last + 5] = np.nan
    grasp = planner.plan("it", seen._replace(depth=depth)).grasp
    assert grasp.kind is GraspKind.JAW
    assert min(abs(grasp.width - side) for side in FLAT[:2]) < 0.004


@pytest.mark.parametrize("seed", range(3))
def test_a_mask_that_misses_its_border_costs_no_grasp(planner, seed):
    """Half of its outermost pixels, as colours mixed at an edge do."""
    rng = np.random.default_rng(seed)
    seen = look(block(FLAT, at(0.02, 0, 0.0025, yaw=rng.uniform(0, 6))))
    inner = cv2.erode(seen.mask.astype(np.uint8), np.ones((3, 3), np.uint8))
    kept = (inner > 0) | (rng.random(seen.mask.shape) >= 0.5)
    whole = planner.plan("it", seen).grasp
    grasp = planner.plan("it", seen._replace(mask=seen.mask & kept)).grasp
    assert grasp.kind is whole.kind is GraspKind.JAW
    assert grasp.quality > 0.6 * whole.quality


def test_a_card_that_lies_high_is_taken_for_as_light(planner):
    """Under a card in a heap are others, or nothing: not more of the card."""
    low, high = (
        planner.plan("it", look(block([0.10, 0.09, 0.004], at(0, 0, z)))).grasp
        for z in (0.012, 0.080)
    )
    assert low.kind is high.kind is GraspKind.SUCTION
    assert high.quality > 0.9 * low.quality


def test_high_in_a_heap_half_of_the_objects_weigh_more_than_is_guessed():
    config = DepthPlannerConfig()
    names = object_names(split="train")
    drawn = np.random.default_rng(0).permutation(len(names))[:40]
    ratios = []
    for name in (names[i] for i in drawn):
        for model in (make_object(name), make_object(name + PACKAGED)):
            lying = np.asarray(model.visual.vertices) @ flattest_side(model).T
            low, high = lying.min(axis=0), lying.max(axis=0)
            mesh = model.visual.copy()
            mesh.vertices = lying - [*(low + high)[:2] / 2, low[2] - 0.05]
            surface = observe(*see(CAMERA, mesh), CAMERA, min_pixels=20)
            assert surface is not None
            guess = guess_weight(
                surface, density=config.density, thickness=config.thickness
            )
            ratios.append(GRAVITY * model.mass / guess)
    assert 0.8 < np.median(ratios) < 1.25
    # None is guessed ten times too heavy.
    assert np.min(ratios) > 0.15


@pytest.mark.parametrize(("x", "y"), [(0.2, 0.15), (-0.22, 0.0)])
def test_beside_a_wall_the_gripper_stays_clear_of_it(planner, x, y):
    """The wall is not in the image; the exact check knows it."""
    scene, gripper = ModelEvidence(()).scene, GripperModel()
    seen = look(block([0.05, 0.03, 0.02], at(x, y, 0.01)))
    found = planner.find_grasps("it", seen)
    assert found
    for grasp in found:
        opening = float(gripper.opening(np.asarray(grasp.width)))
        assert not (
            scene.jaw_collides(grasp.X_WG, opening)
            if grasp.kind is GraspKind.JAW
            else scene.suction_collides(grasp.X_WG)
        )


def test_plans_follow_from_image_and_seed_alone(planner):
    meshes = clutter(np.random.default_rng(5), 4)
    seen, other = look(*meshes), GraspPlanner(DepthEvidence(seed=3))
    other_first = other.plan("it", look(*meshes[::-1])).grasp
    a, b = (each.plan("it", seen).grasp for each in (planner, other))
    assert a
    np.testing.assert_array_equal(a.X_WG, b.X_WG)
    assert (a.width, a.quality) == (b.width, b.quality)
    assert not np.array_equal(a.X_WG, other_first.X_WG)
