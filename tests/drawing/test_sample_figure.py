import io
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
import pytest

from xray_drake.drawing.sample_figure import (
    depth_picture,
    instance_colors,
    instance_picture,
    sample_figure,
)


@dataclass
class _Sample:
    depth: np.ndarray
    target_modal: np.ndarray
    target_amodal: np.ndarray
    instances: np.ndarray
    occupancy: np.ndarray
    color: np.ndarray | None
    visible_fraction: float
    key: object


def _sample(*, color: bool = False, blank: bool = False) -> _Sample:
    depth = np.full((24, 32), 0.8, np.float32)
    depth[4:12, 6:20] = 0.7
    mask = np.zeros((24, 32), bool)
    mask[5:9, 8:16] = not blank
    return _Sample(
        depth=0 * depth if blank else depth,
        target_modal=mask,
        target_amodal=mask,
        instances=mask.astype(np.uint8),
        occupancy=mask.astype(np.float32),
        color=np.zeros((24, 32, 3), np.uint8) if color else None,
        visible_fraction=1.0,
        key="heap 3, lid, view 0, 12 dropped",
    )


def test_a_figure_has_a_row_for_each_sample() -> None:
    before = mpl.get_backend(auto_select=False)
    figure = sample_figure([_sample(), _sample(color=True), _sample()])
    assert len(figure.axes) == 9
    assert figure.axes[3].get_title(loc="left").startswith("heap 3, lid")
    assert "100% visible" in figure.axes[5].get_title(loc="left")
    data = io.BytesIO()
    figure.savefig(data, format="png")
    assert data.getvalue().startswith(b"\x89PNG")
    # Nobody else's figures are touched.
    assert mpl.get_backend(auto_select=False) == before


def test_a_blank_sample_can_be_drawn() -> None:
    sample_figure([_sample(blank=True)]).savefig(io.BytesIO(), format="png")


def test_no_samples_no_figure() -> None:
    with pytest.raises(ValueError, match="at least one"):
        sample_figure([])


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
