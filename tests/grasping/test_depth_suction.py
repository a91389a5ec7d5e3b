import numpy as np
import pytest

from tests.grasping.depth_scenes import ball, block, clutter, surface_of
from tests.occupancy.scenes import CAMERAS
from tests.poses import at, downwards
from xray_drake.grasping.evidence.depth_suction import seal_on_depth, seals_seen
from xray_drake.grasping.evidence.sampling import seal_cups
from xray_drake.grasping.judgement import Lip

LIP = Lip(0.015, 0.0025, 0.7)


@pytest.mark.parametrize("name", ["nominal", "tilted"])
@pytest.mark.parametrize("pitch", [0.0, 0.4])
def test_a_plate_is_found_where_the_lip_fits(name, pitch):
    X = at(0.05, 0.02, 0.05, 0, pitch, 0.3)
    surface = surface_of(CAMERAS[name], block([0.07, 0.05, 0.01], X))
    points, _ = seals_seen(surface, LIP, count=200)
    assert len(points) > 30
    p = (points.point - X[:3, 3]) @ X[:3, :3]
    np.testing.assert_allclose(p[:, 2], 0.005, atol=5e-4)
    # A pixel and a half more than the lip itself needs.
    assert np.abs(p[:, 0]).max() < 0.035 - 0.015 + 0.002
    assert np.abs(p[:, 1]).max() < 0.025 - 0.015 + 0.002
    np.testing.assert_allclose(
        points.approach, np.tile(-X[:3, 2], (len(p), 1)), atol=0.03
    )
    middle = np.linalg.norm(p[:, :2], axis=1) < 0.003
    assert points.roomy[middle].all()
    assert not points.roomy[np.abs(p[:, 1]) > 0.008].any()


NARROW = block([0.08, 0.026, 0.01], at(0, 0, 0.005))


@pytest.mark.parametrize(
    ("mesh", "top", "seals"),
    [
        # The lip's normals lean by asin(r / R) from the cup's axis.
        (ball(0.030, 0, 0, 0.030), 0.060, True),
        (ball(0.019, 0, 0, 0.019), 0.038, False),
        (NARROW, 0.01, False),
    ],
)
def test_what_is_small_does_not_seal(mesh, top, seals):
    surface = surface_of(CAMERAS["nominal"], mesh)
    seal = seal_on_depth(surface, downwards(0, 0, top)[None], LIP)
    assert seal.closed[0] == seals
    assert (len(seals_seen(surface, LIP, count=200)[0]) > 0) == seals


def test_how_far_a_cup_is_from_a_plate():
    surface = surface_of(
        CAMERAS["nominal"], block([0.07, 0.07, 0.01], at(0, 0, 0.005))
    )
    lean = at(0, 0, 0.013, roll=np.pi + 0.1)
    seal = seal_on_depth(surface, np.array([downwards(0, 0, 0.013), lean]), LIP)
    assert seal.closed.all()
    np.testing.assert_allclose(seal.nearest[0], 0.003, atol=2e-4)
    np.testing.assert_allclose(seal.spread, [0, 0.030 * np.tan(0.1)], atol=5e-4)
    np.testing.assert_allclose(seal.normal, [[0, 0, -1]] * 2, atol=0.01)
    np.testing.assert_allclose(seal.center[:, 2], 0.010, atol=3e-4)


def test_it_agrees_with_the_seal_on_the_mesh():
    """Where the mesh seals with a margin so does the image, and back."""
    agree = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        mesh = clutter(rng, 1)[0]
        mesh.apply_scale(1.6)
        mesh.apply_translation([0.03, 0.02, -mesh.bounds[0, 2]])
        surface = surface_of(CAMERAS["nominal"], mesh)
        cups = np.array([downwards(*p) for p in surface.object_points[::40]])
        seen = seal_on_depth(surface, cups, LIP).closed
        for grow, loose, says in ((0.003, 0.5, True), (-0.003, 1.5, False)):
            truth = seal_cups(
                mesh, cups, Lip(0.015 + grow, 0.0025 * loose, 0.7)
            ).closed
            agree.append(seen[truth == says] == says)
    agree = np.concatenate(agree)
    assert len(agree) > 200
    assert agree.mean() > 0.98
