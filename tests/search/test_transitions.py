from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from pydrake.systems.framework import Context

from tests.search.records import stripped
from xray_drake.gripper.transfer import Transfer
from xray_drake.messages import Outcome, SearchAction
from xray_drake.scene.heap import Heap
from xray_drake.search.diagram import SearchDiagram, build_search_diagram
from xray_drake.search.record import ActionRecord, SearchRecord
from xray_drake.search.rollout import run_search
from xray_drake.search.transitions import TransitionRecall, Transitions
from xray_drake.station.scenario import Scenario


class Tries:
    """Counts the actions that grippers really begin."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.number = 0
        begin = Transfer.begin

        def counted(transfer: Transfer, *arguments: Any) -> Any:
            self.number += 1
            return begin(transfer, *arguments)

        monkeypatch.setattr(Transfer, "begin", counted)

    def since(self, search: Callable[[], SearchRecord]) -> tuple[Any, int]:
        before = self.number
        return search(), self.number - before


@pytest.fixture
def tries(monkeypatch: pytest.MonkeyPatch) -> Tries:
    return Tries(monkeypatch)


def searching(scenario: Scenario, heap: Heap, policy: str) -> SearchDiagram:
    return build_search_diagram(
        replace(scenario, policy=replace(scenario.policy, name=policy)),
        heap=heap,
    )


def clumsy(scenario: Scenario) -> Scenario:
    """Some grasps of it fail."""
    scenario.gripper.quasi_static.perturbation.position_sigma = 0.006
    return scenario


class Ends:
    """Notes where everything lies when actions end."""

    def __init__(self) -> None:
        self.poses: list[np.ndarray] = []

    def decided(
        self, diagram: SearchDiagram, context: Context, action: SearchAction
    ) -> None: ...

    def ended(
        self, diagram: SearchDiagram, context: Context, record: ActionRecord
    ) -> None:
        plant = diagram.station.plant
        self.poses.append(
            np.array(plant.GetPositions(plant.GetMyContextFromRoot(context)))
        )


def test_a_search_that_is_known_is_not_simulated_again(
    tiny_scenario: Scenario, tiny_heap: Heap, tries: Tries
) -> None:
    transitions = Transitions()
    before, after = Ends(), Ends()

    search = partial(
        run_search,
        searching(clumsy(tiny_scenario), tiny_heap, "xray"),
        transitions=transitions,
    )
    first, begun = tries.since(partial(search, observers=(before,)))
    again, begun_again = tries.since(partial(search, observers=(after,)))
    assert begun == first.num_actions == len(transitions) > 2
    assert begun_again == 0
    assert stripped(again) == stripped(first)
    # It would prove little if nothing failed.
    assert {Outcome.FAILED, Outcome.LIFTED} <= {
        action.outcome for action in first.actions
    }
    np.testing.assert_array_equal(after.poses, before.poses)


def test_searches_that_part_are_what_they_were(
    tiny_scenario: Scenario, tiny_heap: Heap, tries: Tries
) -> None:
    scenario = clumsy(tiny_scenario)
    transitions = Transitions()
    saved = 0
    for policy in ("largest", "xray", "random", "oracle"):
        search = partial(searching, scenario, tiny_heap, policy)
        alone, begun = tries.since(partial(run_search, search()))
        shared, begun_shared = tries.since(
            partial(run_search, search(), transitions=transitions)
        )
        assert stripped(shared) == stripped(alone)
        assert begun == alone.num_actions
        saved += begun - begun_shared
    assert saved > 0


def test_another_order_is_another_heap(
    tiny_scenario: Scenario, tiny_heap: Heap, tries: Tries
) -> None:
    """The same first grasp is known, the same grasp later is not."""
    transitions = Transitions()
    diagram = searching(tiny_scenario, tiny_heap, "xray")
    first = run_search(diagram, transitions=transitions)
    recall = TransitionRecall(diagram, transitions)
    context = diagram.CreateDefaultContext()
    one, other = (
        SearchAction(number=n, grasp=first.actions[n - 1].grasp) for n in (1, 2)
    )
    recall.decided(diagram, context, other)
    assert recall._next is None
    recall = TransitionRecall(diagram, transitions)
    recall.decided(diagram, context, one)
    assert recall._next is not None
    nearly = replace(
        one, grasp=replace(one.grasp, width=one.grasp.width + 1e-9)
    )
    recall = TransitionRecall(diagram, transitions)
    recall.decided(diagram, context, nearly)
    assert recall._next is None


def test_the_state_of_execution_by_contact_is_not_kept(
    tiny_scenario: Scenario, tiny_heap: Heap
) -> None:
    tiny_scenario.gripper.execution = "contact"
    diagram = build_search_diagram(tiny_scenario, heap=tiny_heap)
    with pytest.raises(ValueError, match="quasi-static"):
        run_search(diagram, transitions=Transitions())
