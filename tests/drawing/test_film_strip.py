import io

import cv2
import numpy as np
import pytest

from xray_drake.drawing.colors import heat
from xray_drake.drawing.film_strip import Frame, film_strip_figure

GRAY = 120


def frame(title: str, value: float = 0.0, *, chosen: bool = False) -> Frame:
    occupancy = np.zeros((60, 80), np.float32)
    occupancy[20:40, 10:30] = value
    mask = np.zeros((60, 80), bool)
    mask[10:50, 40:70] = chosen
    return Frame(
        color=np.full((60, 80, 3), GRAY, np.uint8),
        occupancy=occupancy,
        chosen=mask,
        title=title,
        note="support $x_1$ px",
    )


def drawn(frames: list[Frame]) -> np.ndarray:
    image = io.BytesIO()
    film_strip_figure(frames).savefig(image, format="png")
    data = np.frombuffer(image.getvalue(), np.uint8)
    return cv2.imdecode(data, cv2.IMREAD_COLOR)[:, :, ::-1]


def near(picture: np.ndarray, color: object) -> np.ndarray:
    return (np.abs(picture - np.array(color, float)) < 30).all(axis=2)


def test_rows_of_four() -> None:
    one, five = drawn([frame("1")]), drawn([frame(str(i)) for i in range(5)])
    assert five.shape[1] == pytest.approx(4 * one.shape[1], abs=4)
    assert five.shape[0] == pytest.approx(2 * one.shape[0], abs=4)
    # The last row holds one, at the left.
    width = five.shape[1] // 4
    below = near(five[five.shape[0] // 2 :], [GRAY] * 3)
    assert below[:, :width].any()
    assert not below[:, width:].any()


def test_distribution_and_outline_are_drawn() -> None:
    plain = drawn([frame("1")])
    yellow = 0.65 * 255 * heat(1.0) + 0.35 * GRAY
    assert not near(plain, yellow).any()
    picture = drawn([frame("1", 1.0, chosen=True)])
    # 20 of 60 by 20 of 80 pixels.
    share = near(picture, yellow).sum() / near(plain, [GRAY] * 3).sum()
    assert share == pytest.approx(1 / 12, rel=0.1)
    assert near(picture, (255, 0, 180)).any()


def test_a_strip_needs_frames() -> None:
    with pytest.raises(ValueError, match="at least one frame"):
        film_strip_figure([])
