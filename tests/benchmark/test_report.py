import csv
import io
import itertools
import random
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.image
import pytest

from tests.benchmark.synthetic import (
    failure,
    many_records,
    record,
    write_folder,
)
from xray_drake.benchmark.comparison import (
    Report,
    comma_separated,
    make_report,
)
from xray_drake.benchmark.records import ROLLOUTS, Collection, collect
from xray_drake.benchmark.report import (
    ACTIONS,
    SUCCESS,
    markdown,
    success_table,
    write_report,
)


def of(records: list[dict[str, Any]]) -> Report:
    return make_report(Collection(records, "table2"))


def tables(text: str) -> list[list[list[str]]]:
    """Returns the cells of the tables in a Markdown text, row by row."""
    groups = itertools.groupby(
        text.splitlines(), key=lambda line: line.startswith("|")
    )
    return [
        [
            [cell.strip() for cell in line.strip("|").split("|")]
            for line in lines
        ]
        for is_table, lines in groups
        if is_table
    ]


SMALL = [
    record("xray", 0, 2, visible=0.0),
    record("xray", 1, 3, visible=0.5),
    record("xray", 2, 7, visible=0.9),
    record("xray", 3, 10, "horizon", visible=0.95),
    record("largest", 0, 10, "horizon", visible=0.0),
    record("largest", 1, 10, "horizon", visible=0.5),
    record("largest", 2, 4, "target_lost", visible=0.9),
    failure("largest", 4, "heap after heap failed"),
]


def test_table_2_by_hand() -> None:
    (rows,) = tables("\n".join(success_table(of(SMALL))))
    largest = "largest | 0.0 % | 0.0 % to 49.0 % | 4 | – | 67 % | 4, 5, 7"
    xray = "100.0 % | 43.9 % to 100.0 % | 3 | 2.5, 3, 5 | 82 % | 3, 5, 6"
    assert rows[2:] == [
        largest.split(" | "),
        f"xray (geometric) | {xray}".split(" | "),
    ]


def test_table_3_stands_beside_the_scenario_that_is_modelled_on_it() -> None:
    report = replace(of(SMALL), scenario="table3")
    text = "\n".join(success_table(report))
    (rows,) = tables(text)
    assert rows[2][-2:] == ["85 %", "4, 6, 7"]
    assert rows[3][-2:] == ["100 %", "4, 5, 5.25"]
    assert "Table III" in text
    assert "Table III" in markdown(report)


@pytest.mark.parametrize(
    ("name", "changed", "beside"),
    [
        ("demo", (), False),
        ("mine", (), False),
        ("table3", ("gripper.execution quasi_static, not contact",), False),
        # Our own inference and second target are no other scenario.
        ("table2", ("perception.weights mine.safetensors, not ",), True),
        ("table3", ("scene.target domino, not box_2to1",), True),
    ],
)
def test_the_papers_figures_stand_beside_its_own_scenario_alone(
    name: str, changed: tuple[str, ...], beside: bool
) -> None:
    report = make_report(Collection(SMALL, name, changed))
    text = markdown(report)
    assert ("the paper's Table" in text) == beside
    assert ("paper" in text) == ("paper" in comma_separated(report)) == beside
    assert all(change in text for change in changed)


def test_every_table_is_a_rectangle_and_says_what_made_it() -> None:
    report = of(many_records())
    text = markdown(report)
    sections = [s for s in text.split("\n## ") if tables(s)]
    assert len(sections) == 7
    for section in sections:
        (rows,) = tables(section)
        assert len({len(row) for row in rows}) == 1
        assert set(rows[1]) == {"---"}
        assert report.made_by in section.splitlines()
    assert "nan" not in text
    assert report.made_by in success_table(report)
    assert report.made_by.startswith("Made by code ")
    assert "scenario table2; seeds 0 to 39; " in report.made_by
    rows = csv.DictReader(io.StringIO(comma_separated(report)))
    assert report.made_by in [row["value"] for row in rows]


def test_what_is_mixed_is_said() -> None:
    other = record("xray", 7, weights={"n": "1"}, dtype="float32")
    assert of([*SMALL, other]).made_by.startswith("Made by")
    for change in (
        {"code": "0123"},
        {"dtype": "bfloat16", "weights": {"n": "1"}},
        {"versions": {"drake": "1.40.0"}},
    ):
        mixed = of([*SMALL, other, record("xray", 8, **change)])
        assert mixed.made_by.startswith("**Mixed**: ")
    # As records were before they said it.
    old = record("xray", 8)
    del old["code"]
    assert of([*SMALL, old]).made_by.startswith("**Mixed**: ")


def test_what_the_markdown_says() -> None:
    text = markdown(of(SMALL))
    assert "8 rollouts on 5 heaps (seeds 0 to 4)" in text
    assert "25.0 % hidden, 50.0 % partly visible, 25.0 % more than" in text
    assert "start more than 90 % visible: 1." in text
    assert "- seed 4, largest: heap after heap failed" in text
    found = {rows[0][0]: rows for rows in tables(text)}
    assert found["difference"][2][:3] == [
        "xray (geometric) − largest",
        "+100.0 (+100.0 to +100.0)",
        "+100.0 (+100.0 to +100.0)",
    ]
    # No heap on which both succeed.
    assert found["difference"][2][-1] == ""
    end_rows = [rows for rows in tables(text) if "horizon" in rows[0]]
    ((head, _, largest, xray),) = end_rows
    assert head[1:] == [
        *("success", "error", "horizon", "target_lost", "attempts: lifted")
    ]
    assert largest == ["largest", "0", "1", "2", "1", "24"]
    assert xray[1] == "3"


