"""Searches that are executed by contact."""

import numpy as np
import pytest

from tests.nominal import BIN, TOTE
from tests.search.watching import TARGET, Sleepers, Watcher
from xray_drake.messages import GripperMode, Outcome
from xray_drake.scene.heap import Heap
from xray_drake.search.diagram import SearchDiagram, build_search_diagram
from xray_drake.search.monitor import judge_outcome
from xray_drake.search.rollout import run_search
from xray_drake.station.scenario import Scenario


def by_contact(scenario: Scenario) -> Scenario:
    scenario.gripper.execution = "contact"
    return scenario


@pytest.fixture(scope="module")
def diagram(tiny_heap: Heap) -> SearchDiagram:
    scenario = by_contact(Scenario(name="tiny", seed=7))
    scenario.policy.target_first = False
    return build_search_diagram(scenario, heap=tiny_heap)


@pytest.fixture(scope="module")
def watcher() -> Watcher:
    return Watcher()


@pytest.fixture(scope="module")
def found(diagram: SearchDiagram, watcher: Watcher) -> Sleepers:
    return Sleepers(diagram, limit=120.0, observers=(watcher,))


def test_the_target_is_brought_to_the_tote(
    found: Sleepers, watcher: Watcher
) -> None:
    record = found.record
    assert record.end == "success"
    assert record.execution == "contact"
    last = record.actions[-1]
    assert (last.object, last.outcome) == (TARGET, Outcome.LIFTED)
    assert last.lifted == (TARGET,)
    assert TOTE.holds(watcher.poses[-1][TARGET][:3, 3])
    taken = {name for action in record.actions for name in action.lifted}
    assert "book" in taken
    for name, X_WO in watcher.poses[-1].items():
        place = TOTE.holds if name in taken else BIN.is_over
        assert place(X_WO[:3, 3]), name
    assert all(3.0 < action.duration <= 15.0 for action in record.actions)


def test_pictures_are_of_a_heap_at_rest(
    found: Sleepers, watcher: Watcher, tiny_heap: Heap
) -> None:
    everything = {model.name for model in tiny_heap.models}
    for (what, _), locked in zip(watcher.told, watcher.locked, strict=True):
        assert what == "ended" or locked == everything
    # From the end of an action to the next decision nothing moves.
    ends, decisions = watcher.poses[1:-1:2], watcher.poses[2::2]
    assert len(ends) == len(decisions) > 0
    for before, after in zip(ends, decisions, strict=True):
        for name, X_WO in after.items():
            np.testing.assert_allclose(X_WO, before[name], atol=1e-3)


def test_what_is_far_from_the_gripper_sleeps(
    found: Sleepers, tiny_heap: Heap
) -> None:
    everything = {model.name for model in tiny_heap.models}
    books = [
        (status, everything - asleep)
        for status, asleep in found.seen
        if status.number == 1 and status.mode is GripperMode.BUSY
    ]
    assert found.record.actions[0].object == "book"
    assert books[0][1] == set()
    held = [awake for status, awake in books if status.held]
    assert held
    assert all("book" in awake for awake in held)
    # What lay under the book is awake when it goes; the bystanders never are.
    assert any({"pad", TARGET} <= awake for awake in held)
    assert all(not {"block", "plank"} & awake for _, awake in books)
    # On the way to the tote all but the book sleep.
    assert {"book"} in held
    assert books[-1][1] == set()


@pytest.mark.parametrize(
    ("setting", "value", "outcome", "reason"),
    [
        ("seal_timeout", 0.0, Outcome.FAILED, "the cup does not seal"),
        # No vacuum is enough, so it falls over the bin.
        ("lost", 2.0, Outcome.SLIPPED, "the vacuum is gone"),
    ],
)
def test_what_does_not_hold_is_still_there(
    tiny_scenario: Scenario,
    tiny_heap: Heap,
    setting: str,
    value: float,
    outcome: Outcome,
    reason: str,
) -> None:
    scenario = by_contact(tiny_scenario)
    scenario.horizon = 1
    diagram = build_search_diagram(scenario, heap=tiny_heap)
    # A scenario that says so would be refused.
    setattr(scenario.gripper.contact, setting, value)
    watcher = Watcher()
    record = run_search(diagram, observers=(watcher,))
    assert record.end == "horizon"
    (action,) = record.actions
    assert (action.object, action.lifted) == ("book", ())
    assert (action.outcome, action.reason) == (outcome, reason)
    places = {n: X_WO[:3, 3] for n, X_WO in watcher.poses[-1].items()}
    assert BIN.is_over(places["book"])
    if outcome is Outcome.FAILED:
        for name, X_WO in tiny_heap.poses.items():
            np.testing.assert_allclose(places[name], X_WO[:3, 3], atol=2e-3)


@pytest.mark.parametrize(
    ("felt", "meant", "brought", "outcome", "said"),
    [
        ("LIFTED", "book", "book", "LIFTED", ""),
        ("LIFTED", "book", "book pad", "LIFTED", ""),
        ("LIFTED", "book", "pad", "LIFTED", "it took pad in place of book"),
        ("LIFTED", "book", "", "SLIPPED", "it fell off unnoticed"),
        ("SLIPPED", "book", "book", "LIFTED", ""),
        ("SLIPPED", "book", "", "SLIPPED", "felt"),
        ("FAILED", "book", "", "FAILED", "felt"),
        ("NO_GRASP", "book", "", "NO_GRASP", "felt"),
        # What was meant may be unknown.
        ("FAILED", "", "pad", "LIFTED", ""),
        ("FAILED", "", "", "FAILED", "felt"),
    ],
)
def test_what_counts_is_what_lies_in_the_tote(
    felt: str, meant: str, brought: str, outcome: str, said: str
) -> None:
    reason = "" if felt == "LIFTED" else "felt"
    judged = judge_outcome(Outcome[felt], reason, meant, brought.split())
    assert judged == (Outcome[outcome], said)


def test_the_camera_does_not_see_the_gripper_at_home(
    diagram: SearchDiagram, tiny_diagram: SearchDiagram
) -> None:
    depths = [
        d.GetOutputPort("overhead.depth_image")
        .Eval(d.CreateDefaultContext())
        .data
        for d in (diagram, tiny_diagram)
    ]
    # Rendered among other triangles, a pixel may differ by a last digit.
    np.testing.assert_allclose(*depths, atol=1e-6)
