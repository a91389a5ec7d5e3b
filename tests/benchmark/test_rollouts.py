import json
import os
import shutil
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant

from tests.benchmark.synthetic import record
from xray_drake.benchmark import rollouts
from xray_drake.benchmark.records import ROLLOUTS, read_rollouts
from xray_drake.benchmark.rollouts import Job, run_job, run_rollouts
from xray_drake.benchmark.variants import Variant, variants
from xray_drake.files import InUseError
from xray_drake.provenance import Provenance, read_runs
from xray_drake.scene.heap import HeapError
from xray_drake.search import rollout
from xray_drake.station import objects
from xray_drake.station.scenario import Scenario, dump_scenario

VARIANTS = variants(("largest", "random"), ("geometric",))
SEEDS = (5, 6)


def tiny() -> Scenario:
    scenario = Scenario(name="tiny", horizon=1)
    scenario.scene.num_objects = 2
    return scenario


def run(folder: Path, **changes: Any) -> list[dict]:
    arguments: dict[str, Any] = {
        "variants": VARIANTS,
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

    def start(*_: object) -> None:
        raise AssertionError("a heap is run again")

    monkeypatch.setattr(
        "multiprocessing.context.ForkServerProcess.start", start
    )


def keys(records: list[dict]) -> list[tuple[int, str]]:
    return sorted((r["seed"], Variant.of(r).label) for r in records)


def test_each_rollout_is_one_line(finished: Path) -> None:
    lines = (finished / ROLLOUTS).read_text(encoding="utf-8").splitlines()
    records = [json.loads(line) for line in lines]
    assert keys(records) == [(s, v.label) for s in SEEDS for v in VARIANTS]
    for item in records:
        assert item["end"] in {"success", "horizon", "nothing_graspable"}
        assert item["num_actions"] == len(item["actions"]) == 1
        assert item["horizon"] == 1
        assert set(item["cpu_seconds"]) == {"drop", "rollout"}
        assert min(item["cpu_seconds"].values()) > 0


def test_policies_search_the_same_heap(finished: Path) -> None:
    heaps: dict[int, list[dict]] = {seed: [] for seed in SEEDS}
    for item in read_rollouts(finished):
        heaps[item["seed"]].append(item)
    for largest, random in heaps.values():
        assert largest["policy"] != random["policy"]
        assert largest["objects"] == random["objects"]
        assert largest["start"] == random["start"]
        first = [r["actions"][0]["support_before"] for r in (largest, random)]
        assert first[0] == first[1]
        # Dropped once for both.
        drops = {r["cpu_seconds"]["drop"] for r in (largest, random)}
        assert len(drops) == 1
    one, other = heaps.values()
    assert one[0]["objects"] != other[0]["objects"]


def test_what_is_done_is_not_run_again(copy: Path, no_heaps: None) -> None:
    before = (copy / ROLLOUTS).read_bytes()
    assert run(copy) == []
    assert run(copy, variants=VARIANTS[:1], seeds=SEEDS[1:]) == []
    # Blind policies are done, whatever infers a distribution.
    assert run(copy, variants=variants(("random",), ("learned",))) == []
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


def test_a_manifest_lies_beside_the_rollouts(finished: Path) -> None:
    (told,) = read_runs(finished)
    assert told["command"] == "benchmark"
    assert told["seeds"] == list(SEEDS)
    assert told["scenario"] == dump_scenario(tiny())
    assert told["settings"]["variants"] == [v.label for v in VARIANTS]
    for item in read_rollouts(finished):
        # Blind policies are asked for with the scenario's inference.
        assert Provenance.from_dict(item) == Provenance.from_dict(told)
        assert item["weights"].keys() == {"windowed.safetensors"}
        assert item["dtype"]


def test_who_writes_is_alone_until_he_ends(copy: Path) -> None:
    begun = run_rollouts(
        tiny(), variants=VARIANTS, seeds=(7,), folder=copy, workers=1
    )
    next(begun)
    with pytest.raises(InUseError):
        run(copy)
    # To read is no harm.
    assert len(read_rollouts(copy)) == 5
    begun.close()
    assert run(copy) == []


def test_a_heap_that_fails_is_a_record_too() -> None:
    scenario = tiny()
    scenario.scene.heap.max_attempts = 1
    scenario.scene.heap.rest_timeout = 1e-3
    scenario.scene.heap.drop_period = 0.01
    records = list(run_job(Job(dump_scenario(scenario), 5, VARIANTS)))
    assert keys(records) == [(5, variant.label) for variant in VARIANTS]
    for item in records:
        assert item["end"] == "error"
        assert "5" in item["reason"]
        assert len(item["reason"].splitlines()) == 1
        assert item["success"] is False


@pytest.fixture
def searched(
    monkeypatch: pytest.MonkeyPatch,
) -> list[tuple[object, Scenario]]:
    """Replaces drop and search; returns heap and scenario of each search."""
    seen: list[tuple[object, Scenario]] = []

    class Found:
        def __init__(self, scenario: Scenario, **_: Any) -> None:
            self.scenario = scenario

        def to_dict(self) -> dict[str, Any]:
            given = self.scenario
            return record(
                given.policy.name,
                given.seed,
                occupancy=given.perception.occupancy,
                target_first=given.policy.target_first,
            )

    def build(scenario: Scenario, *, heap: object) -> Scenario:
        seen.append((heap, scenario))
        return scenario

    monkeypatch.setattr(objects, "make_heap", lambda scenario: object())
    monkeypatch.setattr("xray_drake.search.diagram.build_search_diagram", build)
    monkeypatch.setattr(rollout, "run_search", Found)
    return seen


def test_all_variants_search_one_heap(
    searched: list[tuple[object, Scenario]],
) -> None:
    scenario = tiny()
    scenario.perception.occupancy = "learned"
    wanted = (
        Variant("random", target_first=False),
        *variants(("xray",), ("geometric", "posterior")),
    )
    records = list(run_job(Job(dump_scenario(scenario), 5, wanted)))
    assert [Variant.of(item) for item in records] == list(wanted)
    assert len({id(heap) for heap, _ in searched}) == 1
    assert {given.seed for _, given in searched} == {5}
    used = [
        (
            given.policy.name,
            given.policy.target_first,
            given.perception.occupancy,
        )
        for _, given in searched
    ]
    assert used == [
        ("random", False, "learned"),
        ("xray", True, "geometric"),
        ("xray", True, "posterior"),
    ]


def test_an_interrupted_search_is_no_record(
    searched: list[tuple[object, Scenario]], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Stopped:
        def __init__(self, scenario: Scenario, **_: Any) -> None: ...

        def to_dict(self) -> dict[str, Any]:
            return record("largest", 5, end="interrupted")

    monkeypatch.setattr(rollout, "run_search", Stopped)
    with pytest.raises(KeyboardInterrupt):
        list(run_job(Job(dump_scenario(tiny()), 5, VARIANTS)))


def dies_over_random(job: Job) -> Iterator[dict]:
    """A worker that is killed when it comes to the policy "random"."""
    for variant in job.variants:
        if variant.policy == "random":
            os.kill(os.getpid(), signal.SIGKILL)
        yield record(variant.policy, job.seed)


def test_a_worker_that_dies_costs_one_rollout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rollouts, "run_job", dies_over_random)
    wanted = variants(("largest", "random", "xray"), ("geometric",))
    records = run(tmp_path, variants=wanted)
    assert keys(records) == keys(read_rollouts(tmp_path))
    assert keys(records) == [
        (seed, label)
        for seed in SEEDS
        for label in ("largest", "random", "xray (geometric)")
    ]
    for item in records:
        if item["policy"] == "random":
            assert item["end"] == "error"
            assert item["reason"].startswith("its process was killed by SIG")
        else:
            assert item["end"] == "success"


def fails(job: Job) -> None:
    np.zeros(3) + np.zeros(4)


def test_a_fault_of_the_program_ends_the_benchmark(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rollouts, "run_job", fails)
    with pytest.raises(RuntimeError, match="seed 5: ValueError: op") as caught:
        run(tmp_path)
    (note,) = caught.value.__notes__
    assert "in fails" in note
    assert read_rollouts(tmp_path) == []


def hangs() -> None:
    raise RuntimeError("it\nhangs")


def fails_an_assertion() -> None:
    """As Drake's do: with a SystemExit."""
    MultibodyPlant(time_step=-1.0)


def finds_no_body() -> None:
    MultibodyPlant(time_step=0.0).GetBodyByName("x")


def drops_no_heap() -> None:
    raise HeapError("it stopped") from ValueError("of another kind")


@pytest.mark.parametrize(
    ("broken", "reason"),
    [
        (hangs, "RuntimeError: it hangs"),
        (fails_an_assertion, "SystemExit: Failure at "),
        (finds_no_body, "RuntimeError: "),
        (drops_no_heap, "it stopped"),
    ],
)
def test_a_simulation_that_breaks_down_costs_one_rollout(
    searched: list[tuple[object, Scenario]],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    broken: Callable[[], None],
    reason: str,
) -> None:
    found = rollout.run_search

    def run_search(scenario: Scenario, **options: Any) -> Any:
        if scenario.policy.name == "largest":
            broken()
        return found(scenario, **options)

    monkeypatch.setattr(rollout, "run_search", run_search)
    first, second = run_job(Job(dump_scenario(tiny()), 5, VARIANTS))
    assert first["end"] == "error"
    assert first["reason"].startswith(reason)
    assert first["cpu_seconds"]["drop"] >= 0
    assert second["end"] == "success"
    # The traceback of what Drake did not like is in the log.
    assert ("in run_search" in caplog.text) == (broken is not drops_no_heap)
