import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from xray_drake.drawing.colors import heat
from xray_drake.drawing.layers import color_layer, mask_outline, surface_depth
from xray_drake.geometry.camera import PinholeCamera


def camera_over_bin(
    width: int = 24, height: int = 18, *, tilt: float = 0.0
) -> PinholeCamera:
    """Returns a camera 0.8 m up; tilted by ``tilt`` radians."""
    X_WC = np.eye(4)
    X_WC[:3, :3] = Rotation.from_euler("xz", [np.pi - tilt, 0.3]).as_matrix()
    X_WC[:3, 3] = [0.02, -0.03, 0.8]
    K = np.array([[40.0, 0, 11.0], [0, 44.0, 8.5], [0, 0, 1]])
    return PinholeCamera(width, height, K, X_WC)


CAMERAS = [camera_over_bin(), camera_over_bin(tilt=0.35)]


def random_heap(camera: PinholeCamera, seed: int) -> np.ndarray:
    """Returns the depth of the floor with boxes and pits, pixels missing."""
    rng = np.random.default_rng(seed)
    depth = camera.plane_depth(0.0)
    for _ in range(4):
        u, v = rng.integers(camera.width), rng.integers(camera.height)
        w, h = rng.integers(2, 9, 2)
        depth[v : v + h, u : u + w] -= rng.uniform(-0.1, 0.2)
    for none in (0.0, np.inf, np.nan):
        v = rng.integers(camera.height, size=9)
        depth[v, rng.integers(camera.width, size=9)] = none
    return depth.astype(np.float32)


@pytest.mark.parametrize("camera", CAMERAS, ids=["straight", "tilted"])
@pytest.mark.parametrize("reach", [0, 1, 3])
def test_surface_depth_is_the_nearest_reading_within_reach(
    camera: PinholeCamera, reach: int
) -> None:
    floor = camera.plane_depth(0.0)
    for seed in range(3):
        depth = random_heap(camera, seed)
        result = surface_depth(depth, camera, reach=reach)
        assert result.shape == camera.shape
        gap = np.full(camera.shape, np.nan)
        for v, u in np.ndindex(camera.shape):
            near = np.s_[
                max(v - reach, 0) : v + reach + 1,
                max(u - reach, 0) : u + reach + 1,
            ]
            read = depth[near]
            read = read[np.isfinite(read) & (read > 0)].min(initial=np.inf)
            gap[v, u] = min(read, floor[near].min()) - result[v, u]
        # In front of the surface everywhere, by the same few millimetres.
        assert gap.min() > 0.001
        assert gap.max() < 0.010
        np.testing.assert_allclose(gap, gap[0, 0], atol=1e-6)


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    step=st.sampled_from([1, 2, 3, 5]),
    share=st.sampled_from([0.0, 0.5, 0.9, 1.0]),
    camera=st.sampled_from(CAMERAS),
)
def test_a_layer_has_two_triangles_on_each_tile_with_colors(
    seed: int, step: int, share: float, camera: PinholeCamera
) -> None:
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.5, 0.8, camera.shape)
    values = rng.uniform(0.1, 1.0, camera.shape)
    values[rng.uniform(size=camera.shape) > share] = 0.0
    picture = np.where(values[..., None] > 0, heat(values), np.nan)
    vertices, faces, colors = color_layer(picture, depth, camera, step=step)

    # Every vertex is a pixel's point on the surface, in its value's colour.
    projected = camera.project(vertices.T)
    pixels = np.rint(projected[:, :2]).astype(int)
    np.testing.assert_allclose(projected[:, :2], pixels, atol=1e-6)
    u, v = pixels.T
    np.testing.assert_allclose(projected[:, 2], depth[v, u])
    np.testing.assert_allclose(colors.T, heat(values[v, u]))
    assert (values[v, u] > 0).all()
    assert len(np.unique(pixels, axis=0)) == len(pixels)

    # Tile by tile: its four corners are above 0, or nothing is drawn.
    points = camera.unproject(depth)
    count = 0
    expected = set()
    for j in range(0, camera.height - step, step):
        for i in range(0, camera.width - step, step):
            corners = np.s_[j : j + step + 1 : step, i : i + step + 1 : step]
            if (values[corners] > 0).all():
                count += 1
                four = points[corners].reshape(4, 3).round(9)
                expected |= set(map(tuple, four))
    assert faces.shape == (3, 2 * count)
    assert colors.shape == vertices.shape == (3, len(expected))
    assert {tuple(p) for p in vertices.T.round(9)} == expected

    # Together the triangles cover each tile once, and face the camera.
    if count:
        corners_C = projected[:, :2][faces.T]
        a = corners_C[:, 1] - corners_C[:, 0]
        b = corners_C[:, 2] - corners_C[:, 0]
        areas = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
        np.testing.assert_allclose(areas, -(step**2) / 2, rtol=1e-6)
        centers = corners_C.mean(axis=1)
        tiles, tile, sizes = np.unique(
            np.floor(centers / step),
            axis=0,
            return_inverse=True,
            return_counts=True,
        )
        assert (len(tiles), set(sizes)) == (count, {2})
        middles = np.zeros((count, 2))
        np.add.at(middles, tile.reshape(-1), centers / 2)
        np.testing.assert_allclose(middles, (tiles + 0.5) * step, atol=1e-6)


