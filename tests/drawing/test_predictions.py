import io
import math
from dataclasses import dataclass, replace

import matplotlib as mpl
import numpy as np
import pytest

from xray_drake.drawing.colors import overlay
from xray_drake.drawing.predictions import (
    Example,
    choose_examples,
    prediction_figure,
)
from xray_drake.drawing.sample_figure import depth_picture
from xray_drake.messages import OccupancyDistribution


@dataclass
class _Sample:
    depth: np.ndarray
    target_modal: np.ndarray
    target_amodal: np.ndarray
    instances: np.ndarray
    occupancy: np.ndarray
    color: np.ndarray | None = None
    visible_fraction: float = 0.25
    key: object = "heap 3, lid, view 0, 12 dropped"


def _example(*, hidden: bool = False) -> Example:
    depth = np.full((24, 32), 0.8, np.float32)
    depth[4:12, 6:20] = 0.7
    mask = np.zeros((24, 32), bool)
    mask[5:9, 8:16] = True
    seen = mask.copy()
    seen[:, 10:] = False
    occupancy = mask.astype(np.float32)
    prediction = 0.5 * occupancy
    prediction[20, 3] = 0.01
    return Example(
        sample=_Sample(
            depth=depth,
            target_modal=seen & (not hidden),
            target_amodal=mask,
            instances=mask.astype(np.uint8),
            occupancy=occupancy,
        ),
        predictions={
            "net_$a$": OccupancyDistribution(prediction, 0.02),
            "exact": OccupancyDistribution(occupancy),
        },
        ious={"net_$a$": 0.125, "exact": math.nan},
    )


def test_a_row_is_input_label_and_predictions() -> None:
    before = mpl.get_backend(auto_select=False)
    example = _example()
    figure = prediction_figure([example, _example(hidden=True)])
    titles = [axis.get_title(loc="left") for axis in figure.axes]
    assert titles[:4] == [
        "heap 3, lid, view 0, 12 dropped",
        "label, target 25% visible",
        "net_$a$, IoU 0.125",
        "exact, IoU nan",
    ]
    assert len(titles) == 8
    # Only what is seen of the target is outlined in the input.
    outlines = [len(axis.collections) for axis in figure.axes]
    assert outlines == [1, 1, 1, 1, 0, 1, 1, 1]
    gray = depth_picture(example.sample.depth)
    images = [np.asarray(a.images[0].get_array()) for a in figure.axes[:4]]
    np.testing.assert_array_equal(images[0], gray)
    label = overlay(gray, example.sample.occupancy)
    np.testing.assert_array_equal(images[1], label)
    np.testing.assert_array_equal(images[3], label)
    # The prediction has its own colours, and no more than its support is drawn.
    assert not np.array_equal(images[2], label)
    np.testing.assert_array_equal(images[2][20, 3], gray[20, 3])
    data = io.BytesIO()
    figure.savefig(data, format="png")
    assert data.getvalue().startswith(b"\x89PNG")
    # Nobody else's figures are touched.
    assert mpl.get_backend(auto_select=False) == before


def test_rows_need_the_same_predictors() -> None:
    example = _example()
    other = replace(example, predictions={})
    with pytest.raises(ValueError, match="same predictors"):
        prediction_figure([example, other])
    with pytest.raises(ValueError, match="at least one"):
        prediction_figure([])


def test_the_first_or_the_worst_are_chosen() -> None:
    ious = [0.7, 0.2, math.nan, 0.9, 0.2, 0.0]
    assert choose_examples(ious, 3) == [0, 1, 2]
    assert choose_examples(ious, 4, worst=True) == [5, 1, 4, 0]
    assert choose_examples(ious, 99) == [0, 1, 2, 3, 4, 5]
    assert choose_examples(ious, 99, worst=True) == [5, 1, 4, 0, 3]
    assert choose_examples([], 3, worst=True) == []
