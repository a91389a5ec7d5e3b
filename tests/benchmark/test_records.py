import random
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import Any

import pytest

from tests.benchmark.synthetic import many_records, record, write_folder
from xray_drake.benchmark.paper import changes
from xray_drake.benchmark.records import (
    ROLLOUTS,
    SCENARIO,
    check_folder,
    collect,
    in_order,
    read_rollouts,
    shared_scenario,
)
from xray_drake.station.scenario import (
    Scenario,
    dump_scenario,
    load_scenario,
    parse_scenario,
)


def demo(**changes: Any) -> Scenario:
    """Returns the scenario with fields, "scene__meshes", changed."""
    scenario = load_scenario("demo")
    for path, value in changes.items():
        *parents, field = path.split("__")
        owner = reduce(getattr, parents, scenario)
        assert hasattr(owner, field)
        setattr(owner, field, value)
    return scenario


def test_what_a_rollout_chooses_is_not_of_the_shared_scenario() -> None:
    changed = demo(
        seed=17,
        policy__name="random",
        policy__target_first=False,
        perception__occupancy="learned",
    )
    assert shared_scenario(changed) == shared_scenario(demo())
    # The scenario given is left alone.
    assert (changed.seed, changed.policy.name) == (17, "random")
    text = shared_scenario(demo())
    assert shared_scenario(demo(horizon=9)) != text
    assert shared_scenario(parse_scenario(text, "again")) == text


def test_a_folder_is_of_one_scenario(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "a", [])
    check_folder(folder, shared_scenario(demo()))
    check_folder(tmp_path / "none", "anything")
    with pytest.raises(ValueError, match=str(folder)):
        check_folder(folder, shared_scenario(demo()) + "horizon: 3\n")
    assert read_rollouts(tmp_path / "none") == read_rollouts(folder) == []


def test_folders_come_together_whatever_their_order(tmp_path: Path) -> None:
    records = many_records(6)
    mixed = random.Random(1).sample(records, len(records))
    one = write_folder(tmp_path / "one", mixed[:11])
    two = write_folder(tmp_path / "two", mixed[11:])
    there, back = collect([one, two]), collect([two, one])
    assert there.records == back.records == in_order(records)
    assert there.records != records
    assert there.repeated == 0
    assert there.scenario == "demo"


def test_the_first_of_the_same_rollouts_counts(tmp_path: Path) -> None:
    one = write_folder(
        tmp_path / "one", [record("xray", 1, 3), record("random", 1, 9)]
    )
    two = write_folder(
        tmp_path / "two",
        [
            record("xray", 1, 5),
            record("random", 1, 8, occupancy="learned"),
            record("xray", 1, 6, occupancy="learned"),
            record("xray", 2, 7),
        ],
    )
    found = collect([one, two])
    assert found.repeated == 2
    assert [r["num_actions"] for r in found.records] == [9, 3, 7, 6]
    turned = collect([two, one]).records
    assert [r["num_actions"] for r in turned] == [8, 5, 7, 6]
    # As when a killed benchmark's worker lived on.
    twice = write_folder(tmp_path / "twice", [record("xray", 1)] * 2)
    assert len(collect([twice]).records) == collect([twice]).repeated == 1


DIFFERENT = r"one and .*two are of different"
BOTH = r"both hold xray \({}\)"


