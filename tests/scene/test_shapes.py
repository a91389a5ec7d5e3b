import numpy as np
import pytest
import trimesh

from xray_drake.scene import shapes


@pytest.mark.parametrize(
    "solid",
    [
        shapes.cylinder(0.03, 0.05),
        shapes.frustum(0.03, 0.01, 0.05, squash=0.5),
        shapes.arc(0.02, 0.03, 0.01),
        shapes.arc(0.02, 0.03, 0.01, angle=np.pi, pieces=4),
        shapes.cup(0.03, 0.04, 0.08, wall=0.004, floor=0.005),
        shapes.rod((0, 0, 0), (0.01, 0.02, 0.03), 0.005),
        shapes.rod((0, 0, 0), (0.01, 0.02, 0.03), 0.03, 0.01),
        shapes.ellipsoid((0.01, 0.02, 0.03)),
        shapes.cylinder(0.01, 0.05).stretched((1, 2, 0.5)),
    ],
)
def test_pieces_have_the_volume_of_what_is_seen(solid):
    (surface,) = solid.surfaces
    assert surface.is_volume
    union = trimesh.boolean.union(
        [trimesh.Trimesh(hull).convex_hull for hull in solid.hulls],
        engine="manifold",
    )
    assert union.volume == pytest.approx(surface.volume, rel=1e-3)


def test_volume_of_a_ring_and_of_a_stretched_one():
    ring = shapes.arc(0.02, 0.03, 0.01)
    volume = 0.01 * 12 * np.sin(np.pi / 12) * (0.03**2 - 0.02**2)
    assert ring.surfaces[0].volume == pytest.approx(volume)
    (stretched,) = ring.stretched((1.5, 0.5, 2)).surfaces
    assert stretched.volume == pytest.approx(1.5 * volume)
    assert stretched.is_volume


def test_turned_and_moved():
    solid = shapes.box(0.1, 0.02, 0.02, (0.05, 0, 0))
    solid = solid.turned((0, 0, 1), np.pi / 2).moved(z=1)
    expected = [[-0.01, 0, 0.99], [0.01, 0.1, 1.01]]
    np.testing.assert_allclose(solid.surfaces[0].bounds, expected, atol=1e-12)
    hull = solid.hulls[0]
    np.testing.assert_allclose(
        [hull.min(axis=0), hull.max(axis=0)], expected, atol=1e-12
    )


def test_box_of_recognises_boxes_only():
    corners = shapes.box(0.1, 0.2, 0.3, (1, 2, 3)).hulls[0]
    found = shapes.box_of(corners)
    np.testing.assert_allclose(found, [[0.1, 0.2, 0.3], [1, 2, 3]])
    turned = shapes.box(0.1, 0.2, 0.3).turned((0, 0, 1), 0.1)
    for other in (
        turned.hulls[0],
        shapes.cylinder(0.1, 0.1).hulls[0],
        np.concatenate([corners[:7], corners[:1]]),
    ):
        assert shapes.box_of(other) is None


def test_rod_runs_between_its_ends():
    start, end = np.array([0.01, -0.02, 0.03]), np.array([0.05, 0.01, -0.02])
    (hull,) = shapes.rod(start, end, 0.004, 0.008).hulls
    along = (end - start) / np.linalg.norm(end - start)
    places = (hull - start) @ along
    np.testing.assert_allclose(
        np.unique(places.round(9)), [0, np.linalg.norm(end - start)], atol=1e-9
    )
    middle = hull[places < 1e-6].mean(axis=0)
    np.testing.assert_allclose(middle, start, atol=1e-12)
    assert len(hull) == 2 * shapes.SLENDER_SIDES
    thick = shapes.rod(start, end, 1.1 * shapes.SLENDER).hulls[0]
    assert len(thick) == 2 * shapes.COLLISION_SIDES


def test_beam_lies_on_the_plane():
    (hull,) = shapes.beam((0, 0), (0.03, 0.04), 0.01, 0.02).hulls
    np.testing.assert_allclose(
        [hull.min(axis=0), hull.max(axis=0)],
        [[-0.004, -0.003, 0], [0.034, 0.043, 0.02]],
        atol=1e-12,
    )
