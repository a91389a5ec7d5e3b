"""``xray-drake inspect`` of heaps and rollouts; of datasets: test_dataset."""

import json
from pathlib import Path

import pytest

from tests.cli.running import complaint, output
from xray_drake.cli import inspect_search as module

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
    output(f"search --scenario {small} --json {path}")
    return path


def test_a_recorded_search_as_a_page(recorded: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    out = output(f"inspect {recorded} --html {page} --opacity 0.5")
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
    out = output(f"inspect {tmp_path} --rollout 1 --step 2")
    assert steps == [2]
    assert "open http://localhost:" in out
    assert "step 2 of 2, largest: " in out

    # Made by another version, it may go otherwise; that is said.
    record["actions"][1]["object"] = "cup"
    record["versions"]["drake"] = "1.40.0"
    path = tmp_path / "old.jsonl"
    path.write_text(json.dumps(record) + "\n")
    told = output("inspect", path).splitlines()
    (line,) = [line for line in told if "differs" in line]
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
    out = output(
        f"inspect --scenario {small} --seed 6 --target lid --num-objects 1",
        f"--policy xray --html {page} --meshcat",
    )
    (replay,) = shown
    assert replay.heap.seed == 6
    assert replay.heap.target.name == "lid"
    assert replay.record.policy == "xray"
    assert len(replay.heap.objects) == 1
    assert not replay.ended
    assert page.is_file()
    assert "step 1, xray: " in out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("{here}/nowhere.json", "no file"),
        ("--samples 3", "--samples is for a dataset, and this is a heap"),
        ("--rollout 3", "--rollout is for a rollout, and this is a heap"),
        ("{here} --step 3", "--step is for a rollout, and this is a dataset"),
        (
            "{it} --scenario demo",
            "--scenario is for a heap, and this is a roll",
        ),
        ("{it} --step 9", "no step 9: the rollout has 2, and 3 is its end"),
        ("{it} --rollout 0", "holds one rollout"),
        ("--target lid --target flute", "--target once"),
        ("--scenario nowhere", "nowhere"),
        ("{it} --html {here}", "is a folder"),
        ("{it} --html {here}/no/x.html", "does not exist"),
    ],
)
def test_bad_input_is_one_line(
    words: str, said: str, recorded: Path, tmp_path: Path
) -> None:
    line = words.format(it=recorded, here=tmp_path)
    assert said in complaint("inspect", line)
