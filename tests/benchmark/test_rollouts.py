import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from xray_drake.benchmark.rollouts import (
    ROLLOUTS,
    SCENARIO,
    Job,
    read_rollouts,
    run_job,
    run_rollouts,
)
from xray_drake.station.scenario import Scenario, dump_scenario

POLICIES = ("largest", "random")
SEEDS = (5, 6)


def tiny() -> Scenario:
    scenario = Scenario(name="tiny", horizon=1)
    scenario.scene.num_objects = 2
    return scenario


def run(folder: Path, **changes: object) -> list[dict]:
    arguments = {
        "policies": POLICIES,
        "seeds": SEEDS,
        "folder": folder,
        "workers": 1,
    }
    return list(run_rollouts(tiny(), **(arguments | changes)))


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which all rollouts are done."""
    folder = tmp_path_factory.mktemp("benchmark") / "new" / "folder"
    yielded = run(folder)
    assert yielded == read_rollouts(folder)
    return folder


@pytest.fixture
def copy(finished: Path, tmp_path: Path) -> Path:
    return shutil.copytree(finished, tmp_path / "copy")


@pytest.fixture
def no_heaps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Makes the start of a worker an error."""

    def start(*_: object, **__: object) -> None:
        raise AssertionError("a heap is run again")

    monkeypatch.setattr("concurrent.futures.ProcessPoolExecutor.submit", start)


def keys(records: list[dict]) -> list[tuple[int, str]]:
    return sorted((r["seed"], r["policy"]) for r in records)


def test_each_rollout_is_one_line(finished: Path) -> None:
    lines = (finished / ROLLOUTS).read_text(encoding="utf-8").splitlines()
    records = [json.loads(line) for line in lines]
    assert keys(records) == [(s, p) for s in SEEDS for p in POLICIES]
    for record in records:
        assert record["end"] in {"success", "horizon", "nothing_graspable"}
        assert record["num_actions"] == len(record["actions"]) == 1
        assert record["horizon"] == 1


def test_policies_search_the_same_heap(finished: Path) -> None:
    heaps = {seed: [] for seed in SEEDS}
    for record in read_rollouts(finished):
        heaps[record["seed"]].append(record)
    for largest, random in heaps.values():
        assert largest["policy"] != random["policy"]
        assert largest["objects"] == random["objects"]
        assert largest["start"] == random["start"]
        first = [r["actions"][0]["support_before"] for r in (largest, random)]
        assert first[0] == first[1]
    first, second = heaps.values()
    assert first[0]["objects"] != second[0]["objects"]


def test_what_is_done_is_not_run_again(copy: Path, no_heaps: None) -> None:
    before = (copy / ROLLOUTS).read_bytes()
    assert run(copy) == []
    assert run(copy, policies=POLICIES[:1], seeds=SEEDS[1:]) == []
    assert (copy / ROLLOUTS).read_bytes() == before


def test_a_line_cut_short_is_run_again(copy: Path) -> None:
    path = copy / ROLLOUTS
    whole = read_rollouts(copy)
    text = path.read_text(encoding="utf-8")
    path.write_text(text[:-200], encoding="utf-8")
    kept = read_rollouts(copy)
    assert kept == whole[:-1]

    (again,) = run(copy)
    assert keys([again]) == keys(whole[-1:])
    # And now it is done: the rest of the cut line does not spoil the new one.
    assert keys(read_rollouts(copy)) == keys(whole)
    for field in ("objects", "start", "end"):
        assert again[field] == whole[-1][field]


def change_horizon(scenario: Scenario) -> None:
    scenario.horizon = 2


def change_physics(scenario: Scenario) -> None:
    scenario.plant_config.time_step = 0.004


@pytest.mark.parametrize("change", [change_horizon, change_physics])
def test_another_scenario_needs_another_folder(
    change: Callable[[Scenario], None], copy: Path, no_heaps: None
) -> None:
    other = tiny()
    change(other)
    before = (copy / SCENARIO).read_bytes()
    rollouts = run_rollouts(
        other, policies=POLICIES, seeds=SEEDS, folder=copy, workers=1
    )
    with pytest.raises(ValueError, match=str(copy)):
        next(rollouts)
    assert (copy / SCENARIO).read_bytes() == before


def test_a_heap_that_fails_is_a_record_too() -> None:
    scenario = tiny()
    scenario.scene.heap.max_attempts = 1
    scenario.scene.heap.rest_timeout = 1e-3
    scenario.scene.heap.drop_period = 0.01
    records = run_job(Job(dump_scenario(scenario), 5, POLICIES))
    assert keys(records) == [(5, policy) for policy in POLICIES]
    for record in records:
        assert record["end"] == "error"
        assert "5" in record["reason"]
        assert len(record["reason"].splitlines()) == 1
        assert record["success"] is False


def test_a_folder_without_rollouts_has_none(tmp_path: Path) -> None:
    assert read_rollouts(tmp_path) == []
    assert read_rollouts(tmp_path / "none") == []
