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
    ],
)
def test_octagons_have_the_volume_of_what_is_seen(solid):
    (surface,) = solid.surfaces
    assert surface.is_volume
    union = trimesh.boolean.union(
        [trimesh.Trimesh(hull).convex_hull for hull in solid.hulls],
        engine="manifold",
    )
    assert union.volume == pytest.approx(surface.volume, rel=1e-3)


def test_ring_volume():
    surface = shapes.arc(0.02, 0.03, 0.01).surfaces[0]
    area = 12 * np.sin(np.pi / 12) * (0.03**2 - 0.02**2)
    assert surface.volume == pytest.approx(0.01 * area)


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
    assert found is not None
    np.testing.assert_allclose(found[0], [0.1, 0.2, 0.3])
    np.testing.assert_allclose(found[1], [1, 2, 3])
    turned = shapes.box(0.1, 0.2, 0.3).turned((0, 0, 1), 0.1)
    assert shapes.box_of(turned.hulls[0]) is None
    assert shapes.box_of(shapes.cylinder(0.1, 0.1).hulls[0]) is None
    assert shapes.box_of(np.concatenate([corners[:7], corners[:1]])) is None
