import signal
from collections.abc import Iterator

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator, SimulatorStatus
from pydrake.systems.framework import Context

from tests.nominal import BIN, TOTE
from tests.search.watching import (
    TARGET,
    Sleepers,
    Watcher,
    always_failing,
    stripped,
)
from xray_drake.messages import Outcome
from xray_drake.scene.heap import Heap
from xray_drake.search import rollout
from xray_drake.search.diagram import SearchDiagram, build_search_diagram
from xray_drake.search.monitor import attach_monitor
from xray_drake.search.record import SearchRecord
from xray_drake.search.rollout import run_search
from xray_drake.station.scenario import Scenario


@pytest.fixture(scope="module")
def watcher() -> Watcher:
    return Watcher()


@pytest.fixture(scope="module")
def found(tiny_diagram: SearchDiagram, watcher: Watcher) -> SearchRecord:
    return run_search(tiny_diagram, observers=(watcher,))


def test_the_target_is_dug_out(
    found: SearchRecord, watcher: Watcher, tiny_heap: Heap
) -> None:
    """Success is when it is clear of the bin."""
    assert found.end == "success"
    assert found.target == TARGET
    assert found.objects == [model.name for model in tiny_heap.objects]
    assert (found.policy, found.occupancy) == ("xray", "geometric")
    assert 2 <= found.num_actions <= found.horizon == 10
    last = found.actions[-1]
    assert (last.object, last.is_target) == (TARGET, True)
    assert last.outcome is Outcome.LIFTED
    lifted = [a.object for a in found.actions if a.outcome is Outcome.LIFTED]
    assert "book" in lifted[:-1]  # it lay on the target
    assert len(set(lifted)) == len(lifted)
    X_WT = watcher.poses[-1][TARGET]
    vertices = tiny_heap.target.visual.vertices
    lowest = (vertices @ X_WT[2, :3]).min() + X_WT[2, 3]
    assert lowest >= BIN.wall_height + 0.05
    assert np.hypot(*X_WT[:2, 3]) < 0.2  # above the bin still


def test_what_the_record_says_of_start_and_actions(found: SearchRecord) -> None:
    start = found.start
    assert start["target_visible_fraction"] == pytest.approx(0.16, abs=0.03)
    assert start["num_dropped"] == 4
    assert (start["attempts"], start["redrawn"]) == (1, 0)
    # Nothing but the book lies on it, and nothing lies on the book.
    assert start["num_covers"] == 1
    assert start["cover_fraction"] == pytest.approx(0.84, abs=0.03)
    f, book_top = 552.5, 0.8 - 0.025
    assert start["cover_pixels"] == pytest.approx(
        0.08 * 0.06 * (f / book_top) ** 2, rel=0.03
    )
    assert found.target_first is False
    for step, action in enumerate(found.actions, 1):
        assert action.step == step
        assert action.grasp.object == action.object != ""
        assert action.is_target == (action.object == TARGET)
        assert action.outcome in (
            Outcome.LIFTED,
            Outcome.FAILED,
            Outcome.SLIPPED,
        )
        assert bool(action.reason) == (action.outcome is not Outcome.LIFTED)
        assert action.support_before >= action.support_01_before > 0
        assert 0 <= action.target_visible_fraction <= 1
        assert 0.9 < action.true_mask_in_support <= 1
        assert set(action.seconds) >= {"perception", "occupancy", "planning"}
    for one, following in zip(found.actions, found.actions[1:], strict=False):
        assert one.support_after == following.support_before
        assert one.support_01_after == following.support_01_before
    last = found.actions[-1]
    assert (last.support_after, last.support_01_after) == (0, 0)
    assert last.target_visible_fraction > 0.9
    assert last.support_before < 0.7 * found.actions[0].support_before


def test_the_heap_sleeps_between_the_actions(
    found: SearchRecord, watcher: Watcher, tiny_heap: Heap
) -> None:
    assert watcher.told == [
        (what, step)
        for step in range(1, found.num_actions + 1)
        for what in ("decided", "ended")
    ]
    everything = {model.name for model in tiny_heap.models}
    assert all(locked == everything for locked in watcher.locked[::2])
    # What nobody touched is where it was, to a fraction of a millimetre.
    touched = {action.object for action in found.actions}
    places = {name: X[:3, 3] for name, X in watcher.poses[-1].items()}
    for name in everything - touched - {"pad"}:
        np.testing.assert_allclose(
            places[name], tiny_heap.poses[name][:3, 3], atol=5e-4
        )
    for action in found.actions[:-1]:
        if action.outcome is Outcome.LIFTED:
            assert TOTE.holds(places[action.object])


