import numpy as np

from xray_drake.geometry.readings import has_reading, nearest_values


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
