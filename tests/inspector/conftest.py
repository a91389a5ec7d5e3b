"""A search of the tiny heap, replayed once for all tests of the inspector."""

import pytest
from pydrake.geometry import Meshcat

from xray_drake.drawing.meshcat_layers import start_meshcat
from xray_drake.inspector.replay import Replay, first_decision, replay_search
from xray_drake.scene.heap import Heap
from xray_drake.station.scenario import Scenario
from xray_drake.testing.tiny import make_tiny_scenario


def short() -> Scenario:
    """Two actions: the largest first."""
    scenario = make_tiny_scenario()
    scenario.horizon = 2
    scenario.policy.name = "largest"
    return scenario


@pytest.fixture(scope="session")
def replay(tiny_heap: Heap) -> Replay:
    return replay_search(short(), tiny_heap)


@pytest.fixture(scope="session")
def looked_at(tiny_heap: Heap) -> Replay:
    """The tiny heap and the first decision on it."""
    return first_decision(short(), tiny_heap)


@pytest.fixture
def meshcat() -> Meshcat:
    return start_meshcat()
