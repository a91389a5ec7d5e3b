from pathlib import Path

import pytest

from tests.cli.running import answer
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


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("search --seed -1", "seed is -1: it must be from 0"),
        (f"search --seed {2**63}", f"seed is {2**63}: it must be from 0"),
        ("search --num-objects 0", "scene.num_objects is 0"),
        ("search --num-objects 101", "scene.num_objects is 101"),
        ("search --horizon 0", "horizon is 0"),
        ("search --scale nan", "scene.mesh_scale is nan"),
        ("search --scale -1", "scene.mesh_scale is -1.0"),
        ("search --target ''", "scene.target is ''"),
        (f"benchmark --out b --seed {2**63 - 1} --heaps 2", f"is {2**63}"),
        ("benchmark --out b --heaps 0", "--heaps"),
        ("generate g --images 0", "--images"),
        (f"generate g --seed {10**11}", f"seed is {10**11}: it must be"),
        ("train d --out t --passes nan", "passes is nan"),
        (f"train d --out t --seed {2**32}", f"seed is {2**32}"),
        ("inspect --num-objects 0", "scene.num_objects is 0"),
        ("evaluate occupancy d --height-offset nan", "nan"),
        ("evaluate occupancy d --focal-error -1", "-1"),
    ],
)
def test_numbers_out_of_range_are_found_at_once(
    words: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, error = answer(words)
    assert code == 2
    assert said in error
    assert list(tmp_path.iterdir()) == []
