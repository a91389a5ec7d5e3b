"""The policies differ in nothing but the ranking, and what it is given."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.ports import inputs_of
from tests.search.watching import stripped
from xray_drake.policy.ranking import Scores, SearchView, largest
from xray_drake.policy.registry import POLICIES
from xray_drake.scene.heap import Heap
from xray_drake.search.diagram import build_search_diagram
from xray_drake.search.record import SearchRecord
from xray_drake.search.rollout import run_search
from xray_drake.station.scenario import Scenario


class Recorder:
    """A ranking that notes what it gets: the largest first."""

    def __init__(self) -> None:
        self.seen: list[tuple[Any, ...]] = []

    def __call__(self, view: SearchView, rng: np.random.Generator) -> Scores:
        labels, rho = view.instances.labels, view.occupancy.data
        named = view.candidates, view.instances.names
        self.seen.append(
            (*named, labels.tobytes(), rho.tobytes(), rng.random())
        )
        return largest(view, rng)


def nameless(record: SearchRecord) -> dict[str, Any]:
    """Returns the record without wall times and the policy's name."""
    data = stripped(record)
    name = data.pop("policy")
    data["scenario"] = data["scenario"].replace(f"name: {name}, ", "")
    return data


def test_one_ranking_under_any_name_gives_one_rollout(
    tiny_heap: Heap,
    tiny_scenario: Scenario,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Planner, candidates, perturbations, seeds: all else is the same."""
    recorders, records = [], []
    tiny_scenario.horizon = 2
    for name in ("xray", "random", "lookahead"):
        recorders.append(Recorder())
        kind = replace(POLICIES[name], ranking=recorders[-1])
        monkeypatch.setitem(POLICIES.registered, name, kind)
        tiny_scenario.policy.name = name
        diagram = build_search_diagram(tiny_scenario, heap=tiny_heap)
        records.append(run_search(diagram))
        assert records[-1].policy == name
        assert recorders[-1].seen == recorders[0].seen
        assert nameless(records[-1]) == nameless(records[0])
    assert len(recorders[0].seen) == records[0].num_actions >= 2


@pytest.mark.parametrize("name", POLICIES)
def test_each_gets_what_it_needs_and_no_more(
    name: str, tiny_heap: Heap, tiny_scenario: Scenario
) -> None:
    """The truth, above all, reaches the oracle alone."""
    tiny_scenario.policy.name = name
    diagram = build_search_diagram(tiny_scenario, heap=tiny_heap)
    boxes = {system.get_name(): system for system in diagram.GetSystems()}
    policy, inference = boxes["search_policy"], boxes["occupancy_inference"]
    ports = set(inputs_of(policy))
    assert ("true_target" in boxes) == ("true_target" in ports)
    assert ("true_target" in boxes) == (name == "oracle")
    assert ("search_memory" in boxes) == (name in ("memory", "combined"))
    imagines = name in ("lookahead", "grasp_aware", "combined")
    assert ({"depth_image", "camera"} <= ports) == imagines
    source = boxes.get("search_memory", boxes["heap_station"])
    output = source.GetOutputPort(
        "depth_image" if "search_memory" in boxes else "overhead.depth_image"
    )
    assert diagram.AreConnected(output, inference.GetInputPort("depth_image"))
    if imagines:
        assert diagram.AreConnected(output, policy.GetInputPort("depth_image"))
    outputs = [
        box.get_output_port(i)
        for box in boxes.values()
        for i in range(box.num_output_ports())
    ]
    for box in boxes.values():
        for port in inputs_of(box) if box.get_name() != "heap_station" else []:
            given = box.GetInputPort(port)
            assert any(diagram.AreConnected(o, given) for o in outputs), port


@pytest.mark.parametrize("name", ["oracle", "memory", "combined"])
def test_those_beyond_the_paper_dig_the_target_out(
    name: str, tiny_heap: Heap, tiny_scenario: Scenario
) -> None:
    tiny_scenario.policy.name = name
    record = run_search(build_search_diagram(tiny_scenario, heap=tiny_heap))
    assert record.success
    assert record.policy == name
    assert "book" in [action.object for action in record.actions]
    assert all(action.true_mask_in_support > 0.9 for action in record.actions)
