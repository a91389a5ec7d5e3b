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
