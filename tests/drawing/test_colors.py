import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from xray_drake.drawing.colors import (
    depth_picture,
    heat,
    instance_colors,
    instance_picture,
    overlay,
)


@pytest.mark.parametrize("shape", [(), (0,), (2, 3, 4)])
def test_heat_is_a_map_of_rgb_whose_colors_tell_values_apart(
    shape: tuple[int, ...],
) -> None:
    assert heat(np.full(shape, 0.5)).shape == (*shape, 3)
    colors = heat(np.linspace(0, 1, 256))
    assert 0 <= colors.min() < colors.max() <= 1
    low, high = colors[10], colors[-1]
    # Cold is bluish, hot is reddish: swapped channels turn this round.
    assert low[2] > low[0]
    assert high[0] > high[2]
    assert len(np.unique(colors, axis=0)) > 200
    np.testing.assert_array_equal(heat(np.array([-1.0, 2.0])), colors[[0, -1]])


@settings(max_examples=30, deadline=None)
@given(
    image=npst.arrays(np.uint8, (4, 5, 3)),
    values=npst.arrays(
        np.float32, (4, 5), elements=st.sampled_from([0.0, 1e-6, 0.4, 1.0])
    ),
    strength=st.floats(0.0, 1.0),
)
def test_overlay_blends_where_values_are_above_zero_and_nowhere_else(
    image: np.ndarray, values: np.ndarray, strength: float
) -> None:
    before = image.copy()
    result = overlay(image, values, strength=strength)
    assert result.dtype == np.uint8
    np.testing.assert_array_equal(image, before)
    zero = values == 0
    np.testing.assert_array_equal(result[zero], image[zero])
    blend = (1 - strength) * image + strength * 255 * heat(values)
    assert np.abs(result[~zero] - blend[~zero]).max(initial=0) <= 0.5 + 1e-6


def test_near_is_bright_and_nothing_is_pink() -> None:
    picture = depth_picture(np.array([[0.7, 0.8, 0.0]]))
    assert picture.dtype == np.uint8
    near, far, none = picture[0].astype(int)
    assert near[0] > far[0]
    assert np.ptp(near) == np.ptp(far) == 0
    assert np.ptp(none) > 0


def test_only_the_target_is_red() -> None:
    colors = instance_colors(20).astype(int)
    assert len(np.unique(colors, axis=0)) == 20
    red, green, blue = colors[1]
    assert red > 150
    assert max(green, blue) < 50
    for red, green, blue in np.delete(colors, 1, axis=0):
        assert red - max(green, blue) < 100
    assert instance_colors(1).shape == (1, 3)
    instances = np.array([[0, 1], [5, 2]], np.uint8)
    np.testing.assert_array_equal(
        instance_picture(instances), instance_colors(6)[instances]
    )
