import numpy as np
import pytest

from xray_drake.drawing.contact_sheet import (
    CAPTION_HEIGHT,
    contact_sheet,
    object_picture,
)
from xray_drake.scene.library import make_object


def test_an_object_fills_its_tile_in_its_colour() -> None:
    model = make_object("stone_000")
    picture = object_picture(model, 64)
    assert picture.shape == (64, 64, 3)
    assert picture.dtype == np.uint8
    strongest = int(np.argmax(model.color[:3]))
    weakest = int(np.argmin(model.color[:3]))
    colored = picture[..., strongest] > picture[..., weakest].astype(int) + 8
    rows, columns = np.nonzero(colored)
    assert colored.mean() > 0.2
    assert max(np.ptp(rows), np.ptp(columns)) > 50
    # The corners are background, and the object does not touch the edge.
    assert picture[0, 0].min() > 235
    assert not colored[[0, -1]].any()
    assert not colored[:, [0, -1]].any()


def test_a_sheet_has_a_tile_for_each() -> None:
    cup, gear = make_object("cup_000"), make_object("gear_000")
    models = [cup, None, gear]
    told: list[tuple[int, int]] = []
    sheet = contact_sheet(
        models, columns=2, size=48, progress=lambda *n: told.append(n)
    )
    assert sheet.shape == (2 * (48 + CAPTION_HEIGHT), 96, 3)
    assert told == [(1, 3), (2, 3), (3, 3)]
    first = sheet[:48, :48]
    np.testing.assert_array_equal(first, object_picture(cup, 48))
    caption = sheet[48 : 48 + CAPTION_HEIGHT, :48]
    assert caption.min() < 120
    # The second and the fourth place are empty.
    assert sheet[:, 48:].min() > 235


def test_a_sheet_of_nothing() -> None:
    with pytest.raises(ValueError, match="at least one"):
        contact_sheet([])
