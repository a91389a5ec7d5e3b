import json
from functools import partial
from pathlib import Path

import cv2
import pytest

from tests.cli.running import complaint, output
from xray_drake.scene.library import object_names

invoke = partial(output, "objects")


def rows(*arguments: str) -> list[dict]:
    return json.loads(invoke("list", "--json", *arguments))


def test_list_as_a_table() -> None:
    told = invoke("list", "bottle_000", "gear_00[12]", "teapot_000")
    for name in ("bottle_000", "gear_001", "gear_002", "teapot_000", "test"):
        assert name in told
    assert "4 objects" in told


def test_list_as_json() -> None:
    found = rows("--family", "hinge", "--split", "validation")
    assert [row["name"] for row in found] == list(
        object_names("hinge", split="validation")
    )
    row = found[0]
    assert row["family"] == "hinge"
    assert row["split"] == "validation"
    assert len(row["size"]) == 3
    assert 0.0005 < row["mass"] < 0.5
    assert row["pieces"] == 3


def test_a_family_named_is_shown_whatever_its_split() -> None:
    assert {row["split"] for row in rows("--family", "chair")} == {"test"}
    both = {
        row["split"] for row in rows("--family", "chair", "--family", "key")
    }
    assert both == {"train", "validation", "test"}


def test_packaged_ones_come_on_request() -> None:
    plain = [row["name"] for row in rows("--family", "chair")]
    more = [row["name"] for row in rows("--family", "chair", "--packaged")]
    assert more[: len(plain)] == plain
    assert all(name.endswith("_packaged") for name in more[len(plain) :])
    (one,) = rows("cup_001_packaged")
    assert one["family"] == "cup"
    assert one["pieces"] == 10


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["list", "unicorn_000"], "unicorn"),
        (["list", "bottle_999"], "bottle_999"),
        (["list", "unicorn_*"], "unicorn"),
        (["list", "--family", "unicorn"], "unicorn"),
        (["list", "--split", "exam"], "exam"),
        (["list", "--family", "chair", "--split", "train"], "train"),
        (["list", "chair_000", "--split", "train"], "test"),
        (["show", "chair_000", "--out", "sheet.jpg"], "PNG"),
        (["export", "here", "chair_000", "--format", "stl"], "stl"),
    ],
)
def test_what_does_not_exist_is_one_line(
    arguments: list[str], told: str
) -> None:
    assert told in complaint("objects", *arguments)


def test_show_writes_a_sheet(tmp_path: Path) -> None:
    path = tmp_path / "sheet.png"
    told = invoke(
        "show", "--family", "chair", "--family", "can", "--per-family", "2",
        "--out", str(path),
    )  # fmt: skip
    assert "4 objects" in told
    picture = cv2.imread(str(path))
    assert picture.shape == (2 * 190, 2 * 160, 3)


def test_show_draws_as_small_as_asked(tmp_path: Path) -> None:
    path = tmp_path / "sheet.png"
    invoke("show", "chair_00[0-2]", "--size", "80", "--out", str(path))
    assert cv2.imread(str(path)).shape == (110, 3 * 80, 3)


def test_export(tmp_path: Path) -> None:
    folder = tmp_path / "some"
    told = invoke("export", str(folder), "chair_000", "carton_00*")
    assert "objects in" in told
    assert (folder / "chair_000.sdf").is_file()
    assert (folder / "chair_000_visual.obj").is_file()
    assert (folder / "carton_009.sdf").is_file()
    assert "--force" in complaint("objects", "export", folder, "chair_000")
    invoke("export", str(folder), "chair_001", "--format", "obj", "--force")
    assert (folder / "chair_001.obj").is_file()
    assert (folder / "chair_000.sdf").is_file()
