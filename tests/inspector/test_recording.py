import base64
import re
from pathlib import Path

import pytest
import umsgpack

from xray_drake.drawing.meshcat_layers import start_meshcat
from xray_drake.inspector.recording import record_search, write_html
from xray_drake.scene.heap import Heap
from xray_drake.search.diagram import SearchDiagram, build_search_diagram
from xray_drake.search.record import SearchRecord
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


def messages(page: str) -> list[dict]:
    """Returns what the page tells its viewer, but for binary assets."""
    packed = re.findall(r"octet-binary;base64,([A-Za-z0-9+/=]+)", page)
    return [umsgpack.unpackb(base64.b64decode(text)) for text in packed]


def tracks(page: str) -> dict[tuple[str, str], list[dict]]:
    """Returns the keys of the animation by path and property; times in s."""
    (animation,) = [
        message
        for message in messages(page)
        if message.get("type") == "set_animation"
    ]
    return {
        (item["path"], track["name"]): [
            key | {"time": key["time"] / item["clip"]["fps"]}
            for key in track["keys"]
        ]
        for item in animation["animations"]
        for track in item["clip"]["tracks"]
    }


def test_the_page_shows_each_decision_in_its_time(
    recording: tuple[SearchRecord, str],
) -> None:
    record, page = recording
    assert record.num_actions == HORIZON
    drawn = {m.get("path") for m in messages(page)}
    animated = tracks(page)
    ends = []
    for step in range(1, HORIZON + 1):
        path = f"/search/step_{step:02d}"
        for layer in ("occupancy", "outline"):
            assert f"{path}/{layer}" in drawn
        keys = animated[path, ".visible"]
        shown = [key["time"] for key in keys if key["value"]]
        hidden = [key["time"] for key in keys if not key["value"]]
        # Once it appears, it goes when the gripper has arrived, and before
        # that it is not there.
        assert len(shown) == 1
        arrival = shown[0] + scenario().gripper.quasi_static.approach_time
        gone = min(time for time in hidden if time > shown[0])
        assert gone == pytest.approx(arrival, abs=0.05)
        if step > 1:
            assert min(hidden) == 0
            assert shown[0] >= ends[-1]
        ends.append(max(hidden))


def test_the_page_plays_the_motion(
    recording: tuple[SearchRecord, str],
) -> None:
    record, page = recording
    animated = tracks(page)
    moved = {
        path
        for (path, name), keys in animated.items()
        if name == ".position"
        and len({tuple(key["value"]) for key in keys}) > 5
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
    assert ("/search/step_01", ".visible") in tracks(meshcat.StaticHtml())


def test_a_diagram_without_meshcat_cannot_be_recorded(
    tiny_diagram: SearchDiagram,
) -> None:
    with pytest.raises(ValueError, match="start_meshcat"):
        record_search(tiny_diagram)


def test_the_page_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    meshcat = start_meshcat()
    write_html(meshcat, tmp_path / "page.html")
    assert "meshcat" in (tmp_path / "page.html").read_text(encoding="utf-8")
    with pytest.raises(OSError, match="folder"):
        write_html(meshcat, tmp_path / "no folder" / "page.html")
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]