def blobs(seed: int, shape: tuple[int, int]) -> np.ndarray:
    """Returns a few blobs, some with holes."""
    noise = np.random.default_rng(seed).random(shape)
    return cv2.blur(noise, (5, 5)) > 0.5


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    camera=st.sampled_from(CAMERAS),
    width=st.integers(1, 2),
)
def test_the_outline_is_a_band_around_the_mask(
    seed: int, camera: PinholeCamera, width: int
) -> None:
    mask = blobs(seed, camera.shape)
    depth = np.random.default_rng(seed).uniform(0.5, 0.8, camera.shape)
    vertices, faces = mask_outline(mask, depth, camera, width=width)
    projected = camera.project(vertices.T)
    pixels = np.rint(projected[:, :2]).astype(int)
    np.testing.assert_allclose(projected[:, :2], pixels, atol=1e-6)
    u, v = pixels.T
    np.testing.assert_allclose(projected[:, 2], depth[v, u])

    # Within so many pixels of the mask's edge, on either side ...
    ring = np.zeros(camera.shape, bool)
    for j, i in np.ndindex(camera.shape):
        near = mask[
            max(j - width, 0) : j + width + 1, max(i - width, 0) : i + width + 1
        ]
        ring[j, i] = near.any() and not near.all()
    assert ring[v, u].all()
    # ... and where four neighbours are, all of it.
    band = np.zeros(camera.shape, np.uint8)
    band[v, u] = 1
    tile = ring[:-1, :-1] & ring[1:, :-1] & ring[:-1, 1:] & ring[1:, 1:]
    expected = np.zeros(camera.shape, bool)
    for j, i in np.argwhere(tile):
        expected[j : j + 2, i : i + 2] = True
    np.testing.assert_array_equal(band > 0, expected)
    assert faces.shape[0] == 3
    assert set(faces.ravel()) == set(range(vertices.shape[1]))


def test_masks_lie_on_their_own_objects() -> None:
    camera = camera_over_bin()
    labels = np.full(camera.shape, -1)
    labels[4:12, 4:12] = 0
    labels[4:12, 12:20] = 1
    labels[14:18, 4:12] = 2
    depth = np.where(labels == 1, 0.7, 0.8)
    colors = np.array([[1.0, 0, 0], [0, 1.0, 0], [np.nan] * 3, [np.nan] * 3])
    surface = surface_depth(depth, camera, reach=0, gap=0.0015)
    vertices, faces, painted = color_layer(
        colors[labels], surface, camera, step=1, labels=labels
    )
    u, v, z = camera.project(vertices.T).T
    # Each vertex has the colour and the depth of its own pixel.
    at = labels[np.rint(v).astype(int), np.rint(u).astype(int)]
    assert set(at) == {0, 1}, "what has no colour is not drawn"
    np.testing.assert_array_equal(painted.T, colors[at])
    np.testing.assert_allclose(z, np.where(at == 1, 0.6985, 0.7985))
    # No triangle reaches from one mask to the other.
    assert (at[faces] == at[faces[0]]).all()
    assert faces.shape[1] == 2 * 2 * 7 * 7
