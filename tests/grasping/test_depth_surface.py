import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.grasping.depth_scenes import ball, block, clutter, see, surface_of
from tests.occupancy.scenes import CAMERAS
from tests.poses import at, downwards
from xray_drake.grasping.evidence.depth_suction import seal_on_depth, seals_seen
from xray_drake.grasping.evidence.depth_surface import (
    fill_gaps,
    fill_mask,
    observe,
)
from xray_drake.grasping.evidence.sampling import seal_cups
from xray_drake.grasping.judgement import Lip

NOMINAL = CAMERAS["nominal"]
IMAGES = arrays(
    np.float32,
    (6, 9),
    elements=st.sampled_from([0.0, np.nan, np.inf, 0.5, 0.6, 0.7, 0.8]),
)


@given(IMAGES)
def test_a_gap_gets_the_farther_of_its_rows_next_readings(depth):
    for row, result in zip(depth, fill_gaps(depth), strict=True):
        known = {i: d for i, d in enumerate(row) if np.isfinite(d) and d > 0}
        for i, value in enumerate(result):
            left = [j for j in known if j <= i]
            right = [j for j in known if j >= i]
            ends = [known[max(left)]] if left else []
            ends += [known[min(right)]] if right else []
            assert value == (max(ends) if ends else np.inf)


@given(IMAGES, arrays(bool, (6, 9)))
def test_a_gap_of_the_mask_gets_a_near_reading_of_the_mask(depth, mask):
    known = mask & np.isfinite(depth) & (depth > 0)
    if not known.any():
        return
    filled = fill_mask(depth, mask)
    lost = mask & ~known
    np.testing.assert_array_equal(filled[~lost], depth[~lost])
    places = np.argwhere(known)
    for v, u in np.argwhere(lost):
        distance = np.hypot(*(places - [v, u]).T)
        # OpenCV's distances on a 5 × 5 mask are rough by some percent.
        near = places[distance <= 1.1 * distance.min()]
        assert filled[v, u] in depth[near[:, 0], near[:, 1]]


@pytest.mark.parametrize("name", ["nominal", "low"])
def test_a_part_of_the_image_shows_the_same_points(name):
    camera = CAMERAS[name]
    depth, mask = see(camera, block([0.06, 0.03, 0.02], at(0.1, 0.05, 0.01)))
    surface = observe(depth, mask, camera, min_pixels=10)
    assert surface.depth.shape == surface.camera.shape < camera.shape
    points = camera.unproject(depth)[mask]
    np.testing.assert_allclose(surface.object_points, points, atol=1e-7)
    uvz = surface.camera.project(surface.object_points)
    v, u = np.nonzero(surface.mask)
    np.testing.assert_allclose(uvz[:, :2], np.stack([u, v], -1), atol=1e-4)


DEPTH, MASK = see(NOMINAL, block([0.06, 0.03, 0.02], at(0, 0, 0.01)))
FEW = np.zeros_like(MASK)
FEW[200, 200:203] = True


@pytest.mark.parametrize(
    ("depth", "mask", "found"),
    [
        (DEPTH, MASK, True),
        (DEPTH, np.zeros_like(MASK), False),
        (DEPTH, FEW, False),
        (np.full_like(DEPTH, np.nan), MASK, False),
        (np.zeros_like(DEPTH), MASK, False),
        (np.full_like(DEPTH, np.inf), MASK, False),
        (np.where(MASK, 0.0, DEPTH), MASK, False),
    ],
)
def test_too_little_to_see_is_nothing(depth, mask, found):
    surface = observe(depth, mask, NOMINAL, min_pixels=20)
    assert (surface is not None) == found


def test_images_of_another_shape_are_refused():
    with pytest.raises(ValueError, match="depth image"):
        observe(DEPTH[1:], MASK, NOMINAL, min_pixels=1)
    with pytest.raises(ValueError, match="mask"):
        observe(DEPTH, MASK[:, 1:], NOMINAL, min_pixels=1)


@pytest.mark.parametrize("name", ["nominal", "tilted"])
@pytest.mark.parametrize(("roll", "pitch"), [(0, 0), (0.4, 0), (0.2, -0.5)])
def test_normals_of_a_plate(name, roll, pitch):
    X = at(0.05, 0.03, 0.06, roll, pitch)
    surface = surface_of(CAMERAS[name], block([0.06, 0.05, 0.004], X))
    p = (surface.points_W - X[:3, 3]) @ X[:3, :3]
    top = surface.mask & (np.abs(p[..., 0]) < 0.025) & (p[..., 2] > 0.0019)
    top &= np.abs(p[..., 1]) < 0.020
    assert top.sum() > 0.4 * surface.mask.sum()
    angle = np.arccos(np.clip(surface.normals_W[top] @ X[:3, 2], -1, 1))
    assert np.rad2deg(angle).max() < 1.0


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
    inwards = np.tile(-X[:3, 2], (len(p), 1))
    np.testing.assert_allclose(points.approach, inwards, atol=0.03)
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
    surface = surface_of(NOMINAL, mesh)
    seal = seal_on_depth(surface, downwards(0, 0, top)[None], LIP)
    assert seal.closed[0] == seals
    assert (len(seals_seen(surface, LIP, count=200)[0]) > 0) == seals


def test_how_far_a_cup_is_from_a_plate():
    surface = surface_of(NOMINAL, block([0.07, 0.07, 0.01], at(0, 0, 0.005)))
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
        surface = surface_of(NOMINAL, mesh)
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
