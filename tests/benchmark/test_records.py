import json
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


def test_a_folder_without_rollouts_has_none(tmp_path: Path) -> None:
    assert read_rollouts(tmp_path) == []
    assert read_rollouts(tmp_path / "none") == []


def test_what_a_rollout_chooses_is_not_of_the_shared_scenario() -> None:
    changed = demo(
        seed=17,
        policy__name="random",
        policy__target_first=False,
        perception__occupancy="learned",
    )
    assert shared_scenario(changed) == shared_scenario(demo())
    text = shared_scenario(demo())
    assert shared_scenario(demo(horizon=9)) != text
    assert shared_scenario(parse_scenario(text, "again")) == text


def test_the_scenario_given_is_left_alone() -> None:
    scenario = demo(seed=17, policy__name="random")
    shared_scenario(scenario)
    assert (scenario.seed, scenario.policy.name) == (17, "random")


def test_a_folder_is_of_one_scenario(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "a", [])
    check_folder(folder, shared_scenario(demo()))
    check_folder(tmp_path / "none", "anything")
    with pytest.raises(ValueError, match=str(folder)):
        check_folder(folder, shared_scenario(demo()) + "horizon: 3\n")


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
    assert [r["num_actions"] for r in collect([two, one]).records] == [
        *(8, 5, 7, 6)
    ]


def test_a_line_twice_in_one_folder_counts_once(tmp_path: Path) -> None:
    """As when a killed benchmark's worker lived on."""
    folder = write_folder(tmp_path / "a", [record("xray", 1)] * 2)
    assert len(collect([folder]).records) == collect([folder]).repeated == 1


@pytest.mark.parametrize(
    "change",
    [
        {"scene__num_objects": 9},
        {"horizon": 9},
        {"gripper__quasi_static__speed": 0.9},
    ],
)
@pytest.mark.parametrize("seed", [1, 2])
def test_heaps_of_other_scenarios_do_not_mix(
    change: dict[str, Any], seed: int, tmp_path: Path
) -> None:
    one = write_folder(tmp_path / "one", [record("xray", 1)])
    two = write_folder(tmp_path / "two", [record("xray", seed)], demo(**change))
    with pytest.raises(ValueError, match=r"one and .*two are of different"):
        collect([one, two])


@pytest.mark.parametrize(
    "change",
    [
        {"policy__min_visible_pixels": 99},
        {"perception__geometric__rotations": 16},
    ],
)
def test_one_variant_has_one_setting(
    change: dict[str, Any], tmp_path: Path
) -> None:
    one = write_folder(tmp_path / "one", [record("xray", 1)])
    two = write_folder(tmp_path / "two", [record("xray", 2)], demo(**change))
    with pytest.raises(
        ValueError, match=r"both hold xray \(geometric\)"
    ) as error:
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


def test_every_variant_is_told_the_floor(tmp_path: Path) -> None:
    rollout = record("xray", 1, occupancy="learned")
    one = write_folder(tmp_path / "one", [rollout])
    two = write_folder(
        tmp_path / "two",
        [rollout],
        demo(perception__geometric__floor=[-0.2, 0.2, -0.2, 0.2]),
    )
    with pytest.raises(ValueError, match=r"both hold xray \(learned\)"):
        collect([one, two])


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


def test_a_line_cut_short_is_left_out(tmp_path: Path) -> None:
    folder = write_folder(
        tmp_path / "a", [record("xray", 1), record("xray", 2)]
    )
    path = folder / ROLLOUTS
    path.write_text(path.read_text(encoding="utf-8")[:-20], encoding="utf-8")
    (kept,) = read_rollouts(folder)
    assert kept == json.loads(json.dumps(record("xray", 1)))


def test_a_record_may_name_its_files_by_another_path(tmp_path: Path) -> None:
    own = {"seed": 1, "policy__name": "random"}
    scenario = demo(**own, scene__meshes=["meshes/tools"])
    for i, (path, belongs) in enumerate(
        [
            ("meshes/tools", True),
            ("/somewhere/meshes/tools", True),
            ("meshes/toys", False),
        ]
    ):
        text = dump_scenario(demo(**own, scene__meshes=[path]))
        item = record("random", 1, scenario=text)
        folder = write_folder(tmp_path / str(i), [item], scenario)
        if belongs:
            assert collect([folder]).records == [item]
        else:
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
        camera__X_PB__translation=[0.0, 0.0, 0.9],
    )
    found = changes(changed)
    assert "horizon 5, not 10" in found
    assert "scene.meshes [/a, /b], not []" in found
    assert "camera.X_PB.translation [0.0, 0.0, 0.9], not [0.0, 0.0, 0.8]" in (
        found
    )
    folder = write_folder(tmp_path / "a", [record("xray", 1)], changed)
    assert collect([folder]).changed == tuple(
        text for text in found if not text.startswith("perception.occupancy")
    )
    own = replace(changed, name="mine")
    assert changes(own) == ()