def test_who_sleeps_during_an_action(
    found: SearchRecord, tiny_diagram: SearchDiagram, tiny_heap: Heap
) -> None:
    sleepers = Sleepers(tiny_diagram)
    assert stripped(sleepers.record) == stripped(found)
    everything = {model.name for model in tiny_heap.models}
    taken: list[str] = []
    lifted: dict[str, list[set[str]]] = {}
    settled = 0
    for status, asleep in sleepers.seen[:-1]:
        assert status.held not in asleep
        assert not asleep.intersection(status.loose)
        if status.held and status.held not in taken:
            taken.append(status.held)
        removed = set(taken) - {status.held}
        assert removed - set(status.loose) <= asleep
        settled += status.settling
        if status.stirring:
            lifted.setdefault(status.held, []).append(everything - asleep)
        else:
            assert asleep == everything - set(status.loose)
    assert settled > 0
    # The book lies on the target and the pad; block and plank stand apart.
    assert lifted["book"][0] == {"book", "pad", TARGET}
    assert all(awake <= lifted["book"][0] for awake in lifted["book"])
    assert all({"block", "plank"} & awake == set() for awake in lifted[TARGET])


@pytest.mark.parametrize(
    ("setting", "value", "outcome"),
    [
        ("settle_awake", True, Outcome.LIFTED),
        ("slip_distance", 1e-4, Outcome.SLIPPED),
    ],
)
def test_all_are_awake_until_rest_after_a_slip_or_where_the_scenario_says_so(
    setting: str,
    value: float,
    outcome: Outcome,
    tiny_scenario: Scenario,
    tiny_heap: Heap,
) -> None:
    tiny_scenario.horizon = 1
    setattr(tiny_scenario.gripper.quasi_static, setting, value)
    sleepers = Sleepers(build_search_diagram(tiny_scenario, heap=tiny_heap))
    assert sleepers.record.actions[0].outcome is outcome
    settling = [asleep for status, asleep in sleepers.seen if status.settling]
    assert len(settling) > 20
    assert all(asleep == set() for asleep in settling)
    assert sleepers.seen[-1][1] == {model.name for model in tiny_heap.models}


def test_a_network_computes_in_what_the_scenario_and_the_record_say(
    tiny_diagram: SearchDiagram, tiny_scenario: Scenario, tiny_heap: Heap
) -> None:
    def recorded(diagram: SearchDiagram) -> str:
        monitor = attach_monitor(Simulator(diagram), diagram)
        return monitor.record.to_dict()["dtype"]

    assert recorded(tiny_diagram) == ""  # there is no network
    tiny_scenario.perception.occupancy = "learned"
    answers = []
    for dtype in ("float32", "bfloat16"):
        tiny_scenario.perception.dtype = dtype
        diagram = build_search_diagram(tiny_scenario, heap=tiny_heap)
        assert recorded(diagram) == dtype
        port = diagram.GetOutputPort("occupancy_inference.occupancy")
        answers.append(port.Eval(diagram.CreateDefaultContext()).data)
    assert 0 < np.abs(answers[0] - answers[1]).max() < 0.3


def test_a_plain_simulator_with_the_monitor_ends_alike(
    found: SearchRecord, tiny_scenario: Scenario, tiny_heap: Heap
) -> None:
    """Of another diagram of the same scenario, too."""
    diagram = build_search_diagram(tiny_scenario, heap=tiny_heap)
    simulator = Simulator(diagram)
    monitor = attach_monitor(simulator, diagram)
    status = simulator.AdvanceTo(60.0)
    reached = SimulatorStatus.ReturnReason.kReachedTerminationCondition
    assert status.reason() == reached
    assert "success" in status.message()
    time = simulator.get_context().get_time()
    assert time < 30.0
    simulator.AdvanceTo(time + 5.0)
    assert simulator.get_context().get_time() < time + 0.1
    assert stripped(monitor.record) == stripped(found)


def test_a_scenario_will_do() -> None:
    """Its heap is dropped then."""
    scenario = Scenario(seed=10_000, horizon=2)
    scenario.scene.num_objects = 1
    shares: list[float] = []
    record = run_search(scenario, progress=shares.append)
    assert record.seed == 10_000
    assert record.end in ("success", "horizon")
    assert 1 <= record.num_actions <= 2
    assert len(record.objects) == 1
    assert shares[-1] == 1.0


def test_the_horizon_ends_it(tiny_scenario: Scenario, tiny_heap: Heap) -> None:
    tiny_scenario.horizon = 2
    watcher = Watcher()
    record = run_search(
        build_search_diagram(always_failing(tiny_scenario), heap=tiny_heap),
        observers=(watcher,),
    )
    assert (record.end, record.success) == ("horizon", False)
    assert [a.outcome for a in record.actions] == [Outcome.FAILED] * 2
    assert all(action.reason for action in record.actions)
    last = record.actions[-1]
    assert (last.support_after, last.support_01_after) == (
        last.support_before,
        last.support_01_before,
    )
    # A failure moves nothing at all, and the same grasp is not tried again.
    for name, X_WO in watcher.poses[0].items():
        np.testing.assert_array_equal(watcher.poses[-1][name], X_WO)
    first, second = (action.grasp for action in record.actions)
    assert first.object != second.object or not np.allclose(
        first.X_OG, second.X_OG, atol=1e-3
    )


