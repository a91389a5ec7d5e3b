import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from xray_drake.benchmark.records import ROLLOUTS, SCENARIO, shared_scenario
from xray_drake.inspector import replay as module
from xray_drake.inspector.replay import (
    RecordedRollout,
    Replay,
    difference,
    load_rollout,
    remake_heap,
    replay_search,
)
from xray_drake.messages import Outcome
from xray_drake.scene.heap import Heap
from xray_drake.search.diagram import build_search_diagram
from xray_drake.search.monitor import SearchMonitor
from xray_drake.search.record import write_record
from xray_drake.station.scenario import dump_scenario
from xray_drake.testing.tiny import make_tiny_scenario

Write = Callable[..., Path]


@pytest.fixture
def record(replay: Replay) -> dict[str, Any]:
    return copy.deepcopy(replay.record.to_dict())


@pytest.fixture
def written(tmp_path: Path) -> Write:
    """Writes records: one as JSON, several as a benchmark does."""

    def write(*records: dict[str, Any]) -> Path:
        path = tmp_path / ("search.json" if len(records) == 1 else ROLLOUTS)
        path.write_text("".join(json.dumps(r) + "\n" for r in records))
        return path

    return write


def test_a_record_can_be_replayed(
    replay: Replay, tiny_heap: Heap, tmp_path: Path
) -> None:
    path = tmp_path / "search.json"
    write_record(replay.record, path)
    rollout = load_rollout(path)
    assert dump_scenario(rollout.scenario) == dump_scenario(replay.scenario)
    shares: list[float] = []
    again = replay_search(rollout.scenario, tiny_heap, progress=shares.append)
    assert again.ended
    assert shares == [0.5, 1.0]
    assert difference(rollout.record, again.record) == ""
    first, _ = again.snapshots
    assert first.action.grasp.object == rollout.record["actions"][0]["object"]


def test_a_first_decision_is_that_of_the_whole_search(
    replay: Replay, looked_at: Replay
) -> None:
    assert not looked_at.ended
    (shot,) = looked_at.snapshots
    assert shot.poses_after is None
    (action,) = looked_at.record.actions
    assert action.outcome is Outcome.NONE
    assert action.object == replay.record.actions[0].object


def test_which_of_a_benchmark(record: dict[str, Any], written: Write) -> None:
    path = written(
        record | {"policy": "random", "seed": 3},
        record | {"policy": "largest", "seed": 3},
        record | {"policy": "largest", "seed": 4},
    )
    for place in (path, path.parent):
        assert load_rollout(place).record["policy"] == "random"
        assert load_rollout(place, index=2).record["seed"] == 4
        chosen = load_rollout(place, policy="largest").record
        assert (chosen["policy"], chosen["seed"]) == ("largest", 3)
        assert load_rollout(place, seed=4).record["policy"] == "largest"
    for choice, words in (
        ({"index": 3}, r"no rollout 3: there are 3, from 0"),
        ({"index": -1}, r"no rollout -1"),
        ({"policy": "xray"}, r"of policy xray; policies: largest, random"),
        ({"policy": "random", "seed": 4}, r"policy random, seed 4.*3 to 4"),
        ({"index": 0, "seed": 4}, r"of number 0, seed 4"),
    ):
        with pytest.raises(ValueError, match=words):
            load_rollout(path, **choice)


def test_paths_of_a_record_are_relative_to_it(
    record: dict[str, Any], written: Write
) -> None:
    record["scenario"] = "scene: {meshes: [in, /out]}"
    path = written(record)
    found = load_rollout(path).scenario.scene.meshes
    assert found == [f"{path.parent}/in", "/out"]


def test_a_record_holds_absolute_paths(
    tiny_heap: Heap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    scenario = make_tiny_scenario()
    scenario.scene.meshes = ["in"]
    diagram = build_search_diagram(scenario, heap=tiny_heap)
    record = SearchMonitor(diagram).record
    assert f"{tmp_path}/in" in record.scenario


def test_an_old_benchmark_has_its_scenario_beside_it(
    record: dict[str, Any], written: Write, replay: Replay
) -> None:
    del record["scenario"]
    path = written(record, record | {"policy": "xray"})
    (path.parent / SCENARIO).write_text(shared_scenario(replay.scenario))
    first = load_rollout(path).scenario
    assert dump_scenario(first) == dump_scenario(replay.scenario)
    assert load_rollout(path, index=1).scenario.policy.name == "xray"
    # Still older ones had no choice of what goes first.
    del record["target_first"]
    path = written(record, record)
    assert load_rollout(path).scenario.policy.target_first


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"{", "is not JSON"),
        (b"\xff\xfe", "is not JSON"),
        (b"[1, 2]", "is no record of a rollout"),
        (b'{"version": 2}', "is no record of a rollout"),
        ({"scenario": ""}, r"search --seed 7 … --json"),
        ({"scenario": "horizn: 3"}, "did you mean"),
        ({"policy": "agent"}, "is an agent's"),
    ],
)
def test_what_is_no_record(
    content: bytes | dict[str, str],
    words: str,
    record: dict[str, Any],
    tmp_path: Path,
) -> None:
    """An old one does not say its scenario; an agent cannot be asked again."""
    if isinstance(content, dict):
        content = json.dumps(record | content).encode()
    path = tmp_path / "x.json"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=words) as caught:
        load_rollout(path)
    assert "x.json" in str(caught.value)


def test_what_cannot_be_shown(
    record: dict[str, Any], written: Write, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match=r"no file .*nowhere\.json"):
        load_rollout(tmp_path / "nowhere.json")
    with pytest.raises(ValueError, match="holds one rollout"):
        load_rollout(written(record), index=0)
    (tmp_path / ROLLOUTS).write_text("")
    with pytest.raises(ValueError, match="holds no rollouts"):
        load_rollout(tmp_path)
    failed = {"policy": "xray", "target": "lid", "seed": 1, "end": "error"}
    failed["reason"] = "NaN"
    with pytest.raises(ValueError, match=r"ended with an error.*NaN"):
        load_rollout(written(failed, failed))


def test_a_heap_that_comes_out_otherwise(
    record: dict[str, Any],
    replay: Replay,
    tiny_heap: Heap,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "make_heap", lambda *_, **__: tiny_heap)
    rollout = RecordedRollout(record, replay.scenario, "old.json")
    assert remake_heap(rollout) is tiny_heap
    record["objects"] = [*record["objects"], "cup"]
    record["versions"]["drake"] = "1.40.0"
    with pytest.raises(
        ValueError, match=r"old\.json.*drake 1\.40\.0, now .*inspect --seed 7"
    ):
        remake_heap(rollout)


def test_where_a_replay_differs(record: dict[str, Any], replay: Replay) -> None:
    assert difference(record, replay.record) == ""
    other = copy.deepcopy(record)
    other["actions"][1]["object"] = "cup"
    other["versions"]["xray_drake"] = "0.0.1"
    said = difference(other, replay.record)
    assert "from step 2 on" in said
    assert "not cup" in said
    assert "xray_drake 0.0.1, now" in said
    del other["actions"][1]
    assert "took 2 actions, not 1" in difference(other, replay.record)
    # What was stopped goes on here.
    assert difference(other | {"end": "interrupted"}, replay.record) == ""
