import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import cv2
import pytest

from tests.cli.running import complaint, output
from tests.disk import full_disk

SMALL = """\
name: small
seed: 5
horizon: 2
scene: {num_objects: 3}
policy: {name: largest, target_first: false}
"""
"""Several actions: the largest of three objects goes first."""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    path = tmp_path / "small.yaml"
    path.write_text(SMALL, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ("--policy greedy", ["policy.name", "greedy", "largest"]),
        ("--target box_11to1", ["scene.target", "box_11to1", "domino"]),
        ("--execution magic", ["gripper.execution", "magic"]),
        ("--grasps magic", ["gripper.grasps", "magic"]),
        ("--occupancy magic", ["perception.occupancy", "magic"]),
        ("--detector magic", ["perception.detector", "magic"]),
        ("--segmenter depth", ["segmenter is depth", "grasps: depth"]),
        ("--scenario dmeo", ["dmeo", "demo"]),
        ("--scenario no/such.yaml", ["no/such.yaml"]),
        ("--scenario bad.yaml", ["bad.yaml", "scene.targt", "scene.target"]),
        ("--meshes missing", ["missing"]),
        ("--meshes empty", ["empty"]),
        ("--meshes broken", ["broken"]),
        ("--html nowhere/f.html", ["nowhere does not exist"]),
        ("--json nowhere/f.json", ["nowhere does not exist"]),
        ("--film-strip nowhere/f.png", ["nowhere does not exist"]),
        ("--film-strip film.mp4", ["film.mp4", ".png"]),
        ("--meshcat --film-strip film.png", ["--film-strip"]),
        ("--meshcat --html a.html", ["--html", "leave out --meshcat"]),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(
    options: str,
    named: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("bad.yaml").write_text("scene: {targt: domino}\n", encoding="utf-8")
    Path("empty").mkdir()
    Path("broken").mkdir()
    Path("broken/a.obj").write_text("this is no mesh\n", encoding="utf-8")
    before = sorted(tmp_path.rglob("*"))
    line = complaint("search", options)
    assert all(word in line for word in named)
    assert sorted(tmp_path.rglob("*")) == before


def test_a_search_is_told_and_recorded(small: Path, tmp_path: Path) -> None:
    """Here the horizon ends it before the target is out."""
    json_path, html_path = tmp_path / "a.json", tmp_path / "a.html"
    film_path = tmp_path / "a.png"
    out = output(
        f"search --scenario {small} --json {json_path} --html {html_path}",
        f"--film-strip {film_path}",
    )
    record = json.loads(json_path.read_text(encoding="utf-8"))
    assert record["num_actions"] == len(record["actions"]) <= 2
    assert (record["seed"], record["policy"]) == (5, "largest")
    assert len(record["objects"]) == 3
    actions = record["actions"]
    for step, action in enumerate(actions, 1):
        # One line per action.
        (line,) = re.findall(rf"^ *{step}  .*$", out, re.MULTILINE)
        assert action["outcome"] in line
        what = "the target" if action["is_target"] else action["object"]
        assert what in line
        first = action["ranking"][0]
        assert f"ranked: {first['object']} {first['score']:.4g}" in out
        # What was passed over for the same reason is told in one line.
        names: dict[str, list[str]] = {}
        for candidate in action["ranking"]:
            names.setdefault(candidate["passed_over"], []).append(
                candidate["object"]
            )
        for why, (name, *others) in names.items():
            more = f" and {len(others)} more" if others else ""
            assert not why or f"over {name}{more}: {why}" in out
    assert f"{len(actions)} of 2" in out
    assert record["end"] in out
    assert str(json_path) in out.replace("\n", "")
    assert "<html" in html_path.read_text(encoding="utf-8")
    # Frames beside each other, 3 inches each at 80 pixels.
    assert cv2.imread(str(film_path)).shape[1] == 240 * len(actions)
    assert {*tmp_path.iterdir()} == {json_path, html_path, film_path, small}


def test_a_full_disk_is_one_line(small: Path, tmp_path: Path) -> None:
    path = tmp_path / "record.json"
    path.write_text("old", encoding="utf-8")
    options = f"--scenario {small} --num-objects 1 --json {path}"
    with full_disk(500):
        line = complaint("search", options, code=1)
    assert "too large" in line.lower()
    assert path.read_text(encoding="utf-8") == "old"
    assert {*tmp_path.iterdir()} == {path, small}


def test_ctrl_c_leaves_the_record_so_far(small: Path, tmp_path: Path) -> None:
    path = tmp_path / "record.json"
    # A shell's background jobs ignore Ctrl-C; this one does not.
    script = (
        "import signal\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from xray_drake.cli.main import app\n"
        "app()\n"
    )
    options = f"search --scenario {small} --horizon 10 --json {path}".split()
    process = subprocess.Popen(
        [sys.executable, "-c", script, *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        encoding="utf-8",
    )
    try:
        assert process.stdout is not None
        for line in process.stdout:
            if line.startswith(" 1  "):
                break
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert "interrupted" in out
    record = json.loads(path.read_text(encoding="utf-8"))
    assert record["end"] == "interrupted"
    assert 1 <= record["num_actions"] < 10
