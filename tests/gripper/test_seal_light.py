import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator

from tests.meshcat_probe import pose, prop
from tests.poses import at
from xray_drake.drawing.meshcat_layers import start_meshcat
from xray_drake.gripper.seal_light import SealLight
from xray_drake.gripper.suction import CupState

X_BC = at(0.15, 0.0, 0.02)
GRIPPER_PATH = "visualizer/yumi/gripper_base"


@pytest.fixture
def meshcat():
    return start_meshcat()


@pytest.fixture
def lit(meshcat):
    """A light's simulation, and what its cup does."""
    simulator = Simulator(
        SealLight(meshcat, X_BC, path=GRIPPER_PATH, radius=0.015, period=0.1)
    )
    value = (
        simulator.get_system()
        .get_input_port()
        .FixValue(
            simulator.get_mutable_context(), AbstractValue.Make(CupState())
        )
    )
    simulator.Initialize()
    return simulator, value


def test_it_is_drawn_around_the_lip_anew_with_each_simulation(meshcat, lit):
    simulator, _ = lit
    path = f"{GRIPPER_PATH}/sealed"
    X_BS = pose(meshcat, path)
    assert np.linalg.norm(X_BS[:3, 3] - X_BC[:3, 3]) < 0.003
    meshcat.Delete("visualizer")  # as Drake's visualizer does
    simulator.get_mutable_context().SetTime(0.0)
    simulator.Initialize()
    assert meshcat.HasPath(path)


def test_it_follows_the_cup(meshcat, lit):
    simulator, value = lit
    for time, state, shown in (
        (0.0, CupState(), set()),
        (0.15, CupState(drawing=True), {"drawing"}),
        (0.35, CupState(drawing=True, vacuum=0.95), {"sealed"}),
        (0.55, CupState(drawing=True, vacuum=0.3), {"drawing"}),
        (0.75, CupState(), set()),
    ):
        value.GetMutableData().set_value(state)
        simulator.AdvanceTo(time)
        assert shown == {
            name
            for name in ("drawing", "sealed")
            if prop(meshcat, f"{GRIPPER_PATH}/{name}", "visible")
        }
