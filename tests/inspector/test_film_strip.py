from pathlib import Path

import cv2
import numpy as np
import pytest

from xray_drake.inspector.film_strip import FilmStrip
from xray_drake.inspector.pictures import write_picture
from xray_drake.scene.heap import Heap
from xray_drake.search.diagram import build_search_diagram
from xray_drake.search.record import SearchRecord
from xray_drake.search.rollout import run_search
from xray_drake.testing.tiny import make_tiny_scenario


@pytest.fixture(scope="module")
def filmed(tiny_heap: Heap) -> tuple[FilmStrip, SearchRecord]:
    film = FilmStrip()
    diagram = build_search_diagram(make_tiny_scenario(), heap=tiny_heap)
    return film, run_search(diagram, observers=(film,))


def test_a_frame_for_each_action(
    filmed: tuple[FilmStrip, SearchRecord],
) -> None:
    film, record = filmed
    assert len(film.frames) == record.num_actions > 1
    for frame, action in zip(film.frames, record.actions, strict=True):
        assert frame.title.startswith(f"{action.step}: ")
        assert action.grasp.kind.value in frame.title
        assert f"support {action.support_before} px" in frame.note
        assert frame.note.endswith(action.outcome.value)
        assert np.count_nonzero(frame.occupancy) == action.support_before
        assert frame.chosen.any()
    first, last = film.frames[0], film.frames[-1]
    assert record.actions[0].object in first.title
    assert "the target" in last.title
    # The heap has changed in between.
    assert (first.color != last.color).any(axis=2).mean() > 0.01


def test_it_is_written(
    filmed: tuple[FilmStrip, SearchRecord], tmp_path: Path
) -> None:
    path = tmp_path / "film.PNG"
    filmed[0].write(path)
    assert cv2.imread(str(path)).std() > 10


def test_nothing_decided_is_no_film(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="at least one frame"):
        FilmStrip().write(tmp_path / "film.png")


def test_a_picture_that_does_not_exist(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="'hep': heap, diagram"):
        write_picture("hep", tmp_path)
