"""Which body is under a grasp: the tiny heap as it is seen."""

import numpy as np
import pytest
from pydrake.math import RigidTransform

from tests.alone import Alone
from xray_drake.cell.gripper import load_gripper
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


FLOOR = (-0.1, -0.1)
PLANK = {"width": 0.03, "yaw": -0.2}


@pytest.mark.parametrize(
    ("at", "z", "jaw", "found"),
    [
        *(
            (name, top + above, {}, name if above < 0.01 else "")
            for name, top in (
                ("book", 0.025),
                ("block", 0.06),
                ("plank", 0.015),
            )
            for above in (0.0, 0.004, 0.03)
        ),
        ("plank", 0.008, PLANK, "plank"),
        # Far below the fingertips is not between them.
        ("plank", 0.04, PLANK, ""),
        # The end of the target that peeps out from under the book.
        (TARGET, 0.0025, {"width": 0.02, "yaw": 0.4}, TARGET),
        (FLOOR, 0.0, {}, ""),
        (FLOOR, 0.003, {"width": 0.02}, ""),
    ],
)
def test_what_cup_or_jaw_is_on(
    recorded_observation: Observation,
    at: str | tuple[float, float],
    z: float,
    jaw: dict[str, float],
    found: str,
) -> None:
    seen = recorded_observation
    if isinstance(at, str):
        end = -0.017 if at == TARGET else 0.0
        x, y, *_ = seen.heap.poses[at] @ [end, 0, 0, 1]
    else:
        x, y = at
    under = body_under_grasp(
        grasp_at(x, y, z, **jaw),
        seen.labels,
        seen.depth,
        seen.camera,
        seen.label_of,
        load_gripper(),
    )
    assert under == found


def told(seen: Observation, action: SearchAction) -> SearchAction:
    """What the system makes of an action."""
    poses = [RigidTransform()] * (1 + max(seen.label_of.values()))
    for name, body in seen.label_of.items():
        poses[body] = RigidTransform(seen.heap.poses[name])
    return Alone(
        GraspedBody(bodies=seen.label_of),
        action=action,
        depth_image=seen.depth,
        label_image=seen.labels,
        camera=seen.camera,
        body_poses=poses,
    ).output("action")


def test_the_gripper_is_told_the_body_if_any(
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
    bare = told(seen, SearchAction(number=1, grasp=grasp_at(*FLOOR, 0.0)))
    assert (bool(bare.grasp), bare.grasp.object) == (True, "")
    nothing = told(seen, SearchAction(number=2))
    assert (nothing.number, bool(nothing.grasp)) == (2, False)
