"""What the README shows runs."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest

README = Path(__file__).parents[1] / "README.md"
PYTHON = re.compile(r"```python\n(.*?)```", re.DOTALL)


@pytest.fixture
def shown_test() -> Callable:
    """The README's example of a test."""
    blocks = PYTHON.findall(README.read_text(encoding="utf-8"))
    (block,) = [text for text in blocks if "def test_" in text]
    names: dict = {}
    exec(compile(block, str(README), "exec"), names)
    (test,) = [value for key, value in names.items() if key.startswith("test_")]
    return test


def test_the_example_of_a_test_passes(
    shown_test: Callable, recorded_observation: object
) -> None:
    shown_test(recorded_observation)


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
