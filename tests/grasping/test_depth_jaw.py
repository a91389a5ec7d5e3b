from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.grasping.depth_scenes import ball, block, rod, surface_of
from tests.occupancy.scenes import CAMERAS
from tests.poses import at, downwards
from xray_drake.grasping.evidence.rims import (
    Rims,
    close_pads,
    find_rims,
    pair_rims,
    wall_points,
)
from xray_drake.grasping.judgement import GripperModel

GRIPPER = GripperModel()
"""Its pads are 10 mm wide and high, and reach 3 mm beyond the origin."""

LIMITS = {
    "friction": 0.5,
    "min_width": 0.002,
    "max_width": 0.045,
    "max_offset": 0.004,
    "max_step": 0.012,
}


def angles(a, b):
    return np.rad2deg(np.arccos(np.clip(np.sum(a * b, axis=-1), -1, 1)))


@pytest.mark.parametrize("name", ["nominal", "tilted"])
@pytest.mark.parametrize("roll", [0.0, 0.35])
def test_rims_of_a_block_have_the_normals_of_its_sides(name, roll):
    """Also where it leans, whose sides are not upright."""
    X = at(0.06, -0.04, 0.05, roll, 0, 0.4)
    extents = np.array([0.05, 0.03, 0.02])
    rims = find_rims(surface_of(CAMERAS[name], block(extents, X)), friction=0.5)
    inside = np.abs((rims.point - X[:3, 3]) @ X[:3, :3]) / (extents / 2)
    sides = np.concatenate([X[:3, :2].T, -X[:3, :2].T])
    error = angles(rims.normal[:, None], sides)
    # Away from the corners, where two sides' rims meet.
    clear = np.sort(inside[:, :2], axis=1)[:, 0] < 0.7
    assert np.percentile(error[clear].min(axis=1), 90) < 12
    for side in range(4):
        assert np.count_nonzero(error[:, side] < 12) >= 8


@pytest.mark.parametrize("name", ["nominal", "tilted"])
def test_rims_of_a_ball_are_its_equator(name):
    center = np.array([-0.05, 0.04, 0.018])
    surface = surface_of(CAMERAS[name], ball(0.018, *center))
    rims = find_rims(surface, friction=0.5)
    away = (rims.point - center) * [1, 1, 0]
    distance = np.linalg.norm(away, axis=1)
    assert distance.min() > 0.012
    error = angles(rims.normal, away / distance[:, None])
    at_equator = distance > 0.0165
    assert at_equator.sum() > 40
    assert np.percentile(error[at_equator], 90) < 20


def test_a_cup_has_rims_inside_and_outside():
    outer, inner = rod(0.03, 0.04, at(0, 0, 0.02)), rod(0.026, 0.1, at())
    cup = outer.difference(inner, engine="manifold")
    rims = find_rims(surface_of(CAMERAS["nominal"], cup), friction=0.5)
    outwards = np.sum(rims.normal * rims.point, axis=1)
    assert np.count_nonzero(outwards > 0) > 30
    assert np.count_nonzero(outwards < 0) > 30
    pairs, _ = pair_rims(rims, **LIMITS)
    assert np.count_nonzero(pairs.width < 0.008) > 30


def walls_of(*extents, x=0.0):
    """What is taken for the walls of a block on the floor."""
    mesh = block(extents, at(x, 0, extents[2] / 2))
    surface = surface_of(CAMERAS["nominal"], mesh)
    return wall_points(find_rims(surface, friction=0.5))


@pytest.mark.parametrize(
    ("height", "lowest", "highest"),
    [(0.02, 0.005, 0.012), (0.005, -1e-3, 0.002)],
)
def test_walls_go_down_from_their_rims(height, lowest, highest):
    points, normals = walls_of(0.04, 0.03, height)
    assert points.shape == normals.shape
    assert points[:, 2].max() == pytest.approx(height, abs=1e-4)
    assert lowest < points[:, 2].min() < highest
    assert np.abs(normals[:, 2]).max() < 0.2