@pytest.mark.parametrize(
    ("change", "seed", "occupancy", "complaint"),
    [
        ({"scene__num_objects": 9}, 1, "geometric", DIFFERENT),
        ({"horizon": 9}, 2, "geometric", DIFFERENT),
        ({"gripper__quasi_static__speed": 0.9}, 2, "geometric", DIFFERENT),
        (
            *({"policy__min_visible_pixels": 99}, 2),
            *("geometric", BOTH.format("geometric")),
        ),
        (
            *({"perception__geometric__rotations": 16}, 2),
            *("geometric", BOTH.format("geometric")),
        ),
        ({"cell__bin__length": 0.6}, 2, "geometric", DIFFERENT),
    ],
)
def test_heaps_are_of_one_scenario_and_a_variant_has_one_setting(
    change: dict[str, Any],
    seed: int,
    occupancy: str,
    complaint: str,
    tmp_path: Path,
) -> None:
    first, second = (
        record("xray", number, occupancy=occupancy) for number in (1, seed)
    )
    one = write_folder(tmp_path / "one", [first])
    two = write_folder(tmp_path / "two", [second], demo(**change))
    with pytest.raises(ValueError, match=complaint) as error:
        collect([one, two])
    assert len(str(error.value).splitlines()) == 1


def test_settings_that_a_variant_does_not_use_may_differ(
    tmp_path: Path,
) -> None:
    changed = demo(
        perception__weights="other.safetensors",
        perception__geometric__rotations=16,
    )
    one = write_folder(
        tmp_path / "one", [record("xray", 1), record("random", 1)]
    )
    other = record("xray", 1, occupancy="learned")
    two = write_folder(tmp_path / "two", [other, record("random", 2)], changed)
    assert len(collect([one, two]).records) == 4


def test_the_scenario_beside_the_rollouts_holds_in_any_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)

    text = shared_scenario(demo(scene__meshes=["in"]))
    assert parse_scenario(text, "it").scene.meshes == [f"{tmp_path}/in"]


def test_targets_come_together(tmp_path: Path) -> None:
    one = write_folder(tmp_path / "one", [record("xray", 1)])
    scenario = demo(scene__target="domino")
    two = write_folder(
        tmp_path / "two", [record("xray", 1, target="domino")], scenario
    )
    assert len(collect([one, two]).records) == 2
    assert collect([one, two]).repeated == 0


@pytest.mark.parametrize("missing", [ROLLOUTS, SCENARIO])
def test_a_folder_that_is_no_benchmarks(missing: str, tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "a", [record("xray", 1)])
    (folder / missing).unlink()
    with pytest.raises(ValueError, match=f"{folder} holds no rollouts"):
        collect([folder])


def test_a_record_may_name_its_files_by_another_path(tmp_path: Path) -> None:
    own = {"seed": 1, "policy__name": "random"}
    scenario = demo(**own, scene__meshes=["meshes/tools"])
    for i, path in enumerate(["meshes/tools", "/somewhere/meshes/tools"]):
        text = dump_scenario(demo(**own, scene__meshes=[path]))
        item = record("random", 1, scenario=text)
        folder = write_folder(tmp_path / str(i), [item], scenario)
        assert collect([folder]).records == [item]
    item["scenario"] = dump_scenario(demo(**own, scene__meshes=["meshes/toys"]))
    folder = write_folder(tmp_path / "toys", [item], scenario)
    with pytest.raises(ValueError, match="of another scenario"):
        collect([folder])


def test_changes_are_told(tmp_path: Path) -> None:
    assert changes(demo()) == ()

    changed = demo(
        # A rollout's own.
        seed=3,
        policy__name="random",
        perception__occupancy="geometric",
        # The scenario's.
        horizon=5,
        scene__heap__sleep=False,
        scene__meshes=["/a", "/b"],
        cell__overhead__X_PB__translation=[0.0, 0.0, 0.9],
    )
    found = changes(changed)
    assert "horizon 5, not 10" in found
    assert "scene.meshes [/a, /b], not []" in found
    where = "cell.overhead.X_PB.translation"
    assert f"{where} [0.0, 0.0, 0.9], not [0.0, 0.0, 0.8]" in found
    folder = write_folder(tmp_path / "a", [record("xray", 1)], changed)
    assert collect([folder]).changed == tuple(
        text for text in found if not text.startswith("perception.occupancy")
    )
    own = replace(changed, name="mine")
    assert changes(own) == ()
