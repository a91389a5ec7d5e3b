import copy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from xray_drake.geometry.camera import PinholeCamera

OVERHEAD = np.diag([1.0, -1.0, -1.0, 1.0])
"""Straight down, image x along world x."""


@st.composite
def cameras(draw: st.DrawFn) -> PinholeCamera:
    """Cameras that look down, more or less, with pixels of any shape."""
    width, height = draw(st.integers(2, 24)), draw(st.integers(2, 24))
    K = np.eye(3)
    K[0, 0] = draw(st.floats(20, 60))
    K[1, 1] = draw(st.floats(20, 60))
    K[0, 2] = draw(st.floats(0, width - 1))
    K[1, 2] = draw(st.floats(0, height - 1))
    angle = st.floats(-np.pi, np.pi)
    turn = Rotation.from_euler(
        "zxz", [draw(angle), draw(st.floats(0, 0.4)), draw(angle)]
    )
    X_WC = np.eye(4)
    X_WC[:3, :3] = turn.as_matrix() @ OVERHEAD[:3, :3]
    X_WC[:2, 3] = draw(st.floats(-0.3, 0.3)), draw(st.floats(-0.3, 0.3))
    X_WC[2, 3] = draw(st.floats(0.5, 1.0))
    return PinholeCamera(width, height, K, X_WC)


def pixels(camera: PinholeCamera) -> np.ndarray:
    """Returns (H, W, 2): u and v of each pixel."""
    v, u = np.indices(camera.shape)
    return np.stack([u, v], axis=-1)


def test_overhead_camera_projects_as_by_hand() -> None:
    K = np.array([[50.0, 0, 3.5], [0, 40.0, 2.5], [0, 0, 1]])
    X_WC = OVERHEAD.copy()
    X_WC[:3, 3] = 0.1, -0.2, 0.8
    camera = PinholeCamera(8, 6, K, X_WC)
    points = [[0.1, -0.2, 0.0], [0.1 + 0.08, -0.2 + 0.04, 0.4]]
    np.testing.assert_allclose(
        camera.project(points),
        [[3.5, 2.5, 0.8], [3.5 + 50 * 0.2, 2.5 - 40 * 0.1, 0.4]],
    )
    assert camera.shape == (6, 8)
    assert camera.rays().shape == (6, 8, 3)
    assert np.isinf(camera.plane_depth(0.9)).all()  # behind it


@settings(deadline=None, max_examples=60)
@given(cameras(), st.integers(0, 2**32 - 1))
def test_projecting_undoes_unprojecting(
    camera: PinholeCamera, seed: int
) -> None:
    depth = np.random.default_rng(seed).uniform(0.3, 2.0, camera.shape)
    uvz = camera.project(camera.unproject(depth))
    np.testing.assert_allclose(uvz[..., :2], pixels(camera), atol=1e-9)
    np.testing.assert_allclose(uvz[..., 2], depth, rtol=1e-12)


def test_a_zoomed_camera_sees_points_nearer_to_the_middle() -> None:
    camera = PinholeCamera(
        96, 64, np.array([[105.0, 0, 47], [0, 110, 35], [0, 0, 1]]), np.eye(4)
    )
    points = np.array([[0.1, -0.05, 0.8], [-0.2, 0.1, 1.1], [0, 0, 0.5]])
    before, after = camera.project(points), camera.zoomed(0.4).project(points)
    middle = np.array([47.5, 31.5])
    np.testing.assert_allclose(
        after[:, :2] - middle, 0.4 * (before[:, :2] - middle), atol=1e-12
    )
    np.testing.assert_array_equal(after[:, 2], before[:, 2])
    assert camera.zoomed(0.4).shape == camera.shape


@settings(deadline=None, max_examples=60)
@given(cameras())
def test_rays_have_unit_depth(camera: PinholeCamera) -> None:
    d_C = camera.rays() @ camera.X_WC[:3, :3]
    np.testing.assert_allclose(d_C[..., 2], 1.0, rtol=1e-12)
    homogeneous = d_C @ camera.intrinsics.T
    np.testing.assert_allclose(homogeneous[..., :2], pixels(camera), atol=1e-9)


@settings(deadline=None, max_examples=60)
@given(cameras(), st.floats(-0.1, 0.3))
def test_plane_depth_reaches_the_plane(
    camera: PinholeCamera, height: float
) -> None:
    depth = camera.plane_depth(height)
    # 60° of view and 0.4 rad of tilt: no ray is level.
    seen = camera.rays()[..., 2] < 0
    assert (np.isfinite(depth) == seen).all()
    p_W = camera.unproject(depth)[seen]
    np.testing.assert_allclose(p_W[:, 2], height, atol=1e-9)


def test_what_never_meets_the_plane_is_infinitely_far() -> None:
    level = np.eye(4)
    level[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]  # forward is world y
    level[2, 3] = 0.8
    K = np.array([[50.0, 0, 3.5], [0, 40.0, 2.0], [0, 0, 1]])
    depth = PinholeCamera(8, 6, K, level).plane_depth(0.0)
    assert np.isinf(depth[:3]).all()  # the sky, and the horizon in row 2
    np.testing.assert_allclose(depth[3:, 0], 0.8 * 40 / np.array([1, 2, 3]))


@settings(deadline=None, max_examples=60)
@given(cameras(), st.floats(-0.1, 0.3), st.integers(0, 2**32 - 1))
def test_homography_is_the_projection_of_a_plane(
    camera: PinholeCamera, height: float, seed: int
) -> None:
    xy = np.random.default_rng(seed).uniform(-0.2, 0.2, (20, 2))
    p_W = np.column_stack([xy, np.full(20, height)])
    mapped = (
        np.column_stack([xy, np.ones(20)]) @ camera.plane_homography(height).T
    )
    expected = camera.project(p_W)
    np.testing.assert_allclose(mapped[:, 2], expected[:, 2], rtol=1e-9)
    np.testing.assert_allclose(
        mapped[:, :2] / mapped[:, 2:], expected[:, :2], atol=1e-7
    )


def test_a_camera_cannot_be_changed_and_is_its_own_copy() -> None:
    K, X_WC = np.eye(3), np.eye(4)
    camera = PinholeCamera(4, 3, K, X_WC)
    K[0, 0] = X_WC[0, 3] = 7.0
    assert camera.intrinsics[0, 0] == 1.0
    assert camera.X_WC[0, 3] == 0.0
    for array in (camera.intrinsics, camera.X_WC):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 2.0
    assert copy.deepcopy(camera) is camera


@pytest.mark.parametrize(
    ("K", "X_WC"), [(np.eye(4), np.eye(4)), (np.eye(3), np.eye(3))]
)
def test_matrices_of_another_shape(K: np.ndarray, X_WC: np.ndarray) -> None:
    with pytest.raises(ValueError, match="3×3 matrix and a 4×4 pose"):
        PinholeCamera(4, 3, K, X_WC)
