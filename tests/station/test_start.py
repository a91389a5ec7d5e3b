from dataclasses import astuple, replace

import numpy as np
import pytest

from xray_drake.scene.heap import Heap
from xray_drake.station.scenario import Scenario
from xray_drake.station.start import look_at_heap, target_view

TARGET = "box_2to1"
LABELS = {TARGET: 1, "fork": 2, "book": 3, "cup": 4, "bin": 9}
AMODAL = np.zeros((60, 80), bool)
AMODAL[10:20, 10:30] = True
"""A target of 20 × 10 pixels."""


@pytest.mark.parametrize(
    ("painted", "visible", "cover_pixels", "covered", "covers"),
    [
        pytest.param({"book": np.s_[40:50, 40:60]}, 1, 0, 0, 0, id="in view"),
        pytest.param({"cup": np.s_[10:20, 10:30]}, 0, 200, 1, 1, id="hidden"),
        pytest.param(
            # Over 5 of its 10 rows, then over 3 of its 20 columns: the whole
            # modal mask of the first counts, but for what the other hides.
            {"book": np.s_[15:50, 5:40], "fork": np.s_[5:60, 12:15]},
            *(5 * 17 / 200, 35 * 35 - 35 * 3, 5 * 17 / 200, 2),
            id="what covers most of it is the cover",
        ),
        pytest.param(
            {"book": np.s_[19:50, 10:11]},
            *(199 / 200, 0, 0, 0),
            id="a touch of the edge is no cover",
        ),
        pytest.param({"bin": np.s_[10:15]}, 0.5, 0, 0, 0, id="nor is the bin"),
    ],
)
def test_what_is_seen_of_the_target_and_of_what_covers_it(
    painted: dict[str, tuple[slice, ...]],
    visible: float,
    cover_pixels: int,
    covered: float,
    covers: int,
) -> None:
    labels = AMODAL.astype(int)
    for name, place in painted.items():
        labels[place] = LABELS[name]
    objects = {name: LABELS[name] for name in LABELS if name != "bin"}
    view = target_view(labels, AMODAL, objects, TARGET)
    expected = (200, visible, cover_pixels, covered, covers)
    assert astuple(view) == pytest.approx(expected)


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
