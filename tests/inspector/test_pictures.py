import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from xray_drake.inspector.pictures import (
    contact_picture,
    diagram_picture,
    heap_picture,
    write_picture,
)
from xray_drake.inspector.replay import Replay
from xray_drake.messages import GraspKind
from xray_drake.scene.heap import Heap
from xray_drake.search.diagram import SearchDiagram, build_search_diagram
from xray_drake.testing.tiny import make_tiny_scenario


def test_the_heap_the_distribution_and_the_choice(looked_at: Replay) -> None:
    (shot,) = looked_at.snapshots
    picture = heap_picture(shot)
    assert picture.shape == (384, 3 * 512, 3)
    assert picture.dtype == np.uint8
    color, occupancy, chosen = np.split(picture, 3, axis=1)
    np.testing.assert_array_equal(color, shot.color)
    # Coloured where the target can be, and nowhere else.
    rho = shot.occupancy.data
    changed = (occupancy != color).any(axis=2)
    assert changed[rho == 0].mean() < 0.01
    assert changed[rho > 0].mean() > 0.9
    # A line round something that is grasped: one closed outline.
    line = (chosen != color).any(axis=2)
    assert line.any()
    assert (chosen[line] == chosen[line][0]).all()
    parts, _ = cv2.connectedComponents(line.astype(np.uint8))
    holes, _ = cv2.connectedComponents((~line).astype(np.uint8), connectivity=4)
    assert (parts - 1, holes - 1) == (1, 2)


@pytest.mark.skipif(not shutil.which("dot"), reason="graphviz is missing")
def test_the_diagram(tiny_diagram: SearchDiagram, tmp_path: Path) -> None:
    path = tmp_path / "diagram.png"
    diagram_picture(tiny_diagram, path)
    image = cv2.imread(str(path))
    assert image.shape[1] > image.shape[0] > 100
    assert image.std() > 10


def test_the_gripper_holds_something(tiny_heap: Heap) -> None:
    scenario = make_tiny_scenario()
    scenario.gripper.execution = "contact"
    diagram = build_search_diagram(scenario, heap=tiny_heap)
    picture = contact_picture(diagram, kind=GraspKind.JAW)
    assert picture.shape == (560, 840, 3)
    # The blue book is in the upper half, over the bin.
    red, green, blue = np.moveaxis(picture.astype(int), 2, 0)
    is_book = (blue > red + 40) & (blue > green + 30)
    assert is_book[:300, 200:640].sum() > 500


def test_only_contact_shows_a_gripper(tiny_diagram: SearchDiagram) -> None:
    with pytest.raises(ValueError, match="by contact"):
        contact_picture(tiny_diagram)


def test_a_picture_that_does_not_exist(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="'hep': heap, diagram"):
        write_picture("hep", tmp_path)
