"""Which body is under a grasp: the tiny heap as it is seen."""

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.sensors import ImageDepth32F, ImageLabel16I

from xray_drake.grasping.gripper_geometry import GripperParameters
from xray_drake.messages import Grasp, GraspKind, SearchAction
from xray_drake.search.grasped_body import GraspedBody, body_under_grasp
from xray_drake.testing.tiny import Observation

TARGET = "box_2to1"


def grasp_at(
    x: float, y: float, z: float, *, width: float = 0.0, yaw: float = 0.0
) -> Grasp:
    """Straight down; a cup, or a jaw where there is a width."""
    c, s = np.cos(yaw), np.sin(yaw)
    X_WG = np.eye(4)
    X_WG[:3, :3] = [[c, s, 0], [s, -c, 0], [0, 0, -1]]
    X_WG[:3, 3] = x, y, z
    kind = GraspKind.JAW if width else GraspKind.SUCTION
    return Grasp(kind, "segment_1", X_WG, width=width, quality=0.5)


def under(seen: Observation, grasp: Grasp) -> str:
    return body_under_grasp(
        grasp,
        seen.labels,
        seen.depth,
        seen.camera,
        seen.label_of,
        GripperParameters(),
    )


@pytest.mark.parametrize("name", ["book", "block", "plank"])
def test_what_the_cup_is_on(
    recorded_observation: Observation, name: str
) -> None:
    seen = recorded_observation
    top = {"book": 0.025, "block": 0.06, "plank": 0.015}[name]
    x, y, _ = seen.heap.poses[name][:3, 3]
    assert under(seen, grasp_at(x, y, top)) == name
    assert under(seen, grasp_at(x, y, top + 0.004)) == name
    assert under(seen, grasp_at(x, y, top + 0.03)) == ""


def test_what_the_jaw_closes_on(recorded_observation: Observation) -> None:
    seen = recorded_observation
    x, y, _ = seen.heap.poses["plank"][:3, 3]
    across = grasp_at(x, y, 0.008, width=0.03, yaw=-0.2)
    assert under(seen, across) == "plank"
    # The end of the target that peeps out from under the book.
    end = seen.heap.poses[TARGET] @ [-0.017, 0, 0, 1]
    assert under(seen, grasp_at(*end[:3], width=0.02, yaw=0.4)) == TARGET


def test_far_below_the_fingertips_is_not_between_them(
    recorded_observation: Observation,
) -> None:
    seen = recorded_observation
    x, y, _ = seen.heap.poses["plank"][:3, 3]
    assert under(seen, grasp_at(x, y, 0.04, width=0.03, yaw=-0.2)) == ""


def test_nothing_is_on_the_bare_floor(
    recorded_observation: Observation,
) -> None:
    assert under(recorded_observation, grasp_at(-0.1, -0.1, 0.0)) == ""
    jaw = grasp_at(-0.1, -0.1, 0.003, width=0.02)
    assert under(recorded_observation, jaw) == ""
    assert under(recorded_observation, Grasp()) == ""


def told(seen: Observation, action: SearchAction) -> SearchAction:
    """What the system makes of an action."""
    names = list(seen.label_of)
    system = GraspedBody(
        labels=seen.label_of, bodies={name: i for i, name in enumerate(names)}
    )
    context = system.CreateDefaultContext()
    height, width = seen.depth.shape
    depth, label = ImageDepth32F(width, height), ImageLabel16I(width, height)
    depth.mutable_data[:, :, 0] = seen.depth
    label.mutable_data[:, :, 0] = seen.labels
    for port, value in (
        ("action", action),
        ("depth_image", depth),
        ("label_image", label),
        ("camera", seen.camera),
        ("body_poses", [RigidTransform(seen.heap.poses[n]) for n in names]),
    ):
        system.GetInputPort(port).FixValue(context, AbstractValue.Make(value))
    return system.GetOutputPort("action").Eval(context)


def test_the_gripper_is_told_the_body(
    recorded_observation: Observation,
) -> None:
    seen = recorded_observation
    X_WO = seen.heap.poses["book"]
    grasp = grasp_at(*X_WO[:2, 3], 0.025)
    action = SearchAction(number=3, grasp=grasp, is_target=True, score=7.0)
    out = told(seen, action)
    assert (out.number, out.is_target, out.score) == (3, True, 7.0)
    assert (out.grasp.object, out.grasp.kind) == ("book", GraspKind.SUCTION)
    np.testing.assert_array_equal(out.grasp.X_WG, grasp.X_WG)
    np.testing.assert_allclose(X_WO @ out.grasp.X_OG, grasp.X_WG, atol=1e-12)


def test_the_gripper_is_told_that_nothing_is_there(
    recorded_observation: Observation,
) -> None:
    action = SearchAction(number=1, grasp=grasp_at(-0.1, -0.1, 0.0))
    out = told(recorded_observation, action)
    assert out.grasp
    assert out.grasp.object == ""
    nothing = told(recorded_observation, SearchAction(number=2))
    assert (nothing.number, bool(nothing.grasp)) == (2, False)
