import io

import cv2
import matplotlib as mpl
import numpy as np
import pytest

from xray_drake.drawing.figures import SEEN, Panel, panel_figure

GRAY = 120


def panel(title: str = "", *, outlined: bool = False) -> Panel:
    mask = np.zeros((60, 80), bool)
    mask[10:50, 40:70] = outlined
    return Panel(np.full((60, 80, 3), GRAY, np.uint8), title, {SEEN: mask})


def drawn(panels: list[Panel], columns: int) -> np.ndarray:
    image = io.BytesIO()
    before = mpl.get_backend(auto_select=False)
    panel_figure(panels, columns).savefig(image, format="png")
    # Nobody else's figures are touched.
    assert mpl.get_backend(auto_select=False) == before
    data = np.frombuffer(image.getvalue(), np.uint8)
    return cv2.imdecode(data, cv2.IMREAD_COLOR)[:, :, ::-1]


def near(picture: np.ndarray, color: object) -> np.ndarray:
    return (np.abs(picture - np.array(color, float)) < 30).all(axis=2)


def test_pictures_are_in_the_order_of_reading() -> None:
    one = drawn([panel("1")], 1)
    five = drawn([panel("$x_1$") for _ in range(5)], 4)
    assert five.shape[1] == pytest.approx(4 * one.shape[1], abs=4)
    assert five.shape[0] == pytest.approx(2 * one.shape[0], abs=4)
    # The last row holds one, at the left.
    width = five.shape[1] // 4
    below = near(five[five.shape[0] // 2 :], [GRAY] * 3)
    assert below[:, :width].any()
    assert not below[:, width:].any()


def test_masks_are_outlined() -> None:
    magenta = (255, 0, 180)
    assert not near(drawn([panel()], 1), magenta).any()
    outline = near(drawn([panel(outlined=True)], 1), magenta)
    assert 0 < outline.mean() < 0.05


def test_a_figure_needs_pictures() -> None:
    with pytest.raises(ValueError, match="at least one"):
        panel_figure([], 1)
