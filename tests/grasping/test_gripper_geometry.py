import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from xray_drake.cell.gripper import gripper_names, load_gripper
from xray_drake.configuration import ConfigurationError
from xray_drake.grasping.gripper_geometry import (
    gripper_geometry,
    load_gripper_geometry,
)
from xray_drake.messages import GraspKind
from xray_drake.resources import models_dir

FOLDER = models_dir() / "gripper"
FINGERS = "left_finger", "right_finger"


@pytest.fixture(params=gripper_names())
def name(request):
    return request.param


@pytest.fixture
def plant(name):
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(FOLDER / f"{name}.sdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("gripper_base"))
    plant.Finalize()
    return plant


PUBLISHED = {  # mass, kg; stroke, m; force at most, N; speed, m/s
    "yumi": (0.23, 0.05, 20.0, 0.05),
    "parallel_85": (0.9, 0.085, 235.0, 0.15),
}


def test_published_figures(name, plant):
    mass, stroke, force, speed = PUBLISHED[name]
    context = plant.CreateDefaultContext()
    assert plant.CalcTotalMass(context) == pytest.approx(mass)
    spec = load_gripper(name)
    geometry = gripper_geometry(spec)
    assert spec.opening == stroke == pytest.approx(geometry.open_width)
    assert 0 < spec.force <= force
    for finger in FINGERS:
        joint = plant.GetJointByName(f"{finger}_joint")
        actuator = plant.GetJointActuatorByName(f"{finger}_joint")
        assert actuator.effort_limit() == force
        np.testing.assert_allclose(joint.position_lower_limits(), 0.0)
        np.testing.assert_allclose(joint.position_upper_limits(), stroke / 2)
        np.testing.assert_allclose(joint.velocity_upper_limits(), speed / 2)
    for frame in ("jaw", "cup"):
        if frame == "cup" and not spec.has_cup:
            assert not plant.HasFrameNamed(frame)
            continue
        kind = GraspKind.JAW if frame == "jaw" else GraspKind.SUCTION
        X = plant.GetFrameByName(frame).CalcPoseInWorld(context).GetAsMatrix4()
        np.testing.assert_allclose(X, geometry.frame(kind), atol=1e-12)


def test_the_tool_of_the_yumi():
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(FOLDER / "yumi.sdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("gripper_base"))
    plant.Finalize()
    np.testing.assert_allclose(
        plant.CalcCenterOfMassPositionInWorld(plant.CreateDefaultContext()),
        [0.0087, 0.0123, 0.0492],
        atol=2e-4,
    )
    X_BJ = gripper_geometry(load_gripper()).X_BJ
    np.testing.assert_allclose(X_BJ[:3, 3], [0, 0, 0.1142])


def test_one_model_gives_planning_whole_fingers_and_the_whole_cup():
    """The boxes of the model that planning once had for itself, m."""
    gripper = gripper_geometry(load_gripper())
    np.testing.assert_allclose(
        np.hstack([gripper.lower, gripper.upper]),
        [
            [-0.030, -0.040, 0.000, 0.030, 0.040, 0.0700],
            [0.030, -0.008, 0.014, 0.120, 0.008, 0.0300],
            [0.120, -0.015, 0.007, 0.150, 0.015, 0.0370],
            [-0.005, 0.025, 0.0702, 0.005, 0.033, 0.1172],
            [-0.005, -0.033, 0.0702, 0.005, -0.025, 0.1172],
        ],
        atol=1e-9,
    )
    assert list(gripper.closing) == [0, 0, 0, -1, 1]
    assert list(gripper.round) == [False, True, True, False, False]
    assert gripper.tip_length == pytest.approx(0.003)
    # Across their axes boxes stand in for the cylinders.
    assert not gripper.approach(GraspKind.JAW, 0.1, 0.002).round.any()
    # The cup's lip is the farthest point to its side, and looks that way.
    assert gripper.X_BC[0, 3] == pytest.approx(gripper.upper[:, 0].max())
    np.testing.assert_allclose(gripper.X_BC[:3, 2], [1, 0, 0], atol=1e-12)


def test_the_outline_of_the_parallel_jaw():
    gripper = gripper_geometry(load_gripper("parallel_85"))
    size = gripper.upper.max(axis=0) - gripper.lower.min(axis=0)
    np.testing.assert_allclose(size, [0.075, 0.149, 0.163], atol=1e-9)
    fingers = gripper.closing != 0
    widths = (gripper.upper - gripper.lower)[fingers, 0]
    np.testing.assert_allclose(widths, 0.022, atol=1e-9)
    assert gripper.kinds == (GraspKind.JAW,)
    with pytest.raises(ValueError, match="no suction cup"):
        gripper.frame(GraspKind.SUCTION)


def test_a_cup_that_is_not_used_is_still_in_the_way():
    gripper = gripper_geometry(load_gripper(overrides={"cup_radius": 0}))
    assert gripper.kinds == (GraspKind.JAW,)
    assert gripper.upper[:, 0].max() == pytest.approx(0.15)


BOX = "<box><size>0.060 0.080 0.070</size></box>"
POSE = "<pose>0 0 0.035 0 0 0</pose>"


@pytest.mark.parametrize(
    ("old", "new", "error"),
    [
        (BOX, "<sphere><radius>0.03</radius></sphere>", "boxes and cylinders"),
        (POSE, "<pose>0 0 0.035 0.1 0 0</pose>", "not aligned"),
        ('name="jaw"', 'name="claw"', "jaw"),
        (
            "0.022 0 1.5707963267948966 0</pose>\n    </frame>",
            "",
            "parsing XML",
        ),
        (
            "0.022 0 1.5707963267948966 0</pose>\n    </frame>",
            "0.022 0 0 0</pose></frame>",
            "does not look along",
        ),
    ],
)
def test_other_shapes_are_refused(tmp_path, old, new, error):
    path, text = tmp_path / "yumi.sdf", (FOLDER / "yumi.sdf").read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(ConfigurationError, match=error) as caught:
        load_gripper_geometry(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_gripper_must_be_that_of_its_model():
    for name, overrides, said in (
        ("yumi", {"opening": 0.06}, r"opening is 0\.06, but .*yumi\.sdf"),
        (
            "parallel_85",
            {
                "cup_radius": 0.01,
                "vacuum_force": 9,
                "cup_elasticity": 2,
                "bellows_travel": 0.004,
            },
            r"cup_radius is 0\.01, but .* has no frame 'cup'",
        ),
    ):
        spec = load_gripper(name, overrides)
        with pytest.raises(ConfigurationError, match=said):
            gripper_geometry(spec)
