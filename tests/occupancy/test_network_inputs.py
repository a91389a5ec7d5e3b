from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.nominal import BIN
from tests.occupancy.scenes import make_camera
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.floor_grid import observed_heights
from xray_drake.occupancy.learned.inputs import (
    COARSE,
    FINE,
    geometry_input,
    size_features,
)

_COVER, _MODAL = range(len(FINE))
_HEIGHT, _READING, _FLOOR = range(len(COARSE))

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


def _noise(camera: PinholeCamera, seed: int = 0) -> np.ndarray:
    """Any depths near the floor's."""
    rng = np.random.default_rng(seed)
    return rng.uniform(0.5, 1.0, camera.shape).astype(np.float32)


def _blank(camera: PinholeCamera) -> np.ndarray:
    return np.zeros(camera.shape, bool)


@pytest.mark.parametrize("camera", _CAMERAS.values(), ids=_CAMERAS)
def test_heights_are_z_of_the_points_seen(camera: PinholeCamera) -> None:
    depth = _noise(camera)
    depth[::7] = camera.plane_depth(0.05)[::7]
    heights = observed_heights(depth, camera, 0.0)
    assert heights.dtype == np.float32
    seen = np.isfinite(depth)
    expected = camera.unproject(np.where(seen, depth, 0).astype(float))[..., 2]
    # Depths of many metres, near the horizon, have float32's precision.
    error = np.abs(heights - expected)[seen]
    assert (error < 1e-6 * np.maximum(1, depth[seen])).all()
    assert np.isneginf(heights[~seen]).all()


@pytest.mark.parametrize("camera", _CAMERAS.values(), ids=_CAMERAS)
def test_each_pixel_is_its_own_or_the_mean_of_sixteen(
    camera: PinholeCamera,
) -> None:
    rng = np.random.default_rng(3)
    z = rng.uniform(-0.05, 0.3, camera.shape)
    # Many near the top of the target.
    z[:, ::2] = rng.normal(0.013, 0.001, z[:, ::2].shape)
    ahead = np.isfinite(camera.plane_depth(0.0))
    slope = camera.rays()[..., 2]
    depth = np.where(ahead, (z - camera.X_WC[2, 3]) / slope, 0)
    depth[rng.random(camera.shape) < 0.2] = 0
    depth[(depth < 0) | (depth > 3)] = 0
    mask = rng.random(camera.shape) < 0.5
    fine, coarse = geometry_input(
        depth.astype(np.float32), mask, camera, 0.013, BIN.floor
    )
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
            cover = np.clip((z[v, u] - 0.011) / 0.004, 0, 1)
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
    floor = geometry_input(depth, mask, camera, 0.005, BIN.floor).coarse[_FLOOR]
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
    width=st.sampled_from([64, 128]),
    sides=st.permutations([0.06, 0.03]),
    seen=st.sampled_from([0, 1, 9, 3000]),
)
@settings(max_examples=50)
def test_what_a_network_is_told_of_a_target(
    camera: PinholeCamera, width: int, sides: list[float], seen: int
) -> None:
    """Its size in the image, whichever side is the longer, and what is seen."""
    camera = replace(camera, width=width)
    mask = _blank(camera)
    mask.flat[:seen] = True
    features = size_features(np.array([*sides, 0.005]), mask, camera)
    assert features.dtype == np.float32
    # Where the camera's axis meets the floor.
    distance = -camera.X_WC[2, 3] / camera.X_WC[2, 2]
    pixels = camera.intrinsics[0, 0] / distance * np.array([0.06, 0.03])
    # A target is typically 40 pixels of 512, and 1 cm, large.
    long, short = np.log(pixels / (40 * width / 512))
    share = min(1, seen / pixels.prod())
    np.testing.assert_allclose(
        features, [long, short, 0.5, seen == 0, share], rtol=1e-4, atol=1e-5
    )