@st.composite
def some_rims(draw):
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    count = draw(st.integers(0, 12))
    normal = rng.normal(size=(count, 3)) * [1, 1, 0.2]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    point = rng.normal(
        scale=draw(st.sampled_from([0.012, 0.03])), size=(count, 3)
    ) * [1, 1, 0.3]
    return Rims(point, normal, np.full(count, 0.01))


@settings(max_examples=60)
@given(some_rims())
def test_pairs_are_those_that_a_double_loop_finds(rims):
    found, too_wide = pair_rims(rims, **LIMITS)
    expected, wide = [], 0
    for i, j in combinations(range(len(rims)), 2):
        between = rims.normal[i] - rims.normal[j]
        axis = between / np.linalg.norm(between)
        cone = np.cos(np.arctan(0.5))
        d = rims.point[i] - rims.point[j]
        side = np.cross(axis, [0, 0, 1])
        side /= np.linalg.norm(side)
        opposite = (
            rims.normal[i] @ axis >= cone
            and -rims.normal[j] @ axis >= cone
            and d @ axis >= 0.002
            and abs(d @ side) <= 0.004
            and abs(d @ np.cross(side, axis)) <= 0.012
            and abs(axis[2]) < 0.95
        )
        if opposite and d @ axis <= 0.045:
            expected.append((rims.point[i], rims.point[j], d @ axis))
        wide += opposite and d @ axis > 0.045
    assert (len(found), too_wide) == (len(expected), wide)
    for k, (first, second, width) in enumerate(expected):
        np.testing.assert_array_equal(found.first[k], first)
        np.testing.assert_array_equal(found.second[k], second)
        assert found.width[k] == pytest.approx(width)
        assert 0 <= found.angle[k] <= np.arctan(0.5) + 1e-6


def close_one(points, normals, X_WG, opening):
    """Closes the pads on points one by one."""
    p = (points - X_WG[:3, 3]) @ X_WG[:3, :3]
    n = normals @ X_WG[:3, :3]
    contacts = []
    for sign in (1, -1):
        touch = [
            (sign * y, k)
            for k, (x, y, z) in enumerate(p)
            if abs(x) <= 0.005
            and -0.007 <= z <= 0.003
            and abs(y) <= opening / 2
            and sign * n[k, 1] > 0.3
        ]
        if not touch:
            return None
        first = max(touch)[0]
        near = [k for y, k in touch if y >= first - 0.001]
        contacts.append((first, np.mean(n[near], axis=0)[1] * sign))
    return contacts


@settings(max_examples=40)
@given(seed=st.integers(0, 10_000))
def test_closing_against_points_one_by_one(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(scale=0.008, size=(60, 3))
    normals = rng.normal(size=(60, 3)) + 60 * points * [1, 1, 0]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    turns = rng.uniform(0, 6, 5)
    X_WG = np.array(
        [downwards(*rng.normal(scale=0.004, size=3), a) for a in turns]
    )
    opening = rng.uniform(0.02, 0.05, 5)
    found = close_pads(points, normals, X_WG, opening, GRIPPER)
    for i in range(5):
        contacts = close_one(points, normals, X_WG[i], opening[i])
        width = sum(y for y, _ in contacts) if contacts else -1.0
        assert found.found[i] == (width > 0)
        if width > 0:
            assert found.width[i] == pytest.approx(width, abs=1e-5)
            worst = max(np.arccos(np.clip(c, -1, 1)) for _, c in contacts)
            assert found.angle[i] == pytest.approx(worst, abs=1e-3)
            assert 0 < found.coverage[i] <= 1


def test_pads_meet_a_blocks_sides():
    places = (0.02, 0, 0.013), (0.02, 0, 0.025), (0.07, 0, 0.013)
    X_WG = np.array([downwards(*place) for place in places])
    walls = walls_of(0.05, 0.03, 0.02, x=0.02)
    squeeze = close_pads(*walls, X_WG, np.full(3, 0.04), GRIPPER)
    assert squeeze.found.tolist() == [True, False, False]
    assert squeeze.width[0] == pytest.approx(0.03, abs=0.002)
    assert np.rad2deg(squeeze.angle[0]) < 12
    assert squeeze.coverage[0] > 0.6
    np.testing.assert_allclose(squeeze.middle[0, :2], [0.02, 0], atol=0.002)
