import colorsys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from xray_drake.perception.hsv_target import HsvTargetConfig, detect_target
from xray_drake.scene.colors import distractor_color
from xray_drake.scene.targets import TARGET_COLOR

GREY = (150, 150, 150)


def picture(
    color: tuple[int, ...], patch: tuple = np.s_[10:20, 30:50]
) -> np.ndarray:
    """A grey image with a patch of a colour in it."""
    image = np.full((40, 60, 3), GREY, np.uint8)
    image[patch] = color
    return image


def rgb(red: float, green: float, blue: float) -> tuple[int, ...]:
    return tuple(round(255 * c) for c in (red, green, blue))


def hsv(hue: float, saturation: float = 0.9, value: float = 0.8) -> tuple:
    return rgb(*colorsys.hsv_to_rgb(hue % 360 / 360, saturation, value))


def expected(patch: tuple = np.s_[10:20, 30:50]) -> np.ndarray:
    mask = np.zeros((40, 60), bool)
    mask[patch] = True
    return mask


@given(light=st.floats(0.15, 1.25))
def test_the_target_in_any_light(light: float) -> None:
    color = np.clip(light * np.array(TARGET_COLOR[:3]), 0, 1)
    found = detect_target(picture(rgb(*color))).data
    np.testing.assert_array_equal(found, expected())


@given(seed=st.integers(0, 2**32), light=st.floats(0.2, 1.0))
def test_no_distractor_is_the_target(seed: int, light: float) -> None:
    color = distractor_color(np.random.default_rng(seed))[:3]
    found = detect_target(picture(rgb(*(light * np.array(color))))).data
    assert not found.any()


@pytest.mark.parametrize(
    ("hue", "is_red"),
    [
        (0, True),
        (12, True),
        (348, True),
        (359, True),
        (18, False),
        (342, False),
        (120, False),
        (240, False),
    ],
)
def test_both_ends_of_the_circle_are_red(hue: float, is_red: bool) -> None:
    assert detect_target(picture(hsv(hue))).data.any() == is_red


@pytest.mark.parametrize(
    "color", [hsv(0, saturation=0.4), hsv(0, value=0.05), GREY, (0, 0, 0)]
)
def test_pale_dark_and_grey_are_not_red(color: tuple[int, ...]) -> None:
    found = detect_target(picture(color)).data
    assert found.shape == (40, 60)
    assert not found.any()


def test_targets_of_another_colour() -> None:
    green = HsvTargetConfig(hue=120.0)
    assert detect_target(picture(hsv(110)), green).data.any()
    assert not detect_target(picture(hsv(0)), green).data.any()


def test_specks_are_dropped_and_parts_are_kept() -> None:
    image = picture(hsv(0))
    image[12:18, 36:40] = GREY  # does not part it
    image[:, 44:46] = GREY  # does
    wanted = detect_target(image).data
    assert wanted[10:20, 30:44].sum() == 140 - 24
    assert wanted[10:20, 46:50].all()
    image[2:5, 3:6] = hsv(0)  # 9 pixels
    np.testing.assert_array_equal(detect_target(image).data, wanted)
    image[2:5, 3:7] = hsv(0)
    assert detect_target(image).data[2:5, 3:7].all()


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((4, 5), np.uint8),
        np.zeros((4, 5, 4), np.uint8),
        np.zeros((4, 5, 3), np.float32),
    ],
)
def test_no_colour_image(image: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"\(H, W, 3\) uint8"):
        detect_target(image)
