import numpy as np
import pytest
import umsgpack
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator

from xray_drake.drawing.meshcat_layers import start_meshcat
from xray_drake.gripper.seal_light import GRIPPER_PATH, SealLight
from xray_drake.gripper.suction import CupState


@pytest.fixture
def meshcat():
    return start_meshcat()


def lights(meshcat):
    return {
        name
        for name in ("drawing", "sealed")
        if umsgpack.unpackb(
            meshcat._GetPackedProperty(f"{GRIPPER_PATH}/{name}", "visible")
        )["value"]
    }


def test_it_lies_around_the_lip(meshcat):
    X_BC = np.eye(4)
    X_BC[:3, 3] = 0.15, 0.0, 0.02
    light = SealLight(meshcat, X_BC)
    simulator = Simulator(light)
    light.get_input_port().FixValue(
        simulator.get_mutable_context(), AbstractValue.Make(CupState())
    )
    simulator.Initialize()
    packed = meshcat._GetPackedTransform(f"{GRIPPER_PATH}/sealed")
    X = np.array(umsgpack.unpackb(packed)["matrix"]).reshape(4, 4).T
    assert np.linalg.norm(X[:3, 3] - X_BC[:3, 3]) < 0.003


def test_it_is_drawn_anew_with_each_simulation(meshcat):
    light = SealLight(meshcat, np.eye(4))
    simulator = Simulator(light)
    light.get_input_port().FixValue(
        simulator.get_mutable_context(), AbstractValue.Make(CupState())
    )
    simulator.Initialize()
    meshcat.Delete("visualizer")  # as Drake's visualizer does
    simulator.get_mutable_context().SetTime(0.0)
    simulator.Initialize()
    assert meshcat.HasPath(f"{GRIPPER_PATH}/sealed")


def test_it_follows_the_cup(meshcat):
    light = SealLight(meshcat, np.eye(4), period=0.1)
    simulator = Simulator(light)
    port, context = light.get_input_port(), simulator.get_mutable_context()
    value = port.FixValue(context, AbstractValue.Make(CupState()))
    simulator.Initialize()
    assert lights(meshcat) == set()
    for time, state, shown in (
        (0.15, CupState(drawing=True), {"drawing"}),
        (0.35, CupState(drawing=True, vacuum=0.95), {"sealed"}),
        (0.55, CupState(drawing=True, vacuum=0.3), {"drawing"}),
        (0.75, CupState(), set()),
    ):
        value.GetMutableData().set_value(state)
        simulator.AdvanceTo(time)
        assert lights(meshcat) == shown
