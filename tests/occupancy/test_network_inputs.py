import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.occupancy.scenes import make_camera
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.occupancy.learned.inputs import (
    COARSE,
    FINE,
    SIZE_FEATURES,
    geometry_input,
    heights_above_floor,
    size_features,
)

_COVER, _MODAL = range(len(FINE))
_HEIGHT, _READING, _FLOOR = range(len(COARSE))
_LONG, _SHORT, _THICKNESS, _HIDDEN, _VISIBLE = range(len(SIZE_FEATURES))

_BIN = (-0.25, 0.25, -0.20, 0.20)


def _camera(
    *, size: tuple[int, int] = (64, 48), **change: float
) -> PinholeCamera:
    """The nominal camera, or another one, with an image of this size."""
    width, height = size
    settings = {
        "focal_length": 552.5 * width / 512,
        "center": ((width - 1) / 2, (height - 1) / 2),
        **change,
    }
    return make_camera(size=size, **settings)  # type: ignore[arg-type]


_CAMERAS = {
    "nominal": _camera(),
    "tilted": _camera(tilt=10, azimuth=57),
    "rolled": _camera(roll=10, center=(30.1, 25.2)),
    "low": _camera(radius=0.7, tilt=6, azimuth=230, roll=-6, focal_length=70),
    "towards the horizon": _camera(tilt=75, azimuth=120, focal_length=30),
}

_any_camera = st.builds(
    _camera,
    radius=st.floats(0.7, 0.9),
    tilt=st.floats(0, 10),
    azimuth=st.floats(0, 360),
    roll=st.floats(-10, 10),
    focal_length=st.floats(60, 80),
)

_NOTHING = st.sampled_from([0.0, np.inf, np.nan])


def _noise(camera: PinholeCamera, seed: int = 0) -> np.ndarray:
    """Any depths near the floor's."""
    rng = np.random.default_rng(seed)
    return rng.uniform(0.5, 1.0, camera.shape).astype(np.float32)


def _blank(camera: PinholeCamera) -> np.ndarray:
    return np.zeros(camera.shape, bool)


