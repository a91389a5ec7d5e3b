from functools import partial
from pathlib import Path

import pytest

from tests.benchmark.synthetic import record, write_folder
from tests.cli.running import answer, complaint
from xray_drake.benchmark.comparison import make_report
from xray_drake.benchmark.records import collect
from xray_drake.benchmark.report import markdown, success_table

report = partial(answer, "report")


@pytest.fixture
def one(tmp_path: Path) -> Path:
    return write_folder(
        tmp_path / "one", [record("xray", 0, 3), record("random", 0, 9)]
    )


@pytest.fixture
def two(tmp_path: Path) -> Path:
    return write_folder(
        tmp_path / "two", [record("xray", 0, 5), record("xray", 1, 4)]
    )


def test_it_is_written_beside_the_rollouts(one: Path) -> None:
    code, out, err = report(one)
    assert (code, err) == (0, "")
    made = make_report(collect([one]))
    assert "\n".join(success_table(made)) in out
    assert (one / "report.md").read_text(encoding="utf-8") == markdown(made)
    for name in ("report.md", "report.csv", "actions.png", "success.png"):
        assert (one / name).stat().st_size > 0
        assert f"wrote {one / name}" in out


def test_folders_are_merged_into_another(
    one: Path, two: Path, tmp_path: Path
) -> None:
    out_folder = tmp_path / "new" / "out"
    line = complaint("report", one, two, "--out", out_folder, code=0)
    assert line.startswith("xray-drake: repeated rollouts, left out: 1 ")
    text = (out_folder / "report.md").read_text(encoding="utf-8")
    assert "3 rollouts on 2 heaps" in text
    assert not (one / "report.md").exists()


def test_what_does_not_belong_together_is_one_line(
    one: Path, two: Path
) -> None:
    (two / "scenario.yaml").write_text("horizon: 4\n", encoding="utf-8")
    line = complaint("report", one, two)
    assert str(one) in line and str(two) in line
    assert not (one / "report.md").exists()


def test_a_folder_without_rollouts_is_one_line(tmp_path: Path) -> None:
    line = complaint("report", tmp_path / "none")
    assert str(tmp_path / "none") in line


def test_a_place_that_cannot_be_written_is_one_line(
    one: Path, tmp_path: Path
) -> None:
    path = tmp_path / "file"
    path.write_text("not a folder", encoding="utf-8")
    line = complaint("report", one, "--out", path, code=1)
    assert str(path) in line
