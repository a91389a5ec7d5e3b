import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from xray_drake.grasping.gripper_geometry import (
    GripperParameters,
    load_gripper_geometry,
)
from xray_drake.messages import GraspKind
from xray_drake.resources import models_dir

FOLDER = models_dir() / "gripper"
FINGERS = "left_finger", "right_finger"


@pytest.fixture(params=["gripper.sdf", "yumi_gripper.sdf"])
def plant(request):
    """What planning knows, and what moves: the same gripper."""
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(FOLDER / request.param)
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("gripper_base"))
    plant.Finalize()
    return plant


def test_published_figures(plant):
    context = plant.CreateDefaultContext()
    assert plant.CalcTotalMass(context) == pytest.approx(0.23)
    np.testing.assert_allclose(
        plant.CalcCenterOfMassPositionInWorld(context),
        [0.0087, 0.0123, 0.0492],
        atol=2e-4,
    )
    geometry = load_gripper_geometry()
    np.testing.assert_allclose(geometry.X_BJ[:3, 3], [0, 0, 0.1142])
    for name, X_BF in (("jaw", geometry.X_BJ), ("cup", geometry.X_BC)):
        X = plant.GetFrameByName(name).CalcPoseInWorld(context).GetAsMatrix4()
        np.testing.assert_allclose(X, X_BF, atol=1e-12)
    for name in FINGERS:
        joint = plant.GetJointByName(f"{name}_joint")
        actuator = plant.GetJointActuatorByName(f"{name}_joint")
        assert actuator.effort_limit() == GripperParameters().force
        np.testing.assert_allclose(joint.position_lower_limits(), 0.0)
        np.testing.assert_allclose(joint.position_upper_limits(), 0.025)


def test_boxes_and_frames():
    gripper = load_gripper_geometry()
    assert gripper.tip_length == pytest.approx(0.003)
    assert sorted(gripper.closing) == [-1, 0, 0, 0, 1]
    assert gripper.round.sum() == 2
    assert np.all(gripper.upper > gripper.lower)
    # Across their axes boxes stand in for the cylinders.
    assert not gripper.approach(GraspKind.JAW, 0.1, 0.002).round.any()
    # The cup's lip is the farthest point to its side, and looks that way.
    assert gripper.X_BC[0, 3] == pytest.approx(gripper.upper[:, 0].max())
    np.testing.assert_allclose(gripper.X_BC[:3, 2], [1, 0, 0], atol=1e-12)


BOX = "<box><size>0.060 0.080 0.070</size></box>"
POSE = "<pose>0 0 0.035 0 0 0</pose>"


@pytest.mark.parametrize(
    ("old", "new", "error"),
    [
        (BOX, "<sphere><radius>0.03</radius></sphere>", "boxes and cylinders"),
        (POSE, "<pose>0 0 0.035 0.1 0 0</pose>", "not aligned"),
    ],
)
def test_other_shapes_are_refused(tmp_path, old, new, error):
    path, text = tmp_path / "gripper.sdf", (FOLDER / "gripper.sdf").read_text()
    path.write_text(text.replace(old, new))
    with pytest.raises(ValueError, match=error):
        load_gripper_geometry(path)
