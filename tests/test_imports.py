"""Imports point down the README's table of the layout, and to the right."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "xray_drake"


def layout() -> list[str]:
    """Returns the rooms of the table, row by row."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    _, _, section = text.partition("\n## Layout\n")
    section, _, _ = section.partition("\n## ")
    rooms: list[str] = []
    for line in section.splitlines():
        if line.startswith("| `xray_drake/"):
            rooms += re.findall(r"`([^`]+)`", line.split("|")[1])
    return [
        room.removeprefix("xray_drake/").removesuffix(".py") for room in rooms
    ]


PLACE = {room: place for place, room in enumerate(layout())}


def room_of(module: str) -> str:
    return module.split(".")[1]


def modules() -> Iterator[tuple[str, Path]]:
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        if parts[-1] == "__init__":
            parts = parts[:-1]
        if len(parts) > 1:
            yield ".".join(parts), path


def imports(path: Path) -> Iterator[tuple[int, str]]:
    """Yields line and name of every import, within functions too."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import"
            assert node.module is not None
            if node.module == "xray_drake":
                for alias in node.names:
                    yield node.lineno, f"xray_drake.{alias.name}"
            else:
                yield node.lineno, node.module


def test_the_table_names_every_room() -> None:
    there = {room_of(name) for name, _ in modules()}
    assert there == set(PLACE)


@pytest.mark.parametrize(
    ("name", "path"),
    list(modules()),
    ids=lambda value: str(value).split("/")[-1],
)
def test_imports_point_down(name: str, path: Path) -> None:
    up = [
        f"{path.relative_to(ROOT)}:{line} imports {imported}"
        for line, imported in imports(path)
        if imported.startswith("xray_drake.")
        and room_of(imported) in PLACE
        and PLACE[room_of(imported)] < PLACE[room_of(name)]
    ]
    assert not up
