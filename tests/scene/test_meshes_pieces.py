import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from xray_drake.scene.meshes.losses import LossLimits, measure_losses
from xray_drake.scene.meshes.pieces import (
    MOST_GROWTH,
    grown_to,
    hull_volume,
    merged_pieces,
    simplified_hull,
    without_slivers,
)
from xray_drake.scene.meshes.prepare import deviation

seeds = st.integers(0, 2**32 - 1)


def cloud(seed, count):
    rng = np.random.default_rng(seed)
    stretch = rng.uniform(0.005, 0.05, 3)
    return rng.normal(size=(count, 3)) * stretch + rng.uniform(-0.1, 0.1, 3)


def outside(points, vertices):
    planes = ConvexHull(vertices).equations
    return (points @ planes[:, :3].T + planes[:, 3]).max(axis=1)


@settings(max_examples=25, deadline=None)
@given(seed=seeds, count=st.integers(2, 9), left=st.integers(1, 4))
def test_merging_leaves_few_pieces_that_hold_the_old_ones(seed, count, left):
    pieces = [cloud(seed + k, 12) for k in range(count)]
    merged = merged_pieces(pieces, left)
    assert len(merged) == min(left, count)
    for piece in pieces:
        assert any(outside(piece, big).max() < 1e-9 for big in merged)


def test_neighbours_are_merged_first():
    corners = np.asarray(trimesh.creation.box((0.02, 0.02, 0.02)).vertices)
    places = (0.0, 0.02, 0.1, 0.12)
    merged = merged_pieces([corners + [x, 0, 0] for x in places], 2)
    assert sorted(round(float(p[:, 0].mean()), 3) for p in merged) == [
        0.01,
        0.11,
    ]


@settings(max_examples=25, deadline=None)
@given(seed=seeds, most=st.integers(4, 20))
def test_simplified_hull_is_small_and_inside(seed, most):
    points = cloud(seed, 60)
    chosen = simplified_hull(points, most)
    assert len(chosen) <= most
    assert outside(chosen, points).max() < 1e-9
    assert hull_volume(chosen) <= hull_volume(points) * (1 + 1e-9)
    assert {tuple(p) for p in chosen} <= {tuple(p) for p in points}


@settings(max_examples=25, deadline=None)
@given(seed=seeds)
def test_growing_restores_the_volume_up_to_a_limit(seed):
    points = cloud(seed, 60)
    chosen = simplified_hull(points, 12)
    grown = grown_to(chosen, hull_volume(points))
    factor = (hull_volume(grown) / hull_volume(chosen)) ** (1 / 3)
    assert 1 - 1e-9 <= factor <= MOST_GROWTH + 1e-9
    if factor < MOST_GROWTH - 1e-6:
        assert hull_volume(grown) == pytest.approx(hull_volume(points))
    assert outside(chosen, grown).max() < 1e-9


def test_simplified_hull_of_a_box_is_the_box():
    box = trimesh.creation.box((0.1, 0.05, 0.02))
    fine = np.asarray(box.subdivide().subdivide().vertices)
    chosen = simplified_hull(fine, 12)
    assert {tuple(p) for p in chosen} == {tuple(p) for p in box.vertices}


def test_twelve_vertices_keep_most_of_a_ball():
    ball = trimesh.creation.icosphere(3, 0.03)
    chosen = simplified_hull(np.asarray(ball.vertices), 12)
    assert hull_volume(chosen) > 0.57 * ball.volume, "an icosahedron has 0.605"


def test_losses_of_known_shapes():
    box = trimesh.creation.box((0.08, 0.04, 0.04))
    corners = np.asarray(box.vertices)
    none = measure_losses(box, [corners])
    assert none.missing == pytest.approx(0, abs=1e-5)
    assert none.silhouette < 0.01
    LossLimits().check(none)
    half = measure_losses(box, [corners * [0.5, 1, 1]])
    assert half.missing == pytest.approx(0.5, abs=1e-4)
    assert half.volume == pytest.approx(-0.5, abs=1e-4)
    assert half.added == pytest.approx(0, abs=1e-6)
    assert half.silhouette == pytest.approx(0.5, abs=0.03)
    double = measure_losses(box, [corners * [2, 1, 1]])
    assert double.added == pytest.approx(1, abs=1e-4)
    assert double.silhouette == pytest.approx(0.5, abs=0.03)
    with pytest.raises(ValueError, match="miss 50% of its volume"):
        LossLimits().check(half)
    with pytest.raises(ValueError, match="silhouette by"):
        LossLimits(added=2).check(double)


def test_shapes_are_compared_where_they_are():
    box = trimesh.creation.box((0.04, 0.04, 0.04))
    moved = measure_losses(box, [np.asarray(box.vertices) + [0.02, 0, 0]])
    assert moved.volume == pytest.approx(0, abs=1e-5)
    assert moved.missing == pytest.approx(0.5, abs=1e-4)


def test_deviation_of_a_ball_from_a_coarser_one():
    fine = trimesh.creation.icosphere(4, 0.03)
    coarse = trimesh.creation.icosphere(2, 0.03)
    expected = 0.03 - float(
        np.abs(coarse.face_normals * coarse.triangles_center).sum(axis=1).min()
    )
    assert deviation(fine, coarse) == pytest.approx(expected, rel=0.3)


@given(st.integers(0, 2**32 - 1))
def test_no_vertex_lies_on_an_edge(seed):
    """Turned, a point of an edge is beside it by rounding: a sliver."""
    rng = np.random.default_rng(seed)
    corners = trimesh.creation.box([0.07, 0.04, 0.004]).vertices
    ends = corners[rng.choice(8, (6, 2))]
    share = rng.uniform(0.2, 0.8, (6, 1))
    on_sides = share * ends[:, 0] + (1 - share) * ends[:, 1]
    R = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
    turned = np.concatenate([corners, on_sides]) @ R.T
    turned += rng.uniform(-1e-9, 1e-9, turned.shape)
    kept = without_slivers(turned[ConvexHull(turned).vertices])
    assert len(kept) == 8
    away = np.linalg.norm(kept[:, None] - turned[:8], axis=2).min(axis=0)
    assert away.max() < 1e-8
