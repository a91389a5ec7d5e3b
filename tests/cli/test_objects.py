import json
from pathlib import Path

import cv2
import pytest

from tests.cli.running import complaint, output
from xray_drake.scene.library import object_names


def rows(arguments: str) -> list[dict]:
    return json.loads(output("objects list --json", arguments))


def test_list_as_a_table() -> None:
    told = output("objects list bottle_000 gear_00[12] teapot_000")
    for name in ("bottle_000", "gear_001", "gear_002", "teapot_000", "test"):
        assert name in told
    assert "4 objects" in told


def test_list_as_json() -> None:
    found = rows("--family hinge --split validation")
    assert [row["name"] for row in found] == list(
        object_names("hinge", split="validation")
    )
    row = found[0]
    assert (row["family"], row["split"]) == ("hinge", "validation")
    assert len(row["size"]) == 3
    assert 0.0005 < row["mass"] < 0.5
    assert row["pieces"] == 3


def test_a_family_named_is_shown_whatever_its_split() -> None:
    assert {row["split"] for row in rows("--family chair")} == {"test"}
    both = {row["split"] for row in rows("--family chair --family key")}
    assert both == {"train", "validation", "test"}


def test_packaged_ones_come_on_request() -> None:
    plain = [row["name"] for row in rows("--family chair")]
    more = [row["name"] for row in rows("--family chair --packaged")]
    assert more[: len(plain)] == plain
    assert all(name.endswith("_packaged") for name in more[len(plain) :])
    (one,) = rows("cup_001_packaged")
    assert (one["family"], one["pieces"]) == ("cup", 10)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ("list unicorn_000", "unicorn"),
        ("list bottle_999", "bottle_999"),
        ("list unicorn_*", "unicorn"),
        ("list --family unicorn", "unicorn"),
        ("list --split exam", "exam"),
        ("list --family chair --split train", "train"),
        ("list chair_000 --split train", "test"),
        ("show chair_000 --out sheet.jpg", "PNG"),
        ("export here chair_000 --format stl", "stl"),
    ],
)
def test_what_does_not_exist_is_one_line(arguments: str, told: str) -> None:
    assert told in complaint("objects", arguments)


def test_show_writes_a_sheet_as_large_as_asked(tmp_path: Path) -> None:
    path = tmp_path / "sheet.png"
    chosen = "--family chair --family can --per-family 2"
    told = output(f"objects show {chosen} --size 80 --out {path}")
    assert "4 objects" in told
    assert cv2.imread(str(path)).shape == (2 * 110, 2 * 80, 3)


def test_export(tmp_path: Path) -> None:
    folder = tmp_path / "some"
    told = output(f"objects export {folder} chair_000 carton_00*")
    assert "objects in" in told
    assert (folder / "chair_000.sdf").is_file()
    assert (folder / "chair_000_visual.obj").is_file()
    assert (folder / "carton_009.sdf").is_file()
    assert "--force" in complaint(f"objects export {folder} chair_000")
    output(f"objects export {folder} chair_001 --format obj --force")
    assert (folder / "chair_001.obj").is_file()
    assert (folder / "chair_000.sdf").is_file()
