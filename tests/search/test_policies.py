"""The policies differ in nothing but the ranking."""

from typing import Any

import numpy as np
import pytest

from xray_drake.gripper.quasi_static import QuasiStaticGripper
from xray_drake.policy import ranking
from xray_drake.policy.ranking import SearchView
from xray_drake.policy.system import SearchPolicy
from xray_drake.scene.heap import Heap
from xray_drake.search import diagram as module
from xray_drake.search.diagram import build_search_diagram
from xray_drake.search.record import SearchRecord
from xray_drake.search.rollout import run_search
from xray_drake.station.scenario import POLICIES, Scenario


class Recorder:
    """A ranking that notes what it gets: the largest first."""

    def __init__(self) -> None:
        self.seen: list[tuple[Any, ...]] = []

    def __call__(
        self, view: SearchView, rng: np.random.Generator
    ) -> np.ndarray:
        self.seen.append(
            (
                view.candidates,
                view.instances.names,
                view.instances.labels.tobytes(),
                view.occupancy.data.tobytes(),
                rng.random(),
            )
        )
        areas = dict(
            zip(view.instances.names, view.instances.areas(), strict=True)
        )
        return np.array([[float(areas[name])] for name in view.candidates])


def stripped(record: SearchRecord) -> dict[str, Any]:
    data = record.to_dict()
    del data["policy"]
    for action in data["actions"]:
        del action["seconds"]
    return data


def test_there_are_three() -> None:
    assert set(POLICIES) == {"xray", "largest", "random"}
    assert set(ranking.RANKINGS) == set(POLICIES)


def test_one_ranking_under_three_names_gives_one_rollout(
    tiny_heap: Heap,
    tiny_scenario: Scenario,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Planner, candidates, perturbations, seeds: all else is the same."""
    recorders, records = {}, {}
    tiny_scenario.horizon = 2
    for name in POLICIES:
        recorders[name] = Recorder()
        monkeypatch.setitem(ranking.RANKINGS, name, recorders[name])
        tiny_scenario.policy.name = name
        diagram = build_search_diagram(tiny_scenario, heap=tiny_heap)
        records[name] = run_search(diagram)
        assert records[name].policy == name
    first, *others = POLICIES
    assert len(recorders[first].seen) == records[first].num_actions >= 2
    for name in others:
        assert recorders[name].seen == recorders[first].seen
        assert stripped(records[name]) == stripped(records[first])


def test_the_systems_are_built_alike(
    tiny_heap: Heap,
    tiny_scenario: Scenario,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The scenario's other settings reach planner, policy and gripper."""
    calls: list[dict[str, Any]] = []

    def noting(kind: type) -> Any:
        def build(*args: Any, **kwargs: Any) -> Any:
            built = kind(*args, **kwargs)
            calls.append({"kind": kind, "built": built, **kwargs})
            return built

        return build

    for kind in (SearchPolicy, QuasiStaticGripper, module.ModelGraspPlanner):
        monkeypatch.setattr(module, kind.__name__, noting(kind))
    tiny_scenario.policy.target_first = True
    for name in POLICIES:
        tiny_scenario.policy.name = name
        build_search_diagram(tiny_scenario, heap=tiny_heap)
    planners, policies, grippers = calls[::3], calls[1::3], calls[2::3]
    assert [call["ranking"] for call in policies] == [
        ranking.RANKINGS[name] for name in POLICIES
    ]
    for planner, policy, gripper in zip(
        planners, policies, grippers, strict=True
    ):
        assert policy["planner"] is gripper["judge"] is planner["built"]
        assert planner["seed"] == policy["seed"] == gripper["seed"] == 7
        assert planner["config"] is tiny_scenario.gripper.planner
        assert gripper["config"] is tiny_scenario.gripper.quasi_static
        assert policy["target_first"] is True
        assert policy["min_visible_pixels"] == 50
        assert policy["bodies"] == gripper["bodies"]
