"""``xray-drake inspect`` of heaps and rollouts; of datasets: test_dataset."""

import json
from functools import partial
from pathlib import Path

import pytest

from tests.cli import running
from xray_drake.cli import inspect_search as module
from xray_drake.cli.inspect import kind_of

SMALL = """\
name: small
seed: 5
horizon: 2
scene: {num_objects: 2}
policy: {name: largest, target_first: false}
perception: {occupancy: exact}
"""


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scenarios") / "small.yaml"
    path.write_text(SMALL, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def recorded(small: Path) -> Path:
    """What ``search --json`` has written."""
    path = small.parent / "search.json"
    running.output("search", "--scenario", small, "--json", path)
    return path


inspect = partial(running.answer, "inspect")
complaint = partial(running.complaint, "inspect")


def test_what_is_inspected(tmp_path: Path) -> None:
    assert kind_of(None) == "heap"
    assert kind_of(tmp_path) == "dataset"
    with pytest.raises(ValueError, match=r"no file or folder .*nowhere\.jsn"):
        kind_of(tmp_path / "nowhere.jsn")
    for name in ("a.json", "b.jsonl"):
        (tmp_path / name).touch()
        assert kind_of(tmp_path / name) == "rollout"
    (tmp_path / "rollouts.jsonl").touch()
    assert kind_of(tmp_path) == "rollout"


def test_a_recorded_search_as_a_page(recorded: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    code, out, err = inspect(recorded, "--html", page, "--opacity", 0.5)
    assert (code, err) == (0, "")
    # The replay is the same as the record, or it would have said so.
    assert out.split() == ["wrote", str(page)]
    text = page.read_text(encoding="utf-8")
    assert len(text) > 1_000_000
    assert text.lstrip().startswith("<!DOCTYPE html>")


def test_a_rollout_of_a_benchmark_live(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record = json.loads(recorded.read_text(encoding="utf-8"))
    lines = [record | {"policy": "random"}, record]
    (tmp_path / "rollouts.jsonl").write_text(
        "".join(json.dumps(line) + "\n" for line in lines)
    )
    steps = []
    monkeypatch.setattr(
        module.InspectorPage, "loop", lambda self: steps.append(self.view.step)
    )
    code, out, err = inspect(tmp_path, "--rollout", 1, "--step", 2)
    assert (code, err) == (0, "")
    assert steps == [2]
    assert "open http://localhost:" in out
    assert "step 2 of 2, largest: " in out

    # Made by another version, it may go otherwise; that is said.
    record["actions"][1]["object"] = "cup"
    record["versions"]["drake"] = "1.40.0"
    path = tmp_path / "old.json"
    path.write_text(json.dumps(record))
    code, out, err = inspect(path)
    assert code == 0
    (line,) = [line for line in out.splitlines() if "differs" in line]
    assert "from step 2 on" in line
    assert "drake 1.40.0, now" in line


def test_a_heap(
    small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = tmp_path / "heap.html"
    shown = []
    monkeypatch.setattr(
        module.InspectorPage,
        "loop",
        lambda self: shown.append(self.view.replay),
    )
    code, out, err = inspect(
        *("--scenario", small, "--seed", 6, "--target", "lid"),
        *("--num-objects", 1, "--policy", "xray", "--html", page, "--meshcat"),
    )
    assert (code, err) == (0, "")
    (replay,) = shown
    assert replay.heap.seed == 6
    assert replay.heap.target.name == "lid"
    assert replay.record.policy == "xray"
    assert len(replay.heap.objects) == 1
    assert not replay.ended
    assert page.is_file()
    assert "step 1, xray: " in out


def test_bad_input_is_one_line(recorded: Path, tmp_path: Path) -> None:
    assert "no file" in complaint(tmp_path / "nowhere.json")
    assert "--samples is for a dataset, and this is a heap" in complaint(
        "--samples", 3
    )
    assert "--rollout is for a rollout, and this is a heap" in complaint(
        "--rollout", 3
    )
    assert "--step is for a rollout, and this is a dataset" in complaint(
        tmp_path, "--step", 3
    )
    assert "--scenario is for a heap, and this is a rollout" in complaint(
        recorded, "--scenario", "demo"
    )
    assert "no step 9: the rollout has 2, and 3 is its end" in complaint(
        recorded, "--step", 9
    )
    assert "holds one rollout" in complaint(recorded, "--rollout", 0)
    assert "--target once" in complaint("--target", "lid", "--target", "flute")
    assert "nowhere" in complaint("--scenario", "nowhere")
    assert "is a folder" in complaint(recorded, "--html", tmp_path)
    assert "does not exist" in complaint(
        recorded, "--html", tmp_path / "no" / "x.html"
    )
    old = json.loads(recorded.read_text(encoding="utf-8"))
    del old["scenario"]
    path = tmp_path / "old.json"
    path.write_text(json.dumps(old))
    assert "does not hold its scenario" in complaint(path)
