from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from tests.search.watching import Watcher, stripped
from xray_drake.gripper.transfer import Transfer
from xray_drake.messages import Grasp, Outcome, SearchAction
from xray_drake.scene.heap import Heap
from xray_drake.search.diagram import SearchDiagram, build_search_diagram
from xray_drake.search.rollout import run_search
from xray_drake.search.transitions import TransitionRecall, Transitions
from xray_drake.station.scenario import Scenario


@pytest.fixture
def begun(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The actions that grippers really begin."""
    actions = []
    begin = Transfer.begin

    def counted(transfer: Transfer, *arguments: Any) -> Any:
        actions.append(arguments)
        return begin(transfer, *arguments)

    monkeypatch.setattr(Transfer, "begin", counted)
    return actions


@pytest.fixture
def clumsy(tiny_scenario: Scenario) -> Scenario:
    """Some grasps of it fail."""
    tiny_scenario.gripper.quasi_static.perturbation.position_sigma = 0.006
    return tiny_scenario


def searching(scenario: Scenario, heap: Heap, policy: str) -> SearchDiagram:
    return build_search_diagram(
        replace(scenario, policy=replace(scenario.policy, name=policy)),
        heap=heap,
    )


def test_a_search_that_is_known_is_not_simulated_again(
    clumsy: Scenario, tiny_heap: Heap, begun: list[Any]
) -> None:
    transitions = Transitions()
    before, after = Watcher(), Watcher()
    diagram = searching(clumsy, tiny_heap, "xray")
    first, again = (
        run_search(diagram, observers=(watcher,), transitions=transitions)
        for watcher in (before, after)
    )
    assert len(begun) == first.num_actions == len(transitions) > 2
    assert stripped(again) == stripped(first)
    # It would prove little if nothing failed.
    outcomes = {action.outcome for action in first.actions}
    assert {Outcome.FAILED, Outcome.LIFTED} <= outcomes
    for one, other in zip(before.poses, after.poses, strict=True):
        for name, X_WO in one.items():
            np.testing.assert_array_equal(other[name], X_WO)


def test_searches_that_part_are_what_they_were(
    clumsy: Scenario, tiny_heap: Heap, begun: list[Any]
) -> None:
    transitions = Transitions()
    clumsy.horizon = 4
    saved = 0
    for policy in ("largest", "xray", "random", "oracle"):
        begun.clear()
        alone = run_search(searching(clumsy, tiny_heap, policy))
        assert len(begun) == alone.num_actions
        shared = run_search(
            searching(clumsy, tiny_heap, policy), transitions=transitions
        )
        assert stripped(shared) == stripped(alone)
        saved += 2 * alone.num_actions - len(begun)
    assert saved > 0


def test_another_order_is_another_heap(
    tiny_scenario: Scenario, tiny_heap: Heap
) -> None:
    """The same first grasp is known, the same grasp later is not."""
    transitions = Transitions()
    diagram = searching(tiny_scenario, tiny_heap, "xray")
    first = run_search(diagram, transitions=transitions)

    def known(grasp: Grasp) -> bool:
        recall = TransitionRecall(diagram, transitions)
        simulator = Simulator(diagram)
        action = SearchAction(number=1, grasp=grasp)
        recall.decided(diagram, simulator.get_context(), action)
        recall.skip(simulator)
        return simulator.get_context().get_time() > 0

    one, other = (action.grasp for action in first.actions[:2])
    assert known(one)
    assert not known(other)
    assert not known(replace(one, width=one.width + 1e-9))


def test_the_state_of_execution_by_contact_is_not_kept(
    tiny_scenario: Scenario, tiny_heap: Heap
) -> None:
    tiny_scenario.gripper.execution = "contact"
    diagram = build_search_diagram(tiny_scenario, heap=tiny_heap)
    with pytest.raises(ValueError, match="quasi-static"):
        run_search(diagram, transitions=Transitions())
