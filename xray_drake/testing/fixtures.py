"""Fixtures for tests of single systems.

In a ``conftest.py``: ``pytest_plugins = ["xray_drake.testing.fixtures"]``.
"""

import pytest

from xray_drake.scene.heap import Heap
from xray_drake.search.diagram import SearchDiagram, build_search_diagram
from xray_drake.station.scenario import Scenario
from xray_drake.testing.tiny import (
    Observation,
    make_tiny_heap,
    make_tiny_scenario,
    observe,
)


@pytest.fixture(scope="session")
def tiny_heap() -> Heap:
    """A 2:1 box under a book, one end peeping out, and two bystanders."""
    return make_tiny_heap()


@pytest.fixture
def tiny_scenario() -> Scenario:
    """The tiny heap's search, exact inference; free to be changed."""
    return make_tiny_scenario()


@pytest.fixture(scope="session")
def tiny_diagram(tiny_heap: Heap) -> SearchDiagram:
    """The search of the tiny heap; contexts are the tests' own."""
    return build_search_diagram(make_tiny_scenario(), heap=tiny_heap)


@pytest.fixture(scope="session")
def recorded_observation(tiny_diagram: SearchDiagram) -> Observation:
    """The tiny heap, rendered once: depth, labels, camera, truth."""
    return observe(tiny_diagram)
