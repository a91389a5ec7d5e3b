import numpy as np
import pytest

from tests.occupancy.brute_force import render
from tests.occupancy.scenes import CAMERAS, occluders
from xray_drake.occupancy.learned.inference import (
    default_weights,
    load_inference,
)
from xray_drake.occupancy.learned.weights import read_card
from xray_drake.resources import models_dir
from xray_drake.station.scenario import (
    ScenarioError,
    check_scenario,
    load_scenario,
)

SIZE = np.array([0.0424, 0.0212, 0.005])


def test_the_shipped_network_says_what_it_was_trained_on() -> None:
    card = read_card(default_weights())
    assert card.box_size is None
    assert len(card.targets) == 10
    assert card.data["images used"] > 0


def test_all_shipped_weights_are_small() -> None:
    files = (models_dir() / "networks").glob("*.safetensors")
    assert 0 < sum(file.stat().st_size for file in files) < 20e6


@pytest.mark.parametrize("name", ["nominal", "tilted", "rolled"])
def test_a_hidden_target_is_under_what_stands_in_the_bin(name: str) -> None:
    camera = CAMERAS[name]
    rng = np.random.default_rng(1)
    depth, _ = render(camera, occluders(rng, 14, np.zeros(2), 0.045, 0.017))
    heights = camera.unproject(depth)[..., 2]
    inference = load_inference(default_weights(), target_size=SIZE)
    blank = np.zeros(camera.shape, bool)
    answer = inference.infer(depth, blank, camera).data
    assert answer.max() > 0.5
    assert answer[heights > 0.005].sum() > 0.9 * answer.sum()


def test_weights_that_are_missing_are_told_before_a_heap_is_dropped() -> None:
    scenario = load_scenario("demo")
    scenario.perception.occupancy = "learned"
    check_scenario(scenario)
    scenario.perception.weights = "gone.safetensors"
    with pytest.raises(ScenarioError, match=r"perception\.weights.*gone"):
        check_scenario(scenario)
