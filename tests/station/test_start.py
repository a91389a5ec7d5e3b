from dataclasses import replace

import numpy as np
import pytest

from xray_drake.scene.heap import Heap
from xray_drake.station.scenario import Scenario
from xray_drake.station.start import look_at_heap, target_view

TARGET = "box_2to1"
LABELS = {TARGET: 1, "fork": 2, "book": 3, "cup": 4}


def scene() -> tuple[np.ndarray, np.ndarray]:
    """Returns labels and amodal mask of a target of 20 × 10 pixels."""
    labels = np.zeros((60, 80), int)
    amodal = np.zeros((60, 80), bool)
    amodal[10:20, 10:30] = True
    labels[amodal] = LABELS[TARGET]
    return labels, amodal


def test_a_target_in_full_view() -> None:
    labels, amodal = scene()
    labels[40:50, 40:60] = LABELS["book"]
    view = target_view(labels, amodal, LABELS, TARGET)
    assert (view.target_pixels, view.target_visible_fraction) == (200, 1.0)
    assert (view.cover_pixels, view.cover_fraction, view.num_covers) == (
        *(0, 0, 0),
    )


def test_what_covers_most_of_it_is_the_cover() -> None:
    labels, amodal = scene()
    labels[15:50, 5:40] = LABELS["book"]  # over 5 of its 10 rows
    labels[5:60, 12:15] = LABELS["fork"]  # then over 3 of its 20 columns
    view = target_view(labels, amodal, LABELS, TARGET)
    assert view.target_pixels == 200
    assert view.target_visible_fraction == pytest.approx(5 * 17 / 200)
    # Its whole modal mask, but for what the fork hides.
    assert view.cover_pixels == 35 * 35 - 35 * 3
    assert view.cover_fraction == pytest.approx(5 * 17 / 200)
    assert view.num_covers == 2


def test_a_hidden_target() -> None:
    labels, amodal = scene()
    labels[amodal] = LABELS["cup"]
    view = target_view(labels, amodal, LABELS, TARGET)
    assert (view.target_visible_fraction, view.cover_fraction) == (0, 1)
    assert view.cover_pixels == view.target_pixels == 200


def test_a_touch_of_the_edge_is_no_cover() -> None:
    labels, amodal = scene()
    labels[19, 10] = LABELS["book"]
    labels[20:50] = LABELS["book"]
    view = target_view(labels, amodal, LABELS, TARGET)
    assert view.num_covers == view.cover_pixels == 0
    assert view.target_visible_fraction == pytest.approx(199 / 200)


def test_the_bin_is_no_cover() -> None:
    labels, amodal = scene()
    labels[10:15] = 9
    view = target_view(labels, amodal, LABELS, TARGET)
    assert view.num_covers == 0
    assert view.target_visible_fraction == 0.5


def test_a_heap_is_looked_at(tiny_scenario: Scenario, tiny_heap: Heap) -> None:
    view = look_at_heap(tiny_scenario, tiny_heap)
    assert view.target_visible_fraction == pytest.approx(0.16, abs=0.03)
    assert view.num_covers == 1
    # 9 cm², 0.5 cm high, seen from 0.8 m.
    assert view.target_pixels == pytest.approx(
        9e-4 * (552.5 / 0.795) ** 2, rel=0.03
    )
    bare = replace(
        tiny_heap,
        objects=tuple(o for o in tiny_heap.objects if o.name != "book"),
    )
    view = look_at_heap(tiny_scenario, bare)
    assert view.target_visible_fraction > 0.97
    tiny_scenario.gripper.execution = "contact"
    assert look_at_heap(tiny_scenario, bare) == view
