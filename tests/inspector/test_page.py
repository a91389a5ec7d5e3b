from collections.abc import Callable

import pytest
import umsgpack
from pydrake.geometry import Meshcat

from tests.meshcat_probe import click, prop
from xray_drake.inspector import page as module
from xray_drake.inspector.layers import LAYERS
from xray_drake.inspector.page import (
    BACK,
    HEAP_OPACITY,
    NEXT,
    OBJECTS,
    SEARCH,
    SEED,
    STEP,
    TARGET,
    InspectorPage,
)
from xray_drake.inspector.replay import Replay
from xray_drake.inspector.snapshot import ranking_lines
from xray_drake.inspector.view import ReplayView
from xray_drake.scene.heap import Heap, HeapError
from xray_drake.station.scenario import Scenario

DROP = "drop box_2to1, 4 objects, seed 7"


@pytest.fixture
def told() -> list[str]:
    return []


@pytest.fixture
def rollout(meshcat: Meshcat, replay: Replay, told: list[str]) -> InspectorPage:
    view = ReplayView(replay, meshcat)
    return InspectorPage(view, announce=told.append)


@pytest.fixture
def heap(meshcat: Meshcat, looked_at: Replay, told: list[str]) -> InspectorPage:
    view = ReplayView(looked_at, meshcat)
    return InspectorPage(view, opacity=0.5, announce=told.append)


def move(meshcat: Meshcat, name: str, value: float) -> None:
    """Does what a browser does when a slider is moved."""
    message = {"type": "slider", "name": name, "value": value}
    meshcat._InjectWebsocketMessage(message=umsgpack.packb(message))


def test_steps(
    meshcat: Meshcat, rollout: InspectorPage, told: list[str]
) -> None:
    assert told[0].startswith("step 1 of 2, largest: book by ")
    action = rollout.view.replay.snapshots[0].action
    assert [line.strip() for line in told[1:]] == list(ranking_lines(action))
    assert not rollout.poll()
    click(meshcat, NEXT)
    assert rollout.poll()
    assert rollout.view.step == 2
    assert meshcat.GetSliderValue(STEP) == 2
    assert not rollout.poll()
    # Faster than it looks, and beyond the end.
    for _ in range(5):
        click(meshcat, NEXT)
    rollout.poll()
    assert rollout.view.step == meshcat.GetSliderValue(STEP) == 3
    assert told[-1].startswith("end: ")
    click(meshcat, BACK)
    rollout.poll()
    assert rollout.view.step == 2
    move(meshcat, STEP, 1)
    assert rollout.poll()
    assert rollout.view.step == 1
    assert not rollout.poll()
    click(meshcat, BACK)
    rollout.poll()
    assert rollout.view.step == 1
    assert SEARCH not in meshcat.GetButtonNames()


def test_layers_and_x_ray(meshcat: Meshcat, rollout: InspectorPage) -> None:
    for layer in LAYERS:
        assert meshcat.GetSliderValue(layer.name) == layer.opacity
        opacity = 0 if layer.opacity else 1
        move(meshcat, layer.name, opacity)
        assert rollout.poll()
        path = f"/inspect/{layer.name}"
        assert prop(meshcat, path, "visible") is bool(opacity)
    book = "visualizer/book/book/book/visual"
    move(meshcat, HEAP_OPACITY, 0.375)
    rollout.poll()
    assert prop(meshcat, book, "modulated_opacity") == 0.375


def test_a_search_of_the_heap(
    meshcat: Meshcat, heap: InspectorPage, told: list[str]
) -> None:
    assert not {STEP, TARGET} <= set(meshcat.GetSliderNames())
    assert {NEXT, BACK}.isdisjoint(meshcat.GetButtonNames())
    move(meshcat, "scores", 0.5)
    heap.poll()
    click(meshcat, SEARCH)
    assert heap.poll()
    assert heap.view.replay.ended
    assert "searching …" in told
    assert STEP in meshcat.GetSliderNames()
    assert SEARCH not in meshcat.GetButtonNames()
    assert DROP in meshcat.GetButtonNames()
    # Layers stay as they were, and so does the heap.
    assert meshcat.GetSliderValue("scores") == 0.5
    assert prop(meshcat, "/inspect/scores", "visible") is True
    assert meshcat.GetSliderValue(HEAP_OPACITY) == 0.5
    book = "visualizer/book/book/book/visual"
    assert prop(meshcat, book, "modulated_opacity") == 0.5
    assert not heap.poll()


def test_the_last_button_says_what_it_drops_and_does(
    meshcat: Meshcat,
    rollout: InspectorPage,
    tiny_heap: Heap,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given: list[Scenario] = []
    labels: list[str] = []

    def drop(scenario: Scenario, *, progress: Callable[[float], None]) -> Heap:
        given.append(scenario)
        progress(0.4)
        labels.extend(meshcat.GetButtonNames())
        return tiny_heap

    monkeypatch.setattr(module, "make_heap", drop)
    assert DROP in meshcat.GetButtonNames()
    assert meshcat.GetSliderValue(TARGET) == 2
    move(meshcat, TARGET, 12)
    move(meshcat, OBJECTS, 6)
    assert rollout.poll()
    assert DROP not in meshcat.GetButtonNames()
    assert "drop domino, 6 objects, seed 7" in meshcat.GetButtonNames()
    move(meshcat, SEED, 31)
    assert rollout.poll()
    assert not rollout.poll()
    click(meshcat, "drop domino, 6 objects, seed 31")
    assert rollout.poll()
    (scenario,) = given
    chosen = scenario.seed, scenario.scene.target, scenario.scene.num_objects
    assert chosen == (31, "domino", 6)
    assert scenario.scene.random_number.mean == 0
    assert "dropping … 40%" in labels
    assert not rollout.view.replay.ended
    assert rollout.view.replay.scenario is scenario
    assert SEARCH in meshcat.GetButtonNames()
    assert "dropping … 40%" not in meshcat.GetButtonNames()
    assert not rollout.poll()


def test_a_heap_that_fails_leaves_the_page(
    meshcat: Meshcat,
    heap: InspectorPage,
    told: list[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(scenario: Scenario, **_: object) -> Heap:
        raise HeapError("seed 7: 10 heaps in a row\nfailed")

    monkeypatch.setattr(module, "make_heap", fail)
    view = heap.view
    click(meshcat, DROP)
    assert heap.poll()
    assert told[-1] == "seed 7: 10 heaps in a row failed"
    assert heap.view is view
    assert DROP in meshcat.GetButtonNames()


def test_ctrl_c_takes_the_controls_away(
    meshcat: Meshcat, heap: InspectorPage, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(seconds: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("time.sleep", interrupt)
    heap.loop()
    assert meshcat.GetButtonNames() == meshcat.GetSliderNames() == []
