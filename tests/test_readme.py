"""What the README shows runs."""

import inspect
import re
from collections.abc import Callable
from pathlib import Path

import pytest

README = Path(__file__).parents[1] / "README.md"
PYTHON = re.compile(r"```python\n(.*?)```", re.DOTALL)


@pytest.mark.parametrize(
    "name",
    ["test_the_target_can_be_under_the_book", "test_the_book_goes_first"],
)
def test_the_examples_of_tests_pass(
    name: str, request: pytest.FixtureRequest
) -> None:
    blocks = PYTHON.findall(README.read_text(encoding="utf-8"))
    (block,) = [text for text in blocks if f"def {name}(" in text]
    names: dict = {}
    exec(compile(block, str(README), "exec"), names)
    test: Callable = names[name]
    test(*map(request.getfixturevalue, inspect.signature(test).parameters))


def test_all_examples_of_tests_are_run() -> None:
    shown = PYTHON.findall(README.read_text(encoding="utf-8"))
    assert sum(text.count("def test_") for text in shown) == 2


def test_every_picture_is_there_and_has_a_command() -> None:
    text = README.read_text(encoding="utf-8")
    shown = set(re.findall(r"\]\(models/pictures/(\w+)\.png\)", text))
    folder = README.parent / "models" / "pictures"
    assert {path.stem for path in folder.glob("*.png")} == shown
    section = text.split("## Pictures\n")[1].split("\n## ")[0]
    named: set[str] = set()
    for row in section.strip().splitlines()[2:]:
        pictures, command = row.strip("| ").split(" | ")
        assert re.search("`(python -m xray_drake|xray-drake) ?", command)
        named |= set(re.findall(r"`(\w+)`", pictures))
    assert named == shown
    for path in folder.glob("*.png"):
        # A page that loads at once.
        assert path.stat().st_size < 400_000, path.name
