import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from xray_drake.grasping.evidence.sampling import (
    cast_rays,
    sample_antipodal,
    sample_suction,
    seal_cups,
)
from xray_drake.grasping.judgement import Lip
from xray_drake.grasping.seal import RING_POINTS, frame_from_z, ring_offsets

FRICTION = 0.5
LIP = Lip(0.015, 0.001, np.deg2rad(15.0))


def outward_normal_of_box(points, extents):
    """Of the faces of an origin-centred box that the points lie on."""
    ratio = np.abs(points) / (np.asarray(extents) / 2)
    np.testing.assert_allclose(ratio.max(axis=1), 1.0, atol=1e-6)
    face = ratio.argmax(axis=1)
    normal = np.zeros_like(points)
    rows = np.arange(len(points))
    normal[rows, face] = np.sign(points[rows, face])
    return normal


@settings(max_examples=15)
@given(
    extents=st.tuples(*[st.floats(0.004, 0.1)] * 3), seed=st.integers(0, 1000)
)
def test_every_pair_on_a_box_is_antipodal(extents, seed):
    pairs, _ = sample_antipodal(
        trimesh.creation.box(extents),
        np.random.default_rng(seed),
        count=100,
        friction=FRICTION,
        max_width=0.045,
    )
    assert (len(pairs) > 0) == (min(extents) <= 0.045)
    if len(pairs) == 0:
        return
    cone = np.cos(np.arctan(FRICTION)) - 1e-6
    first = outward_normal_of_box(pairs.first, extents)
    second = outward_normal_of_box(pairs.second, extents)
    assert np.all((first * pairs.axis).sum(1) >= cone)
    assert np.all(-(second * pairs.axis).sum(1) >= cone)
    np.testing.assert_allclose(
        pairs.first - pairs.second, pairs.width[:, None] * pairs.axis, atol=1e-9
    )
    assert np.all(pairs.width <= 0.045 + 1e-9)
    worst = np.minimum(
        (first * pairs.axis).sum(1), -(second * pairs.axis).sum(1)
    )
    np.testing.assert_allclose(np.cos(pairs.angle), worst, atol=1e-6)


def test_pairs_on_a_ball_pass_near_its_center():
    radius = 0.02
    pairs, _ = sample_antipodal(
        trimesh.creation.icosphere(4, radius),
        np.random.default_rng(0),
        count=200,
        friction=FRICTION,
        max_width=0.045,
    )
    lever = np.linalg.norm(np.cross(pairs.middle, pairs.axis), axis=1)
    assert len(pairs) > 100
    # sin(atan μ) r, and the facets' share.
    assert lever.max() < 1.05 * radius * np.sin(np.arctan(FRICTION))


def test_a_hollow_tube_is_squeezed_from_outside_too():
    tube = trimesh.creation.annulus(r_min=0.008, r_max=0.010, height=0.08)
    pairs, _ = sample_antipodal(
        tube,
        np.random.default_rng(0),
        count=200,
        friction=FRICTION,
        max_width=0.045,
    )
    outside = np.linalg.norm(pairs.first[:, :2], axis=1) > 0.0095
    opposite = (pairs.first[:, :2] * pairs.second[:, :2]).sum(1) < 0
    across = np.abs(pairs.width - 0.020) < 0.001
    assert np.count_nonzero(outside & opposite & across) > 20


@pytest.mark.parametrize("sampler", ["jaw", "suction"])
def test_samples_follow_from_the_seed(sampler):
    mesh = trimesh.creation.box([0.04, 0.05, 0.03])

    def draw(seed):
        rng = np.random.default_rng(seed)
        if sampler == "suction":
            return sample_suction(mesh, rng, LIP, count=20)[0].point
        return sample_antipodal(
            mesh, rng, count=50, friction=FRICTION, max_width=0.045
        )[0].first

    np.testing.assert_array_equal(draw(3), draw(3))
    assert not np.array_equal(draw(3), draw(4))