def test_nothing_graspable(tiny_scenario: Scenario, tiny_heap: Heap) -> None:
    tiny_scenario.cell.gripper.parameters = {
        "force": 1e-6,
        "vacuum_force": 1e-6,
    }
    record = run_search(build_search_diagram(tiny_scenario, heap=tiny_heap))
    assert record.end == "nothing_graspable"
    (action,) = record.actions
    assert (action.outcome, action.object) == (Outcome.NO_GRASP, "")
    assert action.support_after == action.support_before > 0


def test_a_target_that_leaves_the_bin_is_lost(
    tiny_scenario: Scenario, tiny_heap: Heap
) -> None:
    def throw_out(diagram: SearchDiagram, context: Context) -> None:
        plant = diagram.station.plant
        diagram.station.objects[TARGET].joint.SetPose(
            plant.GetMyMutableContextFromRoot(context),
            RigidTransform([0.4, 0.3, 0.05]),
        )

    tiny_scenario.policy.name = "largest"
    record = run_search(
        build_search_diagram(always_failing(tiny_scenario), heap=tiny_heap),
        observers=(Watcher(decided=throw_out),),
    )
    assert record.end == "target_lost"
    assert record.num_actions == 1
    assert not record.actions[0].is_target


@pytest.fixture
def heeds_sigint() -> Iterator[None]:
    """A shell's background jobs ignore the signal, tests among them."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize(
    ("when", "end", "number"),
    [
        pytest.param(("decided", 2), "interrupted", 2, id="on the way"),
        pytest.param(("ended", 3), "horizon", 3, id="after the end"),
    ],
)
def test_ctrl_c_keeps_the_record(
    tiny_scenario: Scenario,
    tiny_heap: Heap,
    heeds_sigint: None,
    when: tuple[str, int],
    end: str,
    number: int,
) -> None:
    def stop(diagram: SearchDiagram, context: Context) -> None:
        if watcher.told[-1] == when:
            signal.raise_signal(signal.SIGINT)

    watcher = Watcher(decided=stop, ended=stop)
    tiny_scenario.horizon = 3
    record = run_search(
        build_search_diagram(always_failing(tiny_scenario), heap=tiny_heap),
        observers=(watcher,),
    )
    assert (record.end, record.success) == (end, False)
    first, *_, last = record.to_dict()["actions"]
    assert record.num_actions == number
    assert first["outcome"] == "failed"
    assert first["support_after"] > 0
    assert last["object"]


def test_a_search_that_hangs_is_an_error(
    tiny_diagram: SearchDiagram, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rollout, "LONGEST_ACTION", 0.01)
    with pytest.raises(RuntimeError, match="seed 7"):
        run_search(tiny_diagram)


def test_an_observers_own_error_is_not_swallowed(
    tiny_diagram: SearchDiagram,
) -> None:
    def fail(diagram: SearchDiagram, context: Context) -> None:
        raise ZeroDivisionError("mine")

    with pytest.raises(ZeroDivisionError, match="mine"):
        run_search(tiny_diagram, observers=(Watcher(decided=fail),))


def test_a_monitor_can_be_attached_on_the_way(
    tiny_diagram: SearchDiagram,
) -> None:
    """As when a notebook's cell is executed twice."""
    simulator = Simulator(tiny_diagram)
    attach_monitor(simulator, tiny_diagram)
    simulator.Initialize()
    monitor = attach_monitor(simulator, tiny_diagram)
    simulator.AdvanceTo(5.0)
    assert monitor.record.actions[0].outcome is Outcome.LIFTED


def test_two_searches_of_one_diagram_take_turns(
    found: SearchRecord, tiny_diagram: SearchDiagram
) -> None:
    """Whatever the other does; planner and judge ask one collision scene."""

    def begun(*, block_on_book: bool) -> tuple[Simulator, SearchRecord]:
        root = tiny_diagram.CreateDefaultContext()
        if block_on_book:
            station = tiny_diagram.station
            p_WO = tiny_diagram.heap.poses["book"][:3, 3] + [0.0, 0.0, 0.04]
            station.plant.SetFreeBodyPose(
                station.plant.GetMyMutableContextFromRoot(root),
                station.objects["block"].body,
                RigidTransform(p_WO),
            )
        simulator = Simulator(tiny_diagram, root)
        return simulator, attach_monitor(simulator, tiny_diagram).record

    other, expected = begun(block_on_book=True)
    other.AdvanceTo(60.0)
    both = [begun(block_on_book=on) for on in (False, True)]
    for time in np.arange(0.15, 60.0, 0.15):
        for simulator, record in both:
            if not record.end:
                simulator.AdvanceTo(time)
    records = [stripped(record) for _, record in both]
    assert records == [stripped(found), stripped(expected)]
    assert records[0]["actions"] != records[1]["actions"]
