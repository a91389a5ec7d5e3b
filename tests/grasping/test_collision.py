import numpy as np
import pytest
import trimesh

from tests.grasping.depth_scenes import at, downwards
from xray_drake.grasping.evidence.collision import GraspScene
from xray_drake.grasping.gripper_geometry import load_gripper_geometry
from xray_drake.scene.object_model import object_from_pieces

FINGER = 0.008
OPENING = 0.030


def block(name, *extents):
    return object_from_pieces(
        name, [trimesh.creation.box(extents)], density=500.0
    )


def scene(*objects, **options):
    return GraspScene(objects, gripper=load_gripper_geometry(), **options)


@pytest.mark.parametrize(
    ("gap", "collides"), [(FINGER + 0.001, False), (FINGER - 0.001, True)]
)
def test_a_finger_between_two_blocks(gap, collides):
    """The inner faces of both fingers touch nothing; the outer decide."""
    s = scene(block("neighbour", 0.04, 0.04, 0.03))
    near = OPENING / 2 + gap
    s.set_poses({"neighbour": at(0, near + 0.02, 0.015)})
    assert s.jaw_collides(downwards(0, 0, 0.005), OPENING) == collides
    assert s.hit() == (("neighbour",) if collides else ())


@pytest.mark.parametrize(
    ("width", "collides"), [(OPENING - 0.001, False), (OPENING + 0.001, True)]
)
def test_the_object_between_the_fingers(width, collides):
    s = scene(block("held", 0.03, width, 0.03))
    s.set_poses({"held": at(0, 0, 0.015)})
    X_WG = downwards(0, 0, 0.01)
    assert s.jaw_collides(X_WG, OPENING) == collides
    with s.without("held"):
        assert not s.jaw_collides(X_WG, OPENING)
    assert s.jaw_collides(X_WG, OPENING) == collides


@pytest.mark.parametrize("tool", ["jaw", "suction"])
@pytest.mark.parametrize(
    ("distance", "collides"), [(0.10, True), (0.02, False)]
)
def test_the_approach_is_swept(tool, distance, collides):
    """An overhang above the gripper's end pose is in the way before it; with
    the cup down, the body's back is 180 mm above the lip."""
    s = scene(block("roof", 0.05, 0.05, 0.01), approach_distance=distance)
    s.set_poses({"roof": at(0, 0, 0.17 if tool == "jaw" else 0.22)})
    if tool == "jaw":
        assert s.jaw_collides(downwards(0, 0, 0.005), OPENING) == collides
    else:
        assert s.suction_collides(downwards(0, 0, 0.01)) == collides


@pytest.mark.parametrize("tool", ["jaw", "suction"])
@pytest.mark.parametrize(
    ("above", "collides"), [(0.0005, False), (-0.0005, True)]
)
def test_the_floor(tool, above, collides):
    s = scene()
    s.set_poses({})
    if tool == "jaw":
        assert s.jaw_collides(downwards(0, 0, 0.003 + above), 0.0) == collides
    else:
        # The cup ends 2 mm before its lip.
        assert s.suction_collides(downwards(0, 0, -0.002 + above)) == collides
    assert s.hit() == (("bin",) if collides else ())


def test_the_walls():
    s = scene()
    s.set_poses({})
    # Outer face of the finger at y = 15 + 8 mm, wall at 0.2 m; its body
    # reaches 40 mm to that side, below the wall's top.
    assert not s.jaw_collides(downwards(0, 0.159, 0.01), OPENING)
    assert s.jaw_collides(downwards(0, 0.161, 0.01), OPENING)


@pytest.mark.parametrize(
    ("x", "y", "collides"),
    [(0.014, 0, True), (0.016, 0, False), (0.0115, 0.0115, False)],
)
def test_the_cup_is_round(x, y, collides):
    """A post whose edge is beside the cup; its corner may come nearer."""
    s = scene(block("post", 0.02, 0.02, 0.02))
    s.set_poses({"post": at(x + 0.01, y + (0.01 if y else 0), 0.02)})
    assert s.suction_collides(downwards(0, 0, 0.015)) == collides


def test_what_has_no_pose_takes_no_part():
    s = scene(block("a", 0.05, 0.05, 0.05), block("b", 0.05, 0.05, 0.05))
    X_WG = downwards(0, 0, 0.02)
    s.set_poses({"a": at(0, 0, 0.025), "b": at(0.01, 0, 0.025)})
    assert s.jaw_collides(X_WG, OPENING)
    assert s.hit() == ("a", "b")
    s.set_poses({"a": at(0.2, 0.1, 0.025)})
    assert not s.jaw_collides(X_WG, OPENING)
    s.set_poses({})
    assert not s.jaw_collides(X_WG, OPENING)


def test_names_are_checked():
    with pytest.raises(ValueError, match="unique"):
        scene(block("a", 0.1, 0.1, 0.1), block("a", 0.1, 0.1, 0.1))
    with pytest.raises(KeyError, match="ghost"):
        scene(block("a", 0.1, 0.1, 0.1)).set_poses({"ghost": np.eye(4)})
