import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.benchmark.synthetic import record, write_folder
from tests.cli.running import answer, complaint, output
from xray_drake.benchmark.comparison import make_report
from xray_drake.benchmark.records import ROLLOUTS, SCENARIO, Collection
from xray_drake.benchmark.report import success_table
from xray_drake.benchmark.variants import Variant
from xray_drake.cli import benchmark as module
from xray_drake.provenance import (
    MANIFEST,
    Run,
    current,
    read_runs,
    record_run,
)
from xray_drake.station.scenario import Scenario


@pytest.fixture
def done(tmp_path: Path) -> Path:
    """A folder of a benchmark that is done, as workers left it."""
    return write_folder(
        tmp_path / "done",
        [
            record("xray", 31, 3),
            record("largest", 30, 10, "horizon"),
            record("largest", 31, 6),
            record("xray", 30, 4),
            record("xray", 99, 10, "horizon"),
        ],
    )


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Runs nothing, and notes what should be run."""
    seen: dict[str, Any] = {}

    def run(
        scenario: Scenario, *, folder: Path, **arguments: Any
    ) -> Iterator[dict]:
        seen.update(scenario=scenario, **arguments)
        write_folder(folder, [record("random", 0)])
        return iter(())

    monkeypatch.setattr(module, "run_rollouts", run)
    return seen


ASKED = "--heaps 2 --seed 30 --policies 'largest, xray' --occupancy geometric"


def test_the_table_is_of_what_was_asked_for(done: Path) -> None:
    out = output("benchmark --out", done, ASKED)
    records = [
        record("largest", 30, 10, "horizon"),
        record("largest", 31, 6),
        record("xray", 30, 4),
        record("xray", 31, 3),
    ]
    expected = success_table(make_report(Collection(records, "demo")))
    assert "\n".join(expected) in out
    assert f"xray-drake report {done}" in out


def test_targets_in_full_view_are_not_an_error(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "a", [record("random", 0, visible=0.99)])
    out = output(f"benchmark --out {folder} --heaps 1 --policies random")
    assert "there is nothing to report" in out


def test_options_reach_the_rollouts(
    tmp_path: Path, asked: dict[str, Any]
) -> None:
    output(
        f"benchmark --out {tmp_path}/a --scenario table2 --target lid",
        "--policies random,xray --occupancy 'posterior, exact'",
        "--num-objects 7 --horizon 4 --execution contact --grasps models",
        "--detector ground_truth --segmenter ground_truth --no-target-first",
        "--seed 20 --heaps 3 --workers 5",
    )
    scenario = asked["scenario"]
    assert (scenario.name, scenario.horizon) == ("table2", 4)
    assert scenario.scene.target == "lid"
    assert scenario.scene.num_objects == 7
    assert scenario.gripper.execution == "contact"
    # What blind policies are recorded with.
    assert scenario.perception.occupancy == "posterior"
    assert asked["variants"] == (
        Variant("random", "", False),
        Variant("xray", "posterior", False),
        Variant("xray", "geometric", False),
    )
    assert list(asked["seeds"]) == [20, 21, 22]
    assert asked["workers"] == 5


def test_the_scenario_decides_what_is_not_said(
    tmp_path: Path, asked: dict[str, Any]
) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(
        "policy: {target_first: false}\nperception: {occupancy: posterior}\n"
        "scene: {random_number: {mean: 12}}\n",
        encoding="utf-8",
    )
    options = f"benchmark --scenario {path} --out {tmp_path}"
    answer(f"{options}/a --policies xray")
    assert asked["variants"] == (Variant("xray", "posterior", False),)
    assert asked["scenario"].scene.random_number.mean == 12
    answer(f"{options}/b --num-objects 3")
    assert asked["scenario"].scene.random_number.mean == 0


def test_meshes_are_imported_once_before_the_rollouts(
    tmp_path: Path, asked: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    imported: list[tuple[Sequence[str], float, int]] = []
    monkeypatch.setattr(
        module,
        "imported_objects",
        lambda scenario, *, workers: imported.append(
            (scenario.scene.meshes, scenario.scene.mesh_scale, workers)
        ),
    )
    output(
        f"benchmark --out {tmp_path}/a --meshes one --meshes two",
        "--scale 0.001 --workers 3",
    )
    assert imported == [(["one", "two"], 0.001, 3)]
    assert asked["scenario"].scene.meshes == ["one", "two"]


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ("--policies xray,greedy", "greedy"),
        ("--policies ,", "--policies"),
        ("--occupancy geometric,guess", "guess"),
        ("--policies random --occupancy guess", "guess"),
        ("--scenario dmeo", "dmeo"),
        ("--target brick", "brick"),
        ("--meshes nowhere", "nowhere"),
    ],
)
def test_bad_input_is_one_line(
    arguments: str, named: str, tmp_path: Path
) -> None:
    folder = tmp_path / "out"
    line = complaint(f"benchmark --out {folder} --heaps 1", arguments)
    assert named in line
    assert not folder.exists()


@pytest.mark.parametrize("other", ["--target lid", "--no-resume"])
def test_rollouts_are_not_gone_on_with_by_another_scenario_or_against_the_will(
    other: str, done: Path
) -> None:
    paths = done / ROLLOUTS, done / SCENARIO
    before = [path.read_bytes() for path in paths]
    line = complaint("benchmark --out", done, ASKED, other)
    assert str(done) in line
    assert [path.read_bytes() for path in paths] == before
    assert answer("benchmark --out", done, ASKED, "--resume")[0] == 0


@pytest.mark.parametrize(
    ("where", "field", "value", "named"),
    [
        (ROLLOUTS, "code", "0123", "code 0123"),
        (MANIFEST, "code", "0123", "code 0123"),
        (ROLLOUTS, "weights", {"n": "01"}, "weights n 01, now windowed"),
        (MANIFEST, "dtype", "float16", "float16, now float32"),
    ],
)
def test_other_code_does_not_go_on(
    where: str, field: str, value: object, named: str, tmp_path: Path
) -> None:
    change = {field: value}
    own = change if where == ROLLOUTS else {}
    folder = write_folder(tmp_path / "a", [record("xray", 30, **own)])
    if where == MANIFEST:
        record_run(folder, Run("benchmark", replace(current(), **change)))
    before = (folder / ROLLOUTS).read_bytes()
    line = complaint(
        f"benchmark --out {folder} --heaps 1 --seed 30 --policies xray",
        "--occupancy learned" if field != "code" else "",
    )
    assert named in line
    assert "--mix" in line
    assert (folder / ROLLOUTS).read_bytes() == before


def test_mixed_rollouts_are_called_so(
    done: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with (done / ROLLOUTS).open("a") as file:
        old = record("largest", 32, code="0123")
        file.write(json.dumps(old) + "\n")
    command = f"benchmark --out {done} {ASKED} --heaps 3"
    assert "code 0123" in complaint(command)
    monkeypatch.setattr(
        "xray_drake.benchmark.rollouts._run_jobs",
        lambda jobs, workers: iter([record("xray", 32)]),
    )
    code, out, _ = answer(command, "--mix")
    assert code == 0
    assert "**Mixed**: code 0123" in out
    assert answer("report", done)[1].count("**Mixed**") == 1
    assert (done / "report.md").read_text().count("**Mixed**") == 7
    (_, run) = read_runs(done)
    assert run["seeds"] == [30, 31, 32]


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ('{"policy": "xr', "line 2 cannot be read"),
        ('{"policy": "xray"}', "record 2 is no rollout: it lacks target"),
        (
            json.dumps(record("xray", 30, scenario="seed: 30\nhorizon: 3\n")),
            "record 2 is of another scenario",
        ),
        (
            json.dumps(record("xray", 30, scenario="seed: 31\n")),
            "another seed than 30",
        ),
    ],
)
def test_a_line_that_does_not_belong_is_named_and_stays(
    line: str, named: str, done: Path
) -> None:
    path = done / ROLLOUTS
    first, *others = path.read_text().splitlines()
    path.write_text("\n".join([first, line, *others]) + "\n")
    before = path.read_bytes()
    assert named in complaint("benchmark --out", done, ASKED)
    assert named in complaint("report", done)
    assert path.read_bytes() == before


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text("not a folder", encoding="utf-8")
    line = complaint(f"benchmark --out {path}/folder --heaps 1", code=1)
    assert str(path) in line
