from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from tests.cli.running import answer
from xray_drake.choices import TALL_TARGETS
from xray_drake.files import LinesError, read_json_lines
from xray_drake.provenance import ManifestError, manifest_path, read_runs
from xray_drake.studies.contact_grasps import contact_grasps, contact_tables
from xray_drake.studies.heap_settings import heap_settings, heap_tables
from xray_drake.studies.label_ceiling import ceiling_tables
from xray_drake.studies.study import Line, Study, Table, run_study
from xray_drake.studies.tall_targets import tall_tables, tall_targets


def double(item: Line) -> Line:
    if item["x"] < 0:
        raise ValueError("x is below 0")
    return {"twice": 2 * item["x"]}


def total(lines: list[Line]) -> Mapping[str, Table]:
    return {"sums": [{"n": len(lines), "sum": sum(t["twice"] for t in lines)}]}


def study(*xs: int) -> Study:
    return Study(
        "doubles",
        [{"x": x} for x in xs],
        double,
        total,
        seeds=[7],
        settings={"size": 6},
    )


def test_a_study_is_gone_on_with_by_the_same_code_alone(tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    tables = run_study(
        study(1, 2), tmp_path, workers=2, progress=lambda *n: told.append(n)
    )
    assert tables == {"sums": [{"n": 2, "sum": 6}]}
    assert told == [(0, 2), (1, 2), (2, 2)]
    assert (tmp_path / "sums.csv").read_text().split() == ["n,sum", "2,6"]
    lines = tmp_path / "doubles.jsonl"
    (run,) = read_runs(lines)
    assert (run["command"], run["seeds"]) == ("doubles", [7])
    assert len(read_json_lines(lines)) == 2

    # Killed in the middle of a line, it goes on.
    lines.write_text(lines.read_text()[:-5])
    run_study(study(1, 2, 3), tmp_path, workers=1)
    assert sorted(t["x"] for t in read_json_lines(lines)) == [1, 2, 3]
    with pytest.raises(ManifestError, match="begun with size 6, not 7"):
        run_study(replace(study(1), settings={"size": 7}), tmp_path, workers=1)
    with pytest.raises(RuntimeError, match=r"doubles, {'x': -1}: .*below 0"):
        run_study(study(-1), tmp_path, workers=1)
    path = manifest_path(lines)
    path.write_text(path.read_text().replace('"code": "', '"code": "f'))
    with pytest.raises(ManifestError, match="--mix"):
        run_study(study(1), tmp_path, workers=1)
    run_study(study(1), tmp_path, workers=1, mix=True)
    with lines.open("a") as file:
        file.write("rubbish\n")
    with pytest.raises(LinesError, match="line 4 cannot be read"):
        run_study(study(1), tmp_path, workers=1, mix=True)


def test_studies_are_listed_and_bad_settings_cost_one_line(
    tmp_path: Path,
) -> None:
    listed = answer("study", "--help")[1]
    for name in ("heap-settings", "label-ceiling", "tall-targets"):
        assert name in listed
    code, _, error = answer(
        *("study", "heap-settings", "--out", tmp_path),
        *("--settings", "hasty"),
    )
    assert code == 2
    assert "no setting is called 'hasty'" in error


def test_items_and_settings() -> None:
    assert heap_settings("default,sleep", 2).items[:3] == [
        {"setting": "default", "seed": 40_000},
        {"setting": "sleep", "seed": 40_000},
        {"setting": "default", "seed": 40_001},
    ]
    assert len(tall_targets(3).items) == 3 * len(TALL_TARGETS)
    grasps = contact_grasps(None, most=4)
    assert [item["rest"] for item in grasps.items] == [0, 1, 2, 0]
    # Other grasps are another measurement.
    for change in ({"carrier": "arm"}, {"loads": [2.0]}):
        assert contact_grasps(None, **change).settings != grasps.settings


def test_tables_by_hand() -> None:
    heap = {
        **{"cpu": 2.0, "settle_time": 1.0, "outside": 1, "tilt": 6.0},
        **{"height": 50.0, "spread": 30.0, "visible": 0.5},
        **{"moved": [0.5, 2.0], "depths": [1.0, 3.0]},
    }
    failed = {"setting": "default", "cpu": 4.0, "failed": "no rest"}
    lines = [{"setting": name, **heap} for name in ("default", "sleep")]
    tables = heap_tables([*lines, failed])
    row, _ = tables["heap_settings"]
    assert (row["heaps"], row["failed"], row["core-s a heap"]) == (2, 1, 3.0)
    assert (row["moved > 1 mm in 1 s"], row["most, mm"]) == (0.5, 2.0)
    assert row["mean overlap, mm"] == 2.0
    assert [r["p"] for r in tables["heap_settings_sleep"]] == [1.0] * 3

    one = {"held": 1.0, "iou": 0.5, "support": 9, "seconds": 0.1}
    other = {**one, "held": 0.9}
    tall = [
        {"target": "mug", "visible": seen, "flat": one, "resting": worse}
        for seen, worse in ((0.5, one), (0.95, other))
    ]
    held = [
        r["true mask in support"] for r in tall_tables(tall)["tall_targets"]
    ]
    assert held == [1.0, 0.5, 1.0, 1.0]

    counts = {"tp": 1, "tn": 3, "positives": 2, "negatives": 4, "union": 2}
    seen = {"target": "box_1to1", "visible": 0.0, "counts": {"best": counts}}
    other = {"target": "lid", "counts": {}}
    rows = ceiling_tables([seen, seen, other])["label_ceiling"]
    assert [row["target"] for row in rows] == [
        "all boxes",
        "box_1to1",
        "hidden",
    ]
    assert rows[0]["images"] == 2
    assert rows[0]["best: balanced accuracy"] == (1 / 2 + 3 / 4) / 2
    assert rows[0]["best: IoU"] == 0.5

    trial = {
        **{"kind": "jaw", "held": True, "brought": True, "turned": 4.0},
        "reason": "",
    }
    tilted = {**trial, "turned": 20.0}
    far = {**trial, "brought": False, "reason": "out of the arm's reach"}
    far["turned"] = None
    (jaw, cup, *_) = contact_tables([{"trials": [trial, tilted, far]}])[
        "contact_grasps"
    ]
    assert [*jaw.values()] == ["holds", "jaw", 3, 2, 1, 12.0, 1]
    assert cup["grasps"] == 0
