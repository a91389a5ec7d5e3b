import colorsys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from xray_drake.perception.hsv_target import HsvTargetConfig, detect_target
from xray_drake.scene.colors import distractor_color
from xray_drake.scene.targets import TARGET_COLOR

GREY = (150, 150, 150)
PATCH = np.s_[10:20, 30:50]


def picture(color: tuple[int, ...]) -> np.ndarray:
    """A grey image with a patch of a colour in it."""
    image = np.full((40, 60, 3), GREY, np.uint8)
    image[PATCH] = color
    return image


def rgb(red: float, green: float, blue: float) -> tuple[int, ...]:
    return tuple(round(255 * c) for c in (red, green, blue))


def hsv(hue: float, saturation: float = 0.9, value: float = 0.8) -> tuple:
    return rgb(*colorsys.hsv_to_rgb(hue % 360 / 360, saturation, value))


@given(light=st.floats(0.15, 1.25))
def test_the_target_in_any_light(light: float) -> None:
    color = np.clip(light * np.array(TARGET_COLOR[:3]), 0, 1)
    expected = np.zeros((40, 60), bool)
    expected[PATCH] = True
    found = detect_target(picture(rgb(*color))).data
    np.testing.assert_array_equal(found, expected)


@given(seed=st.integers(0, 2**32), light=st.floats(0.2, 1.0))
def test_no_distractor_is_the_target(seed: int, light: float) -> None:
    color = distractor_color(np.random.default_rng(seed))[:3]
    found = detect_target(picture(rgb(*(light * np.array(color))))).data
    assert not found.any()


@pytest.mark.parametrize(
    ("color", "hue", "found"),
    [
        (hsv(0), 0, True),
        (hsv(12), 0, True),
        (hsv(348), 0, True),
        (hsv(18), 0, False),
        (hsv(342), 0, False),
        (hsv(240), 0, False),
        (hsv(0, saturation=0.4), 0, False),
        (hsv(0, value=0.05), 0, False),
        (GREY, 0, False),
        ((0, 0, 0), 0, False),
        (hsv(110), 120, True),
        (hsv(0), 120, False),
    ],
)
def test_hues_near_the_targets_that_are_not_pale_or_dark(
    color: tuple[int, ...], hue: float, found: bool
) -> None:
    mask = detect_target(picture(color), HsvTargetConfig(hue=hue)).data
    assert mask.shape == (40, 60)
    assert mask.any() == found


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
