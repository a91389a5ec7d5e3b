"""How bodies rest, and how often."""

import numpy as np
import pytest
import trimesh
from trimesh.creation import cylinder

from xray_drake.geometry.resting import (
    lean,
    resting_poses,
    standing,
    turns_into_itself,
)
from xray_drake.geometry.silhouette import height_map


def box(*size: float) -> trimesh.Trimesh:
    return trimesh.creation.box(size)


def mug() -> trimesh.Trimesh:
    outer = cylinder(0.035, 0.08, sections=24)
    handle = box(0.03, 0.01, 0.05)
    handle.apply_translation([0.045, 0, 0])
    inner = cylinder(0.031, 0.08, sections=24)
    inner.apply_translation([0, 0, 0.005])
    whole = trimesh.boolean.union([outer, handle], engine="manifold")
    return trimesh.boolean.difference([whole, inner], engine="manifold")


@pytest.mark.parametrize(
    ("mesh", "heights", "ways"),
    [
        (box(0.06, 0.04, 0.02), [0.02, 0.04, 0.06], [2, 2, 2]),
        (box(0.06, 0.06, 0.06), [0.06], [6]),
        (box(0.1, 0.08, 0.002), [0.002], [2]),
        (cylinder(0.02, 0.06, sections=32), [0.04, 0.06], [32, 2]),
    ],
    ids=["box", "cube", "thin plate", "cylinder"],
)
def test_distinct_poses_the_most_frequent_first(
    mesh: trimesh.Trimesh, heights: list[float], ways: list[int]
) -> None:
    poses = resting_poses(mesh)
    found = [standing(mesh.vertices, p.R_WO)[:, 2].max() for p in poses]
    assert found == pytest.approx(heights, abs=3e-4)
    assert [len(pose.downs) for pose in poses] == ways
    shares = [pose.probability for pose in poses]
    assert sum(shares) == pytest.approx(1.0)
    assert shares == sorted(shares, reverse=True)
    # A flat body lies mostly flat.
    assert shares[0] > 0.6


def test_shares_are_the_solid_angles_of_the_faces() -> None:
    """Of a box, seen from the middle; in the order of ``heights`` above."""
    a, b, c = 0.03, 0.02, 0.01
    for pose, (p, q, r) in zip(
        resting_poses(box(2 * a, 2 * b, 2 * c)),
        [(a, b, c), (a, c, b), (b, c, a)],
        strict=True,
    ):
        root = np.sqrt((p**2 + r**2) * (q**2 + r**2))
        angle = 4 * np.arcsin(p * q / root)
        assert pose.probability == pytest.approx(2 * angle / (4 * np.pi))


def test_a_mug_stands_on_either_end_and_lies_in_several_ways() -> None:
    mesh = mug()
    upright = [
        np.sign(pose.downs[0, 2])
        for pose in resting_poses(mesh)
        if abs(pose.downs[0, 2]) > 0.99
    ]
    # It looks another from above, with its opening down.
    assert sorted(upright) == [-1, 1]
    assert len(resting_poses(mesh)) > 4


def test_the_share_below_which_poses_are_dropped() -> None:
    mesh = box(0.06, 0.04, 0.02)
    flat, edge = resting_poses(mesh, least_share=0.2)
    assert flat.probability + edge.probability == pytest.approx(1)
    (only,) = resting_poses(mesh, least_share=0.99)
    assert only.probability == 1


def test_a_weight_in_a_corner_changes_how_often() -> None:
    mesh = box(0.06, 0.06, 0.06)
    poses = resting_poses(mesh, np.array([0, 0, -0.025]))
    # They all look the same; the heavy face is down more often.
    assert len(poses) == 1
    prism = box(0.04, 0.04, 0.08)
    even = resting_poses(prism)[0].probability
    heavy = resting_poses(prism, np.array([0, 0, -0.035]))
    upright = [p for p in heavy if abs(p.R_WO[2, 2]) > 0.9]
    assert upright[0].probability > 1 - even


def test_a_body_stands_on_the_floor() -> None:
    mesh = mug()
    for pose in resting_poses(mesh):
        vertices = standing(mesh.vertices, pose.R_WO)
        assert vertices[:, 2].min() == 0
        # On a face: at least three corners touch.
        assert np.count_nonzero(vertices[:, 2] < 1e-6) >= 3
        assert np.linalg.det(pose.R_WO) == pytest.approx(1)


def test_lean_from_the_nearest_pose() -> None:
    mesh = box(0.06, 0.04, 0.02)
    poses = resting_poses(mesh)
    X = np.eye(4)
    assert lean(poses, X) == pytest.approx(0, abs=1e-6)
    for axis in ([1, 0, 0], [0, 1, 0]):
        for turn in (np.pi / 2, -np.pi / 2, np.pi):
            X = trimesh.transformations.rotation_matrix(turn + 0.2, axis)
            assert lean(poses, X) == pytest.approx(0.2, abs=1e-6)


def test_a_body_without_volume_is_refused() -> None:
    flat = trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 1e-30]],
        [[0, 1, 2], [1, 3, 2], [0, 2, 1], [1, 2, 3]],
        process=False,
    )
    with pytest.raises(ValueError, match="without volume"):
        resting_poses(flat, np.zeros(3))


@pytest.mark.parametrize(
    ("mesh", "order"),
    [
        (box(0.06, 0.06, 0.06), 4),
        (box(0.06, 0.04, 0.06), 2),
        (mug(), 1),
    ],
)
def test_turns_into_itself(mesh: trimesh.Trimesh, order: int) -> None:
    vertices = standing(mesh.vertices, np.eye(3))
    assert turns_into_itself(vertices, mesh.faces) == order


def test_height_map_agrees_with_rays() -> None:
    mesh = mug()
    vertices = standing(mesh.vertices, np.eye(3))
    drawn = height_map(vertices, mesh.faces, 0.001, 70)
    placed = trimesh.Trimesh(vertices, mesh.faces, process=False)
    rng = np.random.default_rng(0)
    cells = rng.integers(0, 141, (400, 2))
    origins = np.column_stack(
        [
            (cells[:, 1] - 70) * 0.001,
            (70 - cells[:, 0]) * 0.001,
            np.full(400, 1.0),
        ]
    )
    hits, rays, _ = placed.ray.intersects_location(
        origins, np.tile([0, 0, -1.0], (400, 1)), multiple_hits=False
    )
    expected = np.zeros(400)
    expected[rays] = hits[:, 2]
    differ = np.abs(drawn[cells[:, 0], cells[:, 1]] - expected) > 1e-6
    # Rays along an edge may pass on either side.
    assert np.count_nonzero(differ) <= 4
