import cv2
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.silhouette import convex_mask, project_mesh_mask
from xray_drake.scene.targets import target_model


def overhead_camera() -> PinholeCamera:
    K = np.array([[200.0, 0, 47.5], [0, 200.0, 35.5], [0, 0, 1]])
    X_WC = np.diag([1.0, -1.0, -1.0, 1.0])
    X_WC[2, 3] = 0.5
    return PinholeCamera(96, 72, K, X_WC)


def posed(x: float, y: float, z: float, seed: int) -> np.ndarray:
    X_WO = trimesh.transformations.random_rotation_matrix(
        np.random.default_rng(seed).random(3)
    )
    X_WO[:3, 3] = x, y, z
    return X_WO


def ray_cast(mesh: trimesh.Trimesh, X_WO: np.ndarray) -> np.ndarray:
    camera = overhead_camera()
    rays = camera.rays().reshape(-1, 3)
    centre = np.broadcast_to(camera.X_WC[:3, 3], rays.shape)
    placed = mesh.copy().apply_transform(X_WO)
    return placed.ray.intersects_any(centre, rays).reshape(camera.shape)


@pytest.mark.parametrize("name", ["box_5to1", "lid", "flute"])
@pytest.mark.parametrize("seed", range(3))
def test_the_silhouette_is_what_rays_hit(name: str, seed: int) -> None:
    mesh = target_model(name).visual
    X_WO = posed(0.01, -0.02, 0.05, seed)
    mask = project_mesh_mask(
        mesh.vertices, mesh.faces, X_WO, overhead_camera()
    )
    hit = ray_cast(mesh, X_WO)
    inner = cv2.erode(hit.astype(np.uint8), np.ones((3, 3), np.uint8))
    outline = np.count_nonzero(hit) - np.count_nonzero(inner)
    assert outline > 40
    # It may be a tenth of a pixel too wide all along the outline.
    assert np.count_nonzero(mask != hit) <= 0.2 * outline


def test_what_leaves_the_image_is_cut_off() -> None:
    mesh = target_model("lid").visual
    args = mesh.vertices, mesh.faces
    camera = overhead_camera()
    whole = project_mesh_mask(*args, posed(0.0, 0.0, 0.0, 1), camera)
    partly = project_mesh_mask(*args, posed(0.12, 0.0, 0.0, 1), camera)
    gone = project_mesh_mask(*args, posed(0.5, 0.3, 0.0, 1), camera)
    assert 0 < partly.sum() < whole.sum()
    assert partly[:, -1].any()
    assert not gone.any()


def test_a_mesh_that_reaches_behind_the_camera() -> None:
    mesh = target_model("lid").visual
    with pytest.raises(ValueError, match="behind the camera"):
        project_mesh_mask(
            mesh.vertices,
            mesh.faces,
            posed(0.0, 0.0, 0.5, 0),
            overhead_camera(),
        )


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(3, 7))
def test_a_convex_polygon_holds_the_centres_inside_it(
    seed: int, corners: int
) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-4, 24, (corners, 2))
    polygon = points[ConvexHull(points).vertices]
    mask = convex_mask(polygon, (16, 20))
    following = np.roll(polygon, -1, axis=0)
    edges = following - polygon
    v, u = np.indices((16, 20))
    sides = np.stack(
        [
            e[0] * (v - a[1]) - e[1] * (u - a[0])
            for a, e in zip(polygon, edges, strict=True)
        ]
    )
    inside = (sides > 1e-9).all(axis=0)
    on_edge = (np.abs(sides) <= 1e-9).any(axis=0)
    np.testing.assert_array_equal(mask | on_edge, inside | on_edge)
