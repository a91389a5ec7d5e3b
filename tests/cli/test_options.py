from pathlib import Path

import pytest

from xray_drake.cli.configure import configure
from xray_drake.cli.options import one_of, overrides


def test_names_in_words() -> None:
    assert one_of(["a"]) == "a"
    assert one_of(["a", "b"]) == "a or b"
    assert one_of(["a", "b", "c"]) == "a, b or c"


def test_what_is_not_said_is_left() -> None:
    assert overrides(target=None, meshes=None, horizon=None) == {}
    assert overrides(meshes=[]) == {}
    assert overrides(target_first=False, seed=0) == {
        "policy.target_first": False,
        "seed": 0,
    }


def test_an_option_of_no_field_is_a_fault() -> None:
    with pytest.raises(KeyError, match="colour"):
        overrides(colour="red")


def test_options_replace_fields_of_the_scenario() -> None:
    said = overrides(
        target="cube",
        meshes=[Path("one"), Path("two")],
        scale=0.001,
        policy="oracle",
        execution="contact",
        carrier="arm",
        dtype="bfloat16",
    )
    scenario = configure("demo", said)
    assert scenario.scene.target == "cube"
    assert scenario.scene.meshes == ["one", "two"]
    assert scenario.scene.mesh_scale == 0.001
    assert scenario.policy.name == "oracle"
    assert scenario.gripper.execution == "contact"
    assert scenario.gripper.carrier == "arm"
    assert scenario.perception.dtype == "bfloat16"


def test_a_number_that_was_asked_for_is_not_random() -> None:
    assert configure("paper", {}).scene.random_number.mean > 0
    scenario = configure("paper", overrides(num_objects=5))
    assert scenario.scene.num_objects == 5
    assert scenario.scene.random_number.mean == 0
