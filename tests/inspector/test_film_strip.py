from pathlib import Path

import cv2
import numpy as np
import pytest

from xray_drake.inspector.film_strip import FilmStrip
from xray_drake.scene.heap import Heap
from xray_drake.search.diagram import build_search_diagram
from xray_drake.search.rollout import run_search
from xray_drake.testing.tiny import make_tiny_scenario


def test_a_frame_for_each_action(tiny_heap: Heap, tmp_path: Path) -> None:
    film = FilmStrip()
    diagram = build_search_diagram(make_tiny_scenario(), heap=tiny_heap)
    record = run_search(diagram, observers=(film,))
    panels = film.figure().axes[: record.num_actions]
    assert len(film.snapshots) == record.num_actions > 1
    pictures = []
    for panel, action in zip(panels, record.actions, strict=True):
        title, note = panel.get_title(loc="left").split("\n")
        assert title.startswith(f"{action.step}: ")
        assert title.endswith(f" by {action.grasp.kind.value}")
        found = "the target" if action.is_target else action.object
        assert found in title
        support = f"support {action.support_before} px"
        assert note == f"{support}, {action.outcome.value}"
        assert len(panel.collections) == 1, "what is chosen is outlined"
        pictures.append(np.asarray(panel.images[0].get_array()))
    assert record.actions[-1].is_target
    # Cropped to the heap, which has changed in between.
    assert pictures[0].shape[0] < film.snapshots[0].color.shape[0]
    changed = (film.snapshots[0].color != film.snapshots[-1].color).any(axis=2)
    assert changed.mean() > 0.01
    path = tmp_path / "film.PNG"
    film.write(path)
    assert cv2.imread(str(path)).std() > 10


def test_nothing_decided_is_no_film(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="at least one frame"):
        FilmStrip().write(tmp_path / "film.png")