def test_failures_are_shown_by_cause() -> None:
    failed = record("xray", 0, 1, "horizon")
    failed["actions"][0] |= {"outcome": "failed", "reason": "the lip bends"}
    text = markdown(of([failed, record("random", 0)]))
    (rows,) = (t for t in tables(text) if t[0][0] == "cause")
    assert rows[0] == ["cause", "random", "xray (geometric)"]
    assert rows[2:] == [["failed: the lip bends", "0", "1"]]


@pytest.mark.parametrize("records", [[], [record("xray", 0, visible=0.95)]])
def test_a_heap_in_full_view_alone_is_nothing_to_report(
    records: list[dict[str, Any]],
) -> None:
    with pytest.raises(ValueError, match=f"of {len(records)} rollouts none"):
        of(records)


def test_what_the_markdown_says_of_draws_and_drops() -> None:
    first = record("xray", 0)
    first["start"] |= {"attempts": 4, "redrawn": 2}
    text = markdown(of([first, record("xray", 1)]))
    assert (
        "Of 5 heaps drawn, 2 (40.0 %) showed too much of the target and 1 did "
        "not come to rest" in text
    )
    assert "There is one variant alone." in text
    text = markdown(of([record("xray", 0), record("largest", 0)]))
    # A drop counts once: (4 + 2 + 2) / 2.
    assert "4.00 core-seconds; counted once a heap, it makes 4.00" in text


def rows_of(report: Report) -> dict[tuple[str, ...], dict[str, str]]:
    lines = csv.DictReader(io.StringIO(comma_separated(report)))
    found = {
        (row["part"], row["variant"], row["against"], row["quantity"]): row
        for row in lines
    }
    assert len(found) == comma_separated(report).count("\n") - 1
    return found


def test_the_csv_holds_the_figures() -> None:
    rows = rows_of(of(SMALL))
    xray = "xray (geometric)"
    rate = rows["all", xray, "", "success_rate"]
    assert (rate["value"], rate["heaps"]) == ("1.0", "3")
    assert float(rate["low"]) == pytest.approx(0.4385, abs=1e-4)
    difference = rows["all", xray, "largest", "success_rate"]
    assert (difference["value"], difference["heaps"]) == ("1.0", "3")
    for key, value in (
        (("hidden", "largest", "", "end_horizon"), "1"),
        (("all", "largest", "", "end_error"), "1"),
        (("all", xray, "", "actions_median"), "3.0"),
        (("all", "largest", "", "actions_median"), ""),
        (("paper", "random", "", "success_rate"), "0.42"),
        (("paper", "xray", "", "actions_upper_quartile"), "6"),
    ):
        assert rows[key]["value"] == value
    rows = rows_of(of(many_records()))
    assert float(rows["all", "", "", "core_seconds_a_rollout"]["value"]) > 0
    assert ("cover_small", "oracle", "largest", "success_rate") in rows
    for row in rows.values():
        low, value, high = (row[k] or "nan" for k in ("low", "value", "high"))
        assert not row["low"] or float(low) <= float(value) <= float(high)


def files_of(folders: list[Path], out: Path) -> dict[str, bytes]:
    paths = write_report(make_report(collect(folders)), out)
    assert sorted(paths) == sorted(out.iterdir())
    return {path.name: path.read_bytes() for path in paths}


def test_killed_resumed_and_merged_gives_the_same_report(
    tmp_path: Path,
) -> None:
    """Records come in another order, and one line is cut by the kill."""
    records = many_records(12)
    mixed = random.Random(5).sample(records, len(records))
    whole = write_folder(tmp_path / "whole", records)
    killed = write_folder(tmp_path / "killed", mixed[:30])
    path = killed / ROLLOUTS
    text = path.read_text(encoding="utf-8")
    path.write_text(text[:-100], encoding="utf-8")
    half = files_of([killed], tmp_path / "out0")

    first = files_of([whole], tmp_path / "out1")
    assert set(first) == {"report.md", "report.csv", ACTIONS, SUCCESS}
    assert all(half[name] != first[name] for name in first)
    resumed = write_folder(tmp_path / "resumed", mixed[:29] + mixed[:28:-1])
    assert files_of([resumed], tmp_path / "out2") == first
    machines = [
        write_folder(
            tmp_path / f"machine{i}", [r for r in records if r["seed"] % 3 == i]
        )
        for i in (2, 1, 0)
    ]
    assert files_of(machines, tmp_path / "out3") == first
    for name in (ACTIONS, SUCCESS):
        image = matplotlib.image.imread(tmp_path / "out1" / name)
        assert image[..., :3].std() > 0.05
        assert f"]({name})" in first["report.md"].decode()
