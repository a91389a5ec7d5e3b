"""Silhouettes against ray casting and against each other."""

import numpy as np
import pytest
import trimesh

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.silhouette import (
    convex_mask,
    convex_spans,
    project_mesh_mask,
)
from xray_drake.scene.targets import target_model

SHAPE = (96, 128)


def overhead_camera() -> PinholeCamera:
    K = np.array([[138.0, 0, 63.5], [0, 138.0, 47.5], [0, 0, 1]])
    X_WC = np.diag([1.0, -1.0, -1.0, 1.0])
    X_WC[:3, 3] = [0.03, -0.02, 0.3]
    return PinholeCamera(128, 96, K, X_WC)


def cast_mask(
    mesh: trimesh.Trimesh, X_WO: np.ndarray, camera: PinholeCamera
) -> np.ndarray:
    moved = mesh.copy().apply_transform(X_WO)
    rays = camera.rays().reshape(-1, 3)
    origins = np.tile(camera.X_WC[:3, 3], (len(rays), 1))
    return moved.ray.intersects_any(origins, rays).reshape(camera.shape)


@pytest.mark.parametrize("name", ["box_2to1", "lid", "flute"])
def test_mesh_mask_matches_ray_casting(name: str) -> None:
    mesh = target_model(name).visual
    camera = overhead_camera()
    X_WO = trimesh.transformations.euler_matrix(0.2, -0.3, 0.7)
    X_WO[:3, 3] = [0.02, 0.01, 0.03]
    expected = cast_mask(mesh, X_WO, camera)
    mask = project_mesh_mask(mesh.vertices, mesh.faces, X_WO, camera)
    assert expected.sum() > 200
    np.testing.assert_array_equal(mask, expected)


def test_holes_show_the_background() -> None:
    ring = trimesh.creation.annulus(r_min=0.02, r_max=0.04, height=0.005)
    camera = overhead_camera()
    mask = project_mesh_mask(ring.vertices, ring.faces, np.eye(4), camera)
    u, v = np.rint(camera.project(np.zeros(3))[:2]).astype(int)
    assert not mask[v, u]
    u, v = np.rint(camera.project(np.array([0.03, 0, 0]))[:2]).astype(int)
    assert mask[v, u]


def test_mesh_out_of_the_image_leaves_it_blank() -> None:
    mesh = trimesh.creation.box([0.01, 0.01, 0.01])
    X_WO = trimesh.transformations.translation_matrix([5.0, 0, 0])
    camera = overhead_camera()
    assert not project_mesh_mask(mesh.vertices, mesh.faces, X_WO, camera).any()


def test_mesh_behind_the_camera_is_an_error() -> None:
    mesh = trimesh.creation.box([0.01, 0.01, 0.01])
    X_WO = trimesh.transformations.translation_matrix([0, 0, 1.0])
    with pytest.raises(ValueError, match="behind the camera"):
        project_mesh_mask(mesh.vertices, mesh.faces, X_WO, overhead_camera())


def random_polygons(count: int, corners: int) -> np.ndarray:
    rng = np.random.default_rng(3)
    angles = np.sort(rng.uniform(0, 2 * np.pi, (count, corners)), axis=1)
    points = np.stack([np.cos(angles), np.sin(angles)], axis=2)
    size = rng.uniform(3, 40, (count, 1, 2))
    return points * size + rng.uniform(-10, 130, (count, 1, 2))


def test_convex_mask_is_the_points_left_of_all_sides() -> None:
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    for polygon in random_polygons(20, 7):
        inside = np.ones(SHAPE, dtype=bool)
        for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
            side = (b[0] - a[0]) * (v - a[1]) - (b[1] - a[1]) * (u - a[0])
            inside &= side >= 0
        np.testing.assert_array_equal(convex_mask(polygon, SHAPE), inside)


@pytest.mark.parametrize("turned", [False, True])
def test_spans_match_single_masks(turned: bool) -> None:
    polygons = random_polygons(30, 9)
    # A rectangle with horizontal sides and a corner given twice.
    polygons[0] = [[3, 4], *[[20, 4]] * 3, *[[20, 9]] * 4, [3, 9]]
    masks = np.array([convex_mask(polygon, SHAPE) for polygon in polygons])
    image = np.random.default_rng(0).random(SHAPE) < 0.3
    spans = convex_spans(polygons[:, ::-1] if turned else polygons, SHAPE)
    np.testing.assert_array_equal(spans.areas(), masks.sum(axis=(1, 2)))
    np.testing.assert_array_equal(
        spans.sums(image), (masks & image).sum(axis=(1, 2))
    )
    chosen = np.arange(30) % 3 > 0
    np.testing.assert_array_equal(
        spans.total(chosen), masks[chosen].sum(axis=0)
    )
