import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.poses import at, downwards
from xray_drake.grasping.evidence.sampling import (
    sample_antipodal,
    sample_suction,
    seal_cups,
)
from xray_drake.grasping.judgement import Lip
from xray_drake.grasping.seal import RING_POINTS, frame_from_z

FRICTION = 0.5
LIP = Lip(0.015, 0.001, np.deg2rad(15.0))


def antipodal(mesh, seed=0, count=200):
    rng = np.random.default_rng(seed)
    pairs, _ = sample_antipodal(
        mesh, rng, count=count, friction=FRICTION, max_width=0.045
    )
    return pairs


def places(mesh, seed=0, count=60, lip=LIP):
    rng = np.random.default_rng(seed)
    return sample_suction(mesh, rng, lip, count=count)[0]


def outward_normal_of_box(points, extents):
    """Of the faces of an origin-centred box that the points lie on."""
    ratio = np.abs(points) / (np.asarray(extents) / 2)
    np.testing.assert_allclose(ratio.max(axis=1), 1.0, atol=1e-6)
    rows, face = np.arange(len(points)), ratio.argmax(axis=1)
    normal = np.zeros_like(points)
    normal[rows, face] = np.sign(points[rows, face])
    return normal


BOXES = st.tuples(*[st.floats(0.004, 0.1)] * 3)
SEEDS = st.integers(0, 1000)


@settings(max_examples=15)
@given(BOXES, SEEDS)
def test_every_pair_on_a_box_is_antipodal(extents, seed):
    pairs = antipodal(trimesh.creation.box(extents), seed, count=100)
    assert (len(pairs) > 0) == (min(extents) <= 0.045)
    if len(pairs) == 0:
        return
    first = outward_normal_of_box(pairs.first, extents)
    second = outward_normal_of_box(pairs.second, extents)
    worst = np.minimum(
        (first * pairs.axis).sum(1), -(second * pairs.axis).sum(1)
    )
    assert np.all(worst >= np.cos(np.arctan(FRICTION)) - 1e-6)
    np.testing.assert_allclose(np.cos(pairs.angle), worst, atol=1e-6)
    apart = pairs.first - pairs.second
    along = pairs.width[:, None] * pairs.axis
    np.testing.assert_allclose(apart, along, atol=1e-9)
    assert np.all(pairs.width <= 0.045 + 1e-9)


def test_a_hollow_tube_is_squeezed_from_outside_too():
    tube = trimesh.creation.annulus(r_min=0.008, r_max=0.010, height=0.08)
    pairs = antipodal(tube)
    outside = np.linalg.norm(pairs.first[:, :2], axis=1) > 0.0095
    opposite = (pairs.first[:, :2] * pairs.second[:, :2]).sum(1) < 0
    across = np.abs(pairs.width - 0.020) < 0.001
    assert np.count_nonzero(outside & opposite & across) > 20


def test_samples_follow_from_the_seed():
    mesh = trimesh.creation.box([0.04, 0.05, 0.03])
    for draw, field in ((antipodal, "first"), (places, "point")):
        a, b, c = (getattr(draw(mesh, seed), field) for seed in (3, 3, 4))
        np.testing.assert_array_equal(a, b)
        assert not np.array_equal(a, c)


@settings(max_examples=15)
@given(BOXES, SEEDS)
def test_cups_stay_inside_the_faces_of_a_box(extents, seed):
    found = places(trimesh.creation.box(extents), seed)
    normal = outward_normal_of_box(found.point, extents)
    np.testing.assert_allclose(found.approach, -normal, atol=1e-9)
    margin = np.asarray(extents) / 2 - np.abs(found.point)
    margin[np.abs(normal) > 0.5] = np.inf
    # The lip is tested at 12 points: a corner may cut in between them.
    least = LIP.radius * np.cos(np.pi / RING_POINTS) - 1e-9
    assert margin.min(initial=np.inf) >= least


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
    assert (len(places(mesh)) > 0) == seals


@pytest.mark.parametrize(("radius", "seals"), [(0.075, True), (0.040, False)])
def test_a_cup_seals_on_the_side_of_a_wide_cylinder(radius, seals):
    """The lip deviates from its plane by half of R − √(R² − r²)."""
    cylinder = trimesh.creation.cylinder(radius, 0.2, sections=512)
    lip = LIP._replace(max_normal_angle=0.5)
    points = places(cylinder, count=100, lip=lip)
    on_side = np.abs(points.approach[:, 2]) < 0.5
    assert on_side.any() == seals
    drop = radius - np.sqrt(radius**2 - 0.015**2)
    np.testing.assert_allclose(points.unevenness[on_side], drop / 2, atol=1e-4)


def test_a_tilted_cup_finds_the_plane_it_meets():
    angle = 0.1
    X_OC = at(0, 0, 0.012, pitch=-angle) @ downwards(0, 0, 0)
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


def test_frames_are_rotations():
    z = np.random.default_rng(0).normal(size=(50, 3))
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    R = frame_from_z(z)
    np.testing.assert_allclose(np.linalg.det(R), 1.0)
    np.testing.assert_allclose(R[..., 2], z)
    unit = np.broadcast_to(np.eye(3), R.shape)
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), unit, atol=1e-12)
