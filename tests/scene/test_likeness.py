import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.scene.likeness import (
    BOUND,
    ROTATIONS,
    Catalogue,
    distance,
    likeness,
    surface_points,
)
from xray_drake.scene.library import make_object, object_names
from xray_drake.splits import SPLITS

BRICK = trimesh.creation.box((0.08, 0.05, 0.02))
CONE = trimesh.creation.cone(0.03, 0.07, sections=12)
ELL = trimesh.boolean.union(
    [
        trimesh.creation.box(bounds=((0, 0, 0), (0.08, 0.02, 0.01))),
        trimesh.creation.box(bounds=((0, 0, 0), (0.02, 0.05, 0.01))),
    ],
    engine="manifold",
)

SELF = 0.02
"""Two samples of the same surface are nearer than this."""


def test_the_rotations_are_proper_and_all_different() -> None:
    assert len({R.tobytes() for R in ROTATIONS}) == 24
    for R in ROTATIONS:
        np.testing.assert_array_equal(R @ R.T, np.eye(3))
        assert round(np.linalg.det(R)) == 1


def test_points_are_spread_evenly() -> None:
    points = surface_points(BRICK, 2000)
    on_top = np.abs(points[:, 2] - 0.01) < 1e-9
    faces = 2 * (0.08 * 0.05 + 0.08 * 0.02 + 0.05 * 0.02)
    assert on_top.mean() == pytest.approx(0.08 * 0.05 / faces, abs=0.01)
    np.testing.assert_allclose(points.mean(axis=0), 0, atol=0.001)
    np.testing.assert_array_equal(points, surface_points(BRICK, 2000))


@pytest.mark.parametrize("mesh", [BRICK, CONE, ELL])
@given(
    scale=st.floats(0.1, 10),
    angles=st.tuples(*[st.floats(-3, 3)] * 3),
    shift=st.tuples(*[st.floats(-1, 1)] * 3),
)
@settings(max_examples=4, deadline=None)
def test_size_place_and_turn_do_not_count(
    mesh: trimesh.Trimesh,
    scale: float,
    angles: tuple[float, ...],
    shift: tuple[float, ...],
) -> None:
    X = trimesh.transformations.compose_matrix(
        scale=[scale] * 3, angles=angles, translate=shift
    )
    other = mesh.copy().apply_transform(X)
    assert distance(likeness(mesh), likeness(other)) < SELF


def test_other_shapes_are_far() -> None:
    shapes = [likeness(mesh) for mesh in (BRICK, CONE, ELL)]
    for i, one in enumerate(shapes):
        for other in shapes[:i]:
            found = distance(one, other)
            assert found > 2 * BOUND
            assert found == pytest.approx(distance(other, one), rel=0.02)
            assert distance(one, other, enough=0.02) == 0.02


def test_a_longer_brick_is_nearer_than_a_much_longer_one() -> None:
    def stretched(factor: float) -> float:
        other = BRICK.copy().apply_scale((factor, 1, 1))
        return distance(likeness(BRICK), likeness(other))

    assert stretched(1) < stretched(1.15) < stretched(1.4)
    assert stretched(1.4) > BOUND


def test_the_catalogue_finds_what_trying_all_finds() -> None:
    names = [
        name
        for family in ("bottle", "can", "flask", "pawn")
        for name in object_names(family)[:5]
    ]
    shapes = [likeness(make_object(name).visual) for name in names]
    catalogue = Catalogue()
    for name, shape in zip(names, shapes, strict=True):
        catalogue.add(name, shape)
    for index in (0, 7, 19):
        every = {
            name: distance(shapes[index], shape)
            for name, shape in zip(names, shapes, strict=True)
            if name != names[index]
        }
        nearest = min(every, key=lambda name: every[name])
        found, name = catalogue.nearest(shapes[index], np.inf, leave_out=index)
        assert (found, name) == (pytest.approx(every[nearest]), nearest)
    assert catalogue.nearest(shapes[0], 1e-6, leave_out=0) == (1e-6, "")


def test_no_two_objects_of_a_sample_are_alike() -> None:
    """All of them: ``python -m tests.scene.likeness``."""
    names = [name for split in SPLITS for name in object_names(split=split)]
    # Neighbours in a family are the most alike: some of these, and others.
    sample = names[5:9] + names[400:404] + names[::60]
    catalogue = Catalogue()
    for name in sample:
        shape = likeness(make_object(name).visual)
        found, other = catalogue.nearest(shape, BOUND)
        assert not other, (name, other, found)
        catalogue.add(name, shape)
