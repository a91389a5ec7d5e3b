import numpy as np
import pytest
from pydrake.geometry import Meshcat

from tests.meshcat_probe import messages, prop, tracks, vertices
from xray_drake.drawing.meshcat_layers import start_meshcat
from xray_drake.inspector.layers import SEARCH_LAYERS
from xray_drake.inspector.recording import SearchDrawing, record_search
from xray_drake.messages import Grasp, GraspKind, SearchAction
from xray_drake.scene.heap import Heap
from xray_drake.search.diagram import SearchDiagram, build_search_diagram
from xray_drake.search.record import ActionRecord, SearchRecord
from xray_drake.search.rollout import run_search
from xray_drake.station.scenario import Scenario

HORIZON = 2


def scenario() -> Scenario:
    return Scenario(name="tiny", seed=7, horizon=HORIZON)


@pytest.fixture(scope="module")
def recording(tiny_heap: Heap) -> tuple[SearchRecord, str]:
    """The record of a short search, and the page that plays it."""
    diagram = build_search_diagram(
        scenario(), heap=tiny_heap, meshcat=start_meshcat()
    )
    record, meshcat = record_search(diagram)
    return record, meshcat.StaticHtml()


def test_the_page_shows_each_decision_in_its_time(
    recording: tuple[SearchRecord, str],
) -> None:
    record, page = recording
    assert record.num_actions == HORIZON
    drawn = {m.get("path") for m in messages(page)}
    animated = tracks(page)
    ends = [0.0]
    for step in range(1, HORIZON + 1):
        for layer in SEARCH_LAYERS:
            path = f"/inspect/{layer.name}/step_{step:02d}"
            assert {path, f"{path}/outline"} & drawn
            keys = animated[path, ".visible"]
            shown = [time for time, value in keys if value]
            hidden = [time for time, value in keys if not value]
            # Once it appears, it goes when the gripper has arrived, and before
            # that it is not there.
            assert len(shown) == 1
            arrival = shown[0] + scenario().gripper.quasi_static.approach_time
            gone = min(time for time in hidden if time > shown[0])
            assert gone == pytest.approx(arrival, abs=0.05)
            if step > 1:
                assert min(hidden) == 0
                assert shown[0] >= ends[step - 1]
        ends.append(max(hidden))
    # What only truth knows is not shown.
    assert not any(path and "silhouette/" in path for path in drawn)


def test_the_page_plays_the_motion(
    recording: tuple[SearchRecord, str],
) -> None:
    record, page = recording
    animated = tracks(page)
    moved = {
        path
        for (path, name), keys in animated.items()
        if name == ".position" and len({tuple(value) for _, value in keys}) > 5
    }
    assert any("drawn" in path for path in moved)
    assert any(record.actions[0].object in path for path in moved)
    # The page stands alone: it holds the viewer, and the scene's geometry.
    assert page.lstrip().startswith("<!DOCTYPE html>")
    assert len(page) > 1_000_000
    assert 'src="http' not in page


def test_recording_does_not_change_the_search(
    recording: tuple[SearchRecord, str], tiny_heap: Heap
) -> None:
    record, _ = recording
    plain = run_search(build_search_diagram(scenario(), heap=tiny_heap))

    def comparable(record: SearchRecord) -> dict:
        result = record.to_dict()
        for action in result["actions"]:
            del action["seconds"]
        return result

    assert comparable(plain) == comparable(record)


def test_a_search_that_fails_leaves_what_was_recorded(tiny_heap: Heap) -> None:
    class Failing:
        def decided(self, *_: object) -> None:
            raise RuntimeError("by the test")

        def ended(self, *_: object) -> None:
            pass

    meshcat = start_meshcat()
    diagram = build_search_diagram(scenario(), heap=tiny_heap, meshcat=meshcat)
    with pytest.raises(RuntimeError, match="by the test"):
        record_search(diagram, observers=(Failing(),))
    assert ("/inspect/grasp/step_01", ".visible") in tracks(
        meshcat.StaticHtml()
    )


def test_a_diagram_without_meshcat_cannot_be_recorded(
    tiny_diagram: SearchDiagram,
) -> None:
    with pytest.raises(ValueError, match="start_meshcat"):
        record_search(tiny_diagram)


def test_a_decision_is_shown_live_until_its_action_ends(
    meshcat: Meshcat, tiny_diagram: SearchDiagram
) -> None:
    context = tiny_diagram.CreateDefaultContext()
    drawing = SearchDrawing(meshcat)
    X_WG = np.diag([1.0, -1.0, -1.0, 1.0])

    def visible(step: int) -> list[bool]:
        return [
            prop(meshcat, f"/inspect/{layer.name}/step_{step:02d}", "visible")
            for layer in SEARCH_LAYERS
        ]

    for number, name in enumerate(("book", "book", "plank"), 1):
        grasp = Grasp(GraspKind.JAW, name, X_WG, width=0.02)
        drawing.decided(tiny_diagram, context, SearchAction(number, grasp))
        assert all(visible(number))
        assert number == 1 or not any(visible(number - 1))
    drawing.ended(
        tiny_diagram, context, ActionRecord(3, "plank", False, Grasp())
    )
    assert not any(visible(3))
    # The outline is that of the object chosen.
    first, second, third = (
        vertices(meshcat, f"/inspect/grasp/step_{k:02d}/outline").tolist()
        for k in (1, 2, 3)
    )
    assert first == second != third
    # Without a grasp there is still the distribution; the next search begins
    # without the layers of the one before.
    SearchDrawing(meshcat).decided(tiny_diagram, context, SearchAction(1))
    assert meshcat.HasPath("/inspect/occupancy/step_01")
    assert not meshcat.HasPath("/inspect/grasp/step_01/outline")
    assert not meshcat.HasPath("/inspect/occupancy/step_02")
