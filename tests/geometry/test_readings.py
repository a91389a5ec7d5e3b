import numpy as np
import pytest

from tests.occupancy.scenes import CAMERAS
from xray_drake.geometry.readings import (
    depth_readings,
    has_reading,
    nearest_values,
)


def test_what_is_no_reading() -> None:
    depth = np.array([0.5, 0.0, -0.1, np.inf, np.nan], np.float32)
    assert has_reading(depth).tolist() == [True, False, False, False, False]


def test_each_pixel_takes_its_nearest() -> None:
    values = np.zeros((3, 6), np.float32)
    known = np.zeros((3, 6), bool)
    for place, value in {(1, 0): 0.3, (1, 5): 0.7}.items():
        values[place], known[place] = value, True
    filled, away = nearest_values(values, known)
    assert filled.dtype == np.float32
    np.testing.assert_array_equal(
        filled, np.float32([[0.3] * 3 + [0.7] * 3] * 3)
    )
    assert away[1].tolist() == [0, 1, 2, 2, 1, 0]


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_what_lies_far_under_the_floor_is_no_reading(camera) -> None:
    depth = camera.plane_depth(0.02).astype(np.float32)
    depth[3, :4] = 0.0, np.inf, np.nan, -1.0
    np.testing.assert_array_equal(depth_readings(depth, camera), depth)
    far = depth.copy()
    far[10, 10:13] = camera.plane_depth(-0.06)[10, 10:13]
    far[11, 10] = 40.0
    wanted = depth.copy()
    wanted[10, 10:13] = wanted[11, 10] = 0.0
    np.testing.assert_array_equal(depth_readings(far, camera), wanted)
    assert far[11, 10] == 40.0
    near = camera.plane_depth(-0.04)
    assert depth_readings(near, camera).dtype == np.float32
    np.testing.assert_allclose(depth_readings(near, camera), near, rtol=1e-6)


def test_an_image_without_readings_stays_so() -> None:
    camera = CAMERAS["nominal"]
    for nothing in (0.0, np.inf, np.nan):
        depth = np.full(camera.shape, nothing, np.float32)
        np.testing.assert_array_equal(depth_readings(depth, camera), depth)


@pytest.mark.parametrize(
    ("factor", "kind", "said"),
    [
        (1000, np.uint16, "is of uint16: .* millimetres"),
        (1000, np.int32, "is of int32"),
        (1, bool, "is of bool"),
        (1000, np.float32, "looks like millimetres; give metres"),
        (100, np.float64, "looks like centimetres"),
        (10000, np.float32, "looks like tenths of millimetres"),
        (7, np.float32, "are its depths metres, and is X_WC"),
    ],
)
def test_another_unit_is_named(factor: float, kind: type, said: str) -> None:
    camera = CAMERAS["nominal"]
    depth = (factor * camera.plane_depth(0.01)).astype(kind)
    depth[:50] = 0
    with pytest.raises(ValueError, match=said) as error:
        depth_readings(depth, camera)
    assert "\n" not in str(error.value)
