"""A scenario that sees nothing but images."""

import pytest

from xray_drake.station.scenario import Scenario


@pytest.fixture
def blind_scenario(tiny_scenario: Scenario) -> Scenario:
    """Images as a sensor gives them; no ground truth on the way."""
    perception = tiny_scenario.perception
    perception.detector, perception.segmenter = "hsv", "depth"
    perception.noise = True
    tiny_scenario.gripper.grasps = "depth"
    return tiny_scenario
