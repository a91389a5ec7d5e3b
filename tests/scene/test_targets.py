import numpy as np
import pytest
import trimesh

from xray_drake.scene.targets import (
    TALL_TARGETS,
    TARGET_NAMES,
    size_in_any_pose,
    target_model,
)

SIZES = {
    f"box_{ratio}to1": (0.03 * ratio**0.5, 0.03 / ratio**0.5, 0.005)
    for ratio in range(1, 11)
} | {
    "lid": (0.060, 0.057, 0.010),
    "domino": (0.048, 0.024, 0.0075),
    "flute": (0.110, 0.022, 0.016),
}
"""m. All boxes have nine square centimetres."""


@pytest.mark.parametrize("name", TARGET_NAMES)
def test_every_target(name):
    model = target_model(name)
    assert model.name == name
    np.testing.assert_allclose(model.extents, SIZES[name], atol=1e-9)
    assert model.visual.is_volume
    assert model.visual.body_count == 1
    # The body origin is the centre of the bounding box.
    np.testing.assert_allclose(model.visual.bounds.sum(axis=0), 0, atol=1e-9)
    assert model.mass == pytest.approx(600 * model.visual.volume)
    assert model.friction == 0.5
    assert model.color[:3] == (0.8, 0.05, 0.05)
    assert np.linalg.eigvalsh(model.inertia).min() > 0
    # What collides fills the bounding box.
    assert len(model.pieces) <= (9 if name == "lid" else 1)
    corners = np.concatenate(model.pieces)
    bounds = [corners.min(axis=0), corners.max(axis=0)]
    np.testing.assert_allclose(bounds, model.visual.bounds, atol=1e-9)
    for piece in model.pieces:
        hull = trimesh.Trimesh(piece).convex_hull
        assert len(hull.vertices) == len(piece) <= 16


def test_lid_is_hollow_above_a_plate_and_inside_a_rim():
    lid = target_model("lid")
    pieces = [trimesh.Trimesh(p).convex_hull for p in lid.pieces]
    union = trimesh.boolean.union(pieces, engine="manifold")
    assert union.volume == pytest.approx(lid.visual.volume, rel=0.02)
    assert lid.p_OCom[2] < -0.001
    # In the plate, above it, and in the rim.
    points = [[0.01, 0.01, -0.0035], [0.01, 0.01, 0.0], [0.0285, 0.0, 0.0]]
    for mesh in (lid.visual, union):
        assert mesh.contains(points).tolist() == [True, False, True]


def test_flute_is_a_tube_with_six_finger_holes():
    flute = target_model("flute").visual
    # Seven handles: each of the six holes and the bore's second end are one.
    assert 2 - flute.euler_number == 2 * 7
    top = 0.008 - 0.001
    x = np.linspace(-0.054, 0.054, 200)
    wall = flute.contains(np.column_stack([x, 0 * x, np.full_like(x, top)]))
    assert np.count_nonzero(np.diff(wall.astype(int)) == -1) == 6
    assert not flute.contains([[0.0, 0.0, 0.0]])[0]


def test_unknown_target_names_those_there_are():
    with pytest.raises(ValueError, match="spoon") as caught:
        target_model("spoon")
    message = str(caught.value)
    assert "\n" not in message
    assert all(name in message for name in TARGET_NAMES)
    assert len(set(TARGET_NAMES)) == 13


def test_the_mug_is_hollow_and_has_a_handle():
    mug = target_model("mug").visual
    # One handle: the hole between bar and wall.
    assert 2 - mug.euler_number == 2
    assert mug.is_watertight
    np.testing.assert_allclose(mug.extents, [0.097, 0.07, 0.08], atol=1e-3)
    np.testing.assert_allclose(mug.bounds.sum(axis=0), 0, atol=1e-3)
    x = -(mug.extents[0] - 0.07) / 2
    # In the opening, the floor and the wall; beside the wall, in the bar.
    points = [(0, 0.03), (0, -0.0385), (0.033, 0), (0.044, 0), (0.058, 0)]
    inside = mug.contains([[x + away, 0, z] for away, z in points])
    assert inside.tolist() == [False, True, True, False, True]


@pytest.mark.parametrize("name", TALL_TARGETS)
def test_tall_targets_collide_as_they_look(name):
    model = target_model(name)
    extents = np.ptp(np.concatenate(model.pieces), axis=0)
    np.testing.assert_allclose(extents, model.extents, rtol=0.05)


def test_size_in_any_pose():
    flat = target_model("box_2to1")
    np.testing.assert_array_equal(size_in_any_pose(flat), flat.extents)
    cube = target_model("cube")
    length, width, thickness = size_in_any_pose(cube)
    assert np.hypot(length, width) == pytest.approx(0.06 * 3**0.5)
    assert length * width == pytest.approx(0.06**2)
    assert thickness < 0.005
    for name in TALL_TARGETS:
        assert np.isfinite(size_in_any_pose(target_model(name))).all()
