import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from xray_drake.benchmark.report import table
from xray_drake.benchmark.rollouts import ROLLOUTS, SCENARIO
from xray_drake.cli.main import app
from xray_drake.station.scenario import dump_scenario, load_scenario


def benchmark(*arguments: object) -> tuple[int, str, str]:
    """Returns exit status, standard output and standard error."""
    result = CliRunner().invoke(app, ["benchmark", *map(str, arguments)])
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout, result.stderr


def record(seed: int, policy: str, num_actions: int) -> dict:
    return {
        "seed": seed,
        "policy": policy,
        "end": "success" if num_actions < 10 else "horizon",
        "success": num_actions < 10,
        "num_actions": num_actions,
        "start": {"target_visible_fraction": 0.0, "target_tilt_deg": 0.0},
        "actions": [{"true_mask_in_support": 1.0}],
    }


@pytest.fixture
def done(tmp_path: Path) -> Path:
    """A folder of a benchmark that is done, as workers left it."""
    folder = tmp_path / "done"
    folder.mkdir()
    records = [
        record(31, "xray", 3),
        record(30, "largest", 10),
        record(31, "largest", 6),
        record(30, "xray", 4),
        record(99, "xray", 10),
    ]
    lines = [json.dumps(item) + "\n" for item in records]
    (folder / ROLLOUTS).write_text("".join(lines), encoding="utf-8")
    text = dump_scenario(load_scenario("demo"))
    (folder / SCENARIO).write_text(text, encoding="utf-8")
    return folder


ASKED = ("--heaps", 2, "--seed", 30, "--policies", "largest, xray")


def test_the_table_is_of_what_was_asked_for(done: Path) -> None:
    code, out, err = benchmark("--out", done, *ASKED)
    assert (code, err) == (0, "")
    expected = table(
        [
            record(30, "largest", 10),
            record(31, "largest", 6),
            record(30, "xray", 4),
            record(31, "xray", 3),
        ]
    )
    assert expected in out
    assert (done / "table.md").read_text(encoding="utf-8") == expected + "\n"


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("--policies", "xray,greedy"), "greedy"),
        (("--scenario", "dmeo"), "dmeo"),
        (("--target", "brick"), "brick"),
        (("--horizon", "0"), "horizon"),
    ],
)
def test_bad_input_is_one_line(
    arguments: tuple[str, ...], named: str, tmp_path: Path
) -> None:
    folder = tmp_path / "out"
    code, out, err = benchmark("--out", folder, "--heaps", 1, *arguments)
    assert (code, out) == (2, "")
    (line,) = err.splitlines()
    assert line.startswith("xray-drake: ")
    assert named in line
    assert not folder.exists()


def test_rollouts_of_another_scenario_are_left_alone(done: Path) -> None:
    before = (done / SCENARIO).read_bytes()
    code, _, err = benchmark("--out", done, *ASKED, "--target", "lid")
    assert code == 2
    (line,) = err.splitlines()
    assert str(done) in line
    assert (done / SCENARIO).read_bytes() == before
    assert not (done / "table.md").exists()


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text("not a folder", encoding="utf-8")
    code, _, err = benchmark("--out", path / "folder", "--heaps", 1)
    assert code == 1
    (line,) = err.splitlines()
    assert str(path) in line