@given(camera=_any_camera, seed=st.integers(0, 99))
@settings(deadline=None, max_examples=50)
def test_heights_are_z_of_the_points_seen(
    camera: PinholeCamera, seed: int
) -> None:
    depth = _noise(camera, seed)
    heights = heights_above_floor(depth, camera)
    assert heights.dtype == np.float32
    expected = camera.unproject(depth.astype(float))[..., 2]
    np.testing.assert_allclose(heights, expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize("camera", _CAMERAS.values(), ids=_CAMERAS)
@pytest.mark.parametrize("z", [0.0, 0.05])
def test_a_level_surface_has_one_height(
    camera: PinholeCamera, z: float
) -> None:
    depth = camera.plane_depth(z)
    heights = heights_above_floor(depth, camera)
    seen = np.isfinite(depth)
    assert seen.any()
    # Depths of many metres, near the horizon, have float32's precision.
    error = np.abs(heights - z)[seen]
    assert (error < 1e-6 * np.maximum(1, depth[seen])).all()
    assert np.isnan(heights[~seen]).all()


@given(
    camera=_any_camera,
    thickness=st.floats(0.003, 0.03),
    above=st.floats(0.0025, 0.05),
)
@settings(deadline=None, max_examples=50)
def test_only_what_is_higher_than_the_targets_top_covers_it(
    camera: PinholeCamera, thickness: float, above: float
) -> None:
    def cover(z: float) -> np.ndarray:
        depth = camera.plane_depth(z)
        images = geometry_input(depth, _blank(camera), camera, thickness)
        return images.fine[_COVER]

    assert (cover(thickness + above) == 1).all()
    assert (cover(thickness - above) == 0).all()
    np.testing.assert_allclose(cover(thickness), 0.5, atol=1e-3)
    assert (cover(thickness + 0.001) > 0.5).all()
    assert (cover(thickness - 0.001) < 0.5).all()


@pytest.mark.parametrize("camera", _CAMERAS.values(), ids=_CAMERAS)
def test_each_pixel_is_its_own_or_the_mean_of_sixteen(
    camera: PinholeCamera,
) -> None:
    rng = np.random.default_rng(3)
    z = rng.uniform(-0.05, 0.3, camera.shape)
    # Many near the top of the target.
    z[:, ::2] = rng.normal(0.01, 0.001, z[:, ::2].shape)
    ahead = np.isfinite(camera.plane_depth(0.0))
    slope = camera.rays()[..., 2]
    depth = np.where(ahead, (z - camera.X_WC[2, 3]) / slope, 0)
    depth[rng.random(camera.shape) < 0.2] = 0
    depth[(depth < 0) | (depth > 3)] = 0
    mask = rng.random(camera.shape) < 0.5
    fine, coarse = geometry_input(depth.astype(np.float32), mask, camera, 0.01)
    assert fine.shape == (2, 48, 64)
    assert coarse.shape == (3, 12, 16)
    assert fine.dtype == coarse.dtype == np.float32
    sums = np.zeros((2, 12, 16))
    for v in range(48):
        for u in range(64):
            assert fine[_MODAL, v, u] == mask[v, u]
            if depth[v, u] == 0:
                assert fine[_COVER, v, u] == 0
                continue
            cover = np.clip((z[v, u] - 0.008) / 0.004, 0, 1)
            assert fine[_COVER, v, u] == pytest.approx(cover, abs=2e-3)
            sums[_HEIGHT, v // 4, u // 4] += np.clip(
                (z[v, u] + 0.02) / 0.22, 0, 1
            )
            sums[_READING, v // 4, u // 4] += 1
    assert len(np.unique(sums[_READING])) > 5
    np.testing.assert_allclose(coarse[:2], sums / 16, rtol=0, atol=1e-4)


@pytest.mark.parametrize("camera", _CAMERAS.values(), ids=_CAMERAS)
def test_the_floor_is_where_rays_meet_it_within_the_bin(
    camera: PinholeCamera,
) -> None:
    depth, mask = _noise(camera), _blank(camera)
    floor = geometry_input(depth, mask, camera, 0.005).coarse[_FLOOR]
    R, C = camera.X_WC[:3, :3], camera.X_WC[:3, 3]
    expected = np.zeros((12, 16))
    for row in range(12):
        for column in range(16):
            # The middle of its sixteen pixels.
            pixel = np.array([4 * column + 1.5, 4 * row + 1.5, 1])
            ray = R @ np.linalg.solve(camera.intrinsics, pixel)
            if ray[2] < 0:
                x, y, _ = C - C[2] / ray[2] * ray
                expected[row, column] = (
                    _BIN[0] <= x <= _BIN[1] and _BIN[2] <= y <= _BIN[3]
                )
    assert 0 < expected.mean() < 1
    np.testing.assert_array_equal(floor, expected)


@given(
    camera=_any_camera,
    length=st.floats(0.01, 0.14),
    width=st.floats(0.007, 0.14),
    thickness=st.floats(0.003, 0.03),
    seen=st.floats(0, 1),
)
@settings(deadline=None, max_examples=50)
def test_length_and_width_may_be_swapped(
    camera: PinholeCamera,
    length: float,
    width: float,
    thickness: float,
    seen: float,
) -> None:
    mask = np.random.default_rng(0).random(camera.shape) < seen
    features = size_features(np.array([length, width, thickness]), mask, camera)
    assert features.shape == (len(SIZE_FEATURES),)
    assert features.dtype == np.float32
    assert features[_LONG] >= features[_SHORT]
    assert features[_THICKNESS] == pytest.approx(thickness / 0.01)
    np.testing.assert_array_equal(
        features,
        size_features(np.array([width, length, thickness]), mask, camera),
    )


@pytest.mark.parametrize("pixels", [0, 1, 9])
def test_hidden_is_said_of_blank_masks_alone(pixels: int) -> None:
    camera = _CAMERAS["nominal"]
    mask = _blank(camera)
    mask.flat[100 : 100 + pixels] = True
    features = size_features(np.array([0.06, 0.03, 0.005]), mask, camera)
    assert features[_HIDDEN] == (pixels == 0)
    # 60 mm × 30 mm at 0.8 m and 69 pixels.
    area = 0.06 * 0.03 * (69.0625 / 0.8) ** 2
    assert features[_VISIBLE] == pytest.approx(pixels / area)


def test_features_of_a_known_box() -> None:
    camera = make_camera()
    mask = np.ones(camera.shape, bool)
    features = size_features(np.array([0.06, 0.03, 0.005]), mask, camera)
    long, short = 552.5 / 0.8 * 0.06, 552.5 / 0.8 * 0.03
    np.testing.assert_allclose(
        features,
        [np.log(long / 40), np.log(short / 40), 0.5, 0, 1],
        atol=1e-6,
    )


@given(camera=_any_camera, factor=st.floats(0.5, 2), seen=st.integers(0, 3))
@settings(deadline=None, max_examples=50)
def test_lengths_scale_with_focal_length_and_distance(
    camera: PinholeCamera, factor: float, seen: int
) -> None:
    size = np.array([0.08, 0.03, 0.01])
    mask = _blank(camera)
    mask[0, :seen] = True
    longer = camera.intrinsics.copy()
    longer[[0, 1], [0, 1]] *= factor
    farther = camera.X_WC.copy()
    farther[:3, 3] *= factor
    before = size_features(size, mask, camera)
    for other, sign in (
        (dataclasses.replace(camera, intrinsics=longer), 1),
        (dataclasses.replace(camera, X_WC=farther), -1),
    ):
        after = size_features(size, mask, other)
        change = sign * np.log(factor)
        np.testing.assert_allclose(
            after[:2], before[:2] + change, rtol=0, atol=1e-5
        )
        assert after[_THICKNESS] == before[_THICKNESS]
        assert after[_VISIBLE] == pytest.approx(
            min(1, before[_VISIBLE] * np.exp(-2 * change)), rel=1e-4
        )


@given(camera=_any_camera)
@settings(deadline=None, max_examples=25)
def test_the_distance_is_that_of_the_floor_along_the_axis(
    camera: PinholeCamera,
) -> None:
    side = 40 / 8  # of 64 pixels
    axis = camera.X_WC[:3, 2]
    distance = -camera.X_WC[2, 3] / axis[2]
    size = side * distance / camera.intrinsics[0, 0]
    features = size_features(
        np.array([size, size, 0.01]), _blank(camera), camera
    )
    np.testing.assert_allclose(features[:2], 0, atol=1e-5)


def test_features_do_not_depend_on_the_resolution() -> None:
    large, small = (
        _camera(size=size, tilt=5, azimuth=30)
        for size in ((512, 384), (128, 96))
    )
    size = np.array([0.05, 0.02, 0.01])
    seen = np.zeros(small.shape, bool)
    seen[40:44, 50:60] = True
    np.testing.assert_allclose(
        size_features(size, np.kron(seen, np.ones((4, 4), bool)), large),
        size_features(size, seen, small),
        atol=1e-5,
    )
