from pathlib import Path

import pytest

from tests.benchmark.synthetic import record, write_folder
from tests.cli.running import complaint, output
from xray_drake.benchmark.comparison import make_report
from xray_drake.benchmark.records import collect
from xray_drake.benchmark.report import markdown, success_table


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
    out = output("report", one)
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


@pytest.mark.parametrize(
    ("words", "said", "code"),
    [
        ("{one} {two}", ["{one}", "{two}"], 2),
        ("{here}/none", ["{here}/none"], 2),
        ("{one} --out {here}/file", ["{here}/file"], 1),
    ],
    ids=["of other scenarios", "no rollouts", "no place to write"],
)
def test_what_cannot_be_is_one_line(
    words: str, said: list[str], code: int, one: Path, two: Path, tmp_path: Path
) -> None:
    (two / "scenario.yaml").write_text("horizon: 4\n", encoding="utf-8")
    (tmp_path / "file").write_text("not a folder", encoding="utf-8")
    paths = {"one": one, "two": two, "here": tmp_path}
    line = complaint("report", words.format(**paths), code=code)
    assert all(part.format(**paths) in line for part in said)
    assert not (one / "report.md").exists()
