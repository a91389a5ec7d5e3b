import numpy as np
import pytest
from pydrake.geometry import Meshcat

from tests.meshcat_probe import click
from xray_drake.inspector.session import BUTTONS, InteractiveSearch
from xray_drake.messages import Outcome
from xray_drake.station.scenario import Scenario


@pytest.fixture
def scenario() -> Scenario:
    """Three objects of which the largest goes first: several actions."""
    scenario = Scenario(name="live", seed=5, horizon=2)
    scenario.scene.num_objects = 3
    scenario.policy.name = "largest"
    scenario.policy.target_first = False
    return scenario


def until_idle(session: InteractiveSearch) -> int:
    """Polls until there is nothing left to do; returns how often."""
    for count in range(1000):
        if not session.poll():
            return count
    raise AssertionError("the session never became idle")


def test_buttons_drive_the_search(meshcat: Meshcat, scenario: Scenario) -> None:
    shares: list[float] = []
    told: list[tuple[str, int]] = []

    class Observer:
        def decided(self, diagram, context, action) -> None:
            told.append(("decided", action.number))

        def ended(self, diagram, context, record) -> None:
            told.append(("ended", record.step))

    session = InteractiveSearch(
        scenario, meshcat, observers=(Observer(),), progress=shares.append
    )
    assert session.record is None
    assert sorted(meshcat.GetButtonNames()) == sorted(BUTTONS)

    # The first poll drops the heap, and then waits.
    assert session.poll()
    assert shares[-1] == 1.0
    assert meshcat.HasPath("/drake/visualizer/box_2to1")
    assert not session.poll()
    first = session.record
    assert first.seed == 5

    # A step ends with a decision that is shown before the gripper moves.
    click(meshcat, "step")
    assert until_idle(session) > 0
    assert told == [("decided", 1)]
    assert [a.outcome for a in first.actions] == [Outcome.NONE]
    assert meshcat.HasPath("/inspect/occupancy/step_01")
    assert not session.poll()

    # The next step executes it and decides again.
    click(meshcat, "step")
    until_idle(session)
    assert told == [("decided", 1), ("ended", 1), ("decided", 2)]
    assert not first.end

    click(meshcat, "run")
    until_idle(session)
    assert told[-1] == ("ended", 2)
    assert first.end in {"horizon", "success"}
    # After the end these do nothing.
    for name in ("step", "run"):
        click(meshcat, name)
        assert not session.poll()
    assert session.record is first

    # A new heap is that of the next seed, and waits.
    click(meshcat, "new heap")
    assert session.poll()
    assert not session.poll()
    second = session.record
    assert second is not first
    assert (second.seed, second.actions, second.end) == (6, [], "")
    assert second.objects != first.objects
    assert not meshcat.HasPath("/inspect/occupancy/step_01")
    assert not meshcat.HasPath(f"/drake/visualizer/{first.objects[0]}")
    assert scenario.seed == 5, "the caller's scenario is left alone"


def test_ctrl_c_ends_the_session_with_the_record(
    meshcat: Meshcat, scenario: Scenario
) -> None:
    class CtrlC:
        def decided(self, diagram, context, action) -> None:
            raise KeyboardInterrupt

        def ended(self, diagram, context, record) -> None:
            pass

    scenario.scene.num_objects = 1
    session = InteractiveSearch(scenario, meshcat, observers=(CtrlC(),))
    session.new_heap(8)
    session.run()
    session.loop()
    assert session.record.seed == 8
    assert session.record.end == "interrupted"
    assert session.record.num_actions == 1
    assert meshcat.GetButtonNames() == []
    assert np.isfinite(session.record.start["target_visible_fraction"])
