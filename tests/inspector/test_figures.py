import math
from dataclasses import replace

import numpy as np
import pytest

from tests.dataset.whole import bare_sample
from xray_drake.drawing.colors import depth_picture, instance_picture, overlay
from xray_drake.inspector.figures import (
    Example,
    choose_examples,
    prediction_figure,
    sample_figure,
)
from xray_drake.messages import OccupancyDistribution


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
        sample=replace(
            bare_sample(mask, focal_length=40.0, heap_seed=3),
            depth=depth,
            target_modal=seen & (not hidden),
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
    example = _example()
    figure = prediction_figure([example, _example(hidden=True)])
    titles = [axis.get_title(loc="left") for axis in figure.axes]
    assert titles[:4] == [
        "heap 3, box_2to1, view 0, 11 dropped",
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


def test_a_row_is_picture_depth_and_label() -> None:
    sample = _example().sample
    colored = replace(sample, color=np.full((24, 32, 3), 9, np.uint8))
    blank = replace(sample, depth=np.zeros((24, 32)))
    figure = sample_figure([sample, colored, blank])
    titles = [axis.get_title(loc="left") for axis in figure.axes]
    assert titles[:3] == [
        str(sample.key),
        "depth 0.700 to 0.800 m",
        f"{sample.visible_fraction:.0%} visible, support 32 pixels",
    ]
    assert titles[7] == "depth "
    assert [len(axis.collections) for axis in figure.axes] == [2, 0, 1] * 3
    images = [np.asarray(axis.images[0].get_array()) for axis in figure.axes]
    np.testing.assert_array_equal(images[0], instance_picture(sample.instances))
    assert (images[3] == 9).all()
    gray = depth_picture(sample.depth)
    np.testing.assert_array_equal(images[2], overlay(gray, sample.occupancy))
    with pytest.raises(ValueError, match="at least one"):
        sample_figure([])