@settings(max_examples=15)
@given(
    extents=st.tuples(*[st.floats(0.01, 0.1)] * 3), seed=st.integers(0, 1000)
)
def test_cups_stay_inside_the_faces_of_a_box(extents, seed):
    points, _ = sample_suction(
        trimesh.creation.box(extents),
        np.random.default_rng(seed),
        LIP,
        count=60,
    )
    if len(points) == 0:
        return
    normal = outward_normal_of_box(points.point, extents)
    np.testing.assert_allclose(points.approach, -normal, atol=1e-9)
    margin = np.asarray(extents) / 2 - np.abs(points.point)
    margin[np.abs(normal) > 0.5] = np.inf
    # The lip is tested at 12 points: a corner may cut in between them.
    assert margin.min() >= LIP.radius * np.cos(np.pi / RING_POINTS) - 1e-9


@pytest.mark.parametrize(
    ("mesh", "seals"),
    [
        (trimesh.creation.box([0.031, 0.031, 0.005]), True),
        (trimesh.creation.box([0.029, 0.1, 0.005]), False),
        # A ball's normals at the lip deviate by asin(r / R): 15° at 58 mm.
        (trimesh.creation.icosphere(4, 0.05), False),
        (trimesh.creation.icosphere(4, 0.07), True),
        # A cylinder falls off by r² / 2R across its axis, and the lip's plane
        # halves that: 1 mm at 56 mm. Its ends are large enough for the cup.
        (trimesh.creation.cylinder(0.200, 0.1, sections=256), True),
    ],
)
def test_what_a_cup_seals_on(mesh, seals):
    points, _ = sample_suction(mesh, np.random.default_rng(0), LIP, count=50)
    assert (len(points) > 0) == seals


@pytest.mark.parametrize(("radius", "seals"), [(0.075, True), (0.040, False)])
def test_a_cup_seals_on_the_side_of_a_wide_cylinder(radius, seals):
    """The lip deviates from its plane by half of R − √(R² − r²)."""
    points, _ = sample_suction(
        trimesh.creation.cylinder(radius, 0.2, sections=512),
        np.random.default_rng(0),
        LIP._replace(max_normal_angle=0.5),
        count=100,
    )
    on_side = np.abs(points.approach[:, 2]) < 0.5
    assert on_side.any() == seals
    drop = radius - np.sqrt(radius**2 - 0.015**2)
    np.testing.assert_allclose(points.unevenness[on_side], drop / 2, atol=1e-4)


def test_a_tilted_cup_finds_the_plane_it_meets():
    angle = 0.1
    X_OC = np.eye(4)
    X_OC[:3, :3] = [
        [np.cos(angle), 0, np.sin(angle)],
        [0, -1, 0],
        [np.sin(angle), 0, -np.cos(angle)],
    ]
    X_OC[:3, 3] = 0.0, 0.0, 0.012
    seal = seal_cups(
        trimesh.creation.box([0.08, 0.08, 0.02]),
        X_OC[None],
        LIP._replace(max_normal_angle=0.2),
    )
    assert seal.closed[0]
    np.testing.assert_allclose(seal.normal[0], [0, 0, -1], atol=1e-6)
    # The axis meets the face 2 mm lower, a little to the side.
    np.testing.assert_allclose(
        seal.center[0], [0.002 * np.tan(angle), 0, 0.01], atol=1e-6
    )
    middle = 0.002 / np.cos(angle)
    assert seal.spread[0] == pytest.approx(0.03 * np.tan(angle), rel=1e-4)
    assert seal.nearest[0] == pytest.approx(
        middle - 0.015 * np.tan(angle), abs=1e-6
    )


def test_rays_that_miss_say_so():
    mesh = trimesh.creation.box([0.02, 0.02, 0.02])
    distance, face = cast_rays(
        mesh,
        np.array([[0, 0, 0.05], [0.05, 0, 0.05]]),
        np.array([[0, 0, -1.0], [0, 0, -1.0]]),
    )
    np.testing.assert_allclose(distance, [0.04, np.inf], atol=1e-9)
    assert face[0] >= 0
    assert face[1] == -1


def test_frames_and_rings():
    z = np.random.default_rng(0).normal(size=(50, 3))
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    R = frame_from_z(z)
    np.testing.assert_allclose(np.linalg.det(R), 1.0)
    np.testing.assert_allclose(R[..., 2], z)
    np.testing.assert_allclose(
        R @ np.swapaxes(R, 1, 2), np.tile(np.eye(3), (50, 1, 1)), atol=1e-12
    )
    lip = ring_offsets(0.015)[:RING_POINTS]
    np.testing.assert_allclose(np.linalg.norm(lip, axis=1), 0.015)
