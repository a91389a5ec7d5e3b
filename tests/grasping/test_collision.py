import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.grasping.depth_scenes import model_block
from tests.poses import at, downwards
from xray_drake.cell.gripper import load_gripper
from xray_drake.grasping.evidence.clearance import clearance
from xray_drake.grasping.evidence.collision import GraspScene
from xray_drake.grasping.gripper_geometry import gripper_geometry

OPENING = 0.030


def scene(*objects, **options):
    return GraspScene(
        objects, gripper=gripper_geometry(load_gripper()), **options
    )


def finger_gap(gap):
    """A block so far from the jaw's pad at y = 15 mm; a finger has 8 mm."""
    return (0.04, 0.04, 0.03), at(0, OPENING / 2 + gap + 0.02, 0.015)


def held(width):
    return (0.03, width, 0.03), at(0, 0, 0.015)


def post(x, y):
    """Its edge, or its corner, is beside the cup."""
    return (0.02, 0.02, 0.02), at(x + 0.01, y + (0.01 if y else 0), 0.02)


NOTHING = (0.01, 0.01, 0.01), at(0.2, 0.15, 0.005)


@pytest.mark.parametrize(
    ("tool", "block", "p_WG", "hit"),
    [
        ("jaw", finger_gap(0.009), (0, 0, 0.005), ()),
        ("jaw", finger_gap(0.007), (0, 0, 0.005), ("it",)),
        ("jaw", held(OPENING - 0.001), (0, 0, 0.01), ()),
        ("jaw", held(OPENING + 0.001), (0, 0, 0.01), ("it",)),
        # The fingers end 3 mm beyond the origin; the cup 2 mm before its lip.
        ("shut jaw", NOTHING, (0, 0, 0.0035), ()),
        ("shut jaw", NOTHING, (0, 0, 0.0025), ("bin",)),
        ("cup", NOTHING, (0, 0, -0.0015), ()),
        ("cup", NOTHING, (0, 0, -0.0025), ("bin",)),
        # The wall is at 0.2 m; the body reaches 40 mm to that side, below its
        # top.
        ("jaw", NOTHING, (0, 0.159, 0.01), ()),
        ("jaw", NOTHING, (0, 0.161, 0.01), ("bin",)),
        ("cup", post(0.014, 0), (0, 0, 0.015), ("it",)),
        ("cup", post(0.016, 0), (0, 0, 0.015), ()),
        ("cup", post(0.0115, 0.0115), (0, 0, 0.015), ()),
    ],
)
def test_what_is_in_the_way(tool, block, p_WG, hit):
    size, X_WO = block
    s = scene(model_block("it", *size))
    s.set_poses({"it": X_WO})
    X_WG = downwards(*p_WG)
    if tool == "cup":
        assert s.suction_collides(X_WG) == bool(hit)
    else:
        opening = 0.0 if tool == "shut jaw" else OPENING
        assert s.jaw_collides(X_WG, opening) == bool(hit)
    assert s.hit() == hit


@pytest.mark.parametrize(
    ("distance", "collides"), [(0.10, True), (0.02, False)]
)
def test_the_approach_is_swept(distance, collides):
    """An overhang above the gripper's end pose is in the way before it; with
    the cup down, the body's back is 180 mm above the lip."""
    roof = model_block("roof", 0.05, 0.05, 0.01)
    s = scene(roof, approach_distance=distance)
    s.set_poses({"roof": at(0, 0, 0.17)})
    assert s.jaw_collides(downwards(0, 0, 0.005), OPENING) == collides
    s.set_poses({"roof": at(0, 0, 0.22)})
    assert s.suction_collides(downwards(0, 0, 0.01)) == collides


def test_what_has_no_pose_takes_no_part():
    s = scene(*(model_block(name, 0.05, 0.05, 0.05) for name in "ab"))
    X_WG = downwards(0, 0, 0.02)
    s.set_poses({"a": at(0, 0, 0.025), "b": at(0.01, 0, 0.025)})
    assert s.jaw_collides(X_WG, OPENING)
    assert s.hit() == ("a", "b")
    with s.without("a"):
        assert s.jaw_collides(X_WG, OPENING)
        assert s.hit() == ("b",)
    assert s.jaw_collides(X_WG, OPENING)
    assert s.hit() == ("a", "b")
    for poses in ({"a": at(0.2, 0.1, 0.025)}, {}):
        s.set_poses(poses)
        assert not s.jaw_collides(X_WG, OPENING)


def test_names_are_checked():
    a = model_block("a", 0.1, 0.1, 0.1)
    with pytest.raises(ValueError, match="unique"):
        scene(a, a)
    with pytest.raises(KeyError, match="ghost"):
        scene(a).set_poses({"ghost": np.eye(4)})


LOWER = np.array([[-0.02, -0.01, -0.01]])
UPPER = np.array([[0.02, 0.01, 0.01]])


@pytest.mark.parametrize(
    ("point", "round_", "expected"),
    [
        ((0, 0.01, 0.01), False, 0.0),
        ((0, 0.01, 0.01), True, 0.01 * (np.sqrt(2) - 1)),
        ((0.025, 0.01, 0.01), True, 0.005),
        ((0.019, 0, 0), True, -0.001),
    ],
)
def test_one_point_and_one_box(point, round_, expected):
    X_WB = at(0.1, -0.2, 0.3, 0.4, -0.5, 0.6)
    p_W = X_WB[:3, :3] @ point + X_WB[:3, 3]
    found = clearance(p_W[None], X_WB[None], LOWER, UPPER, np.array([round_]))
    assert found[0] == pytest.approx(expected, abs=1e-7)


def test_many_poses_boxes_and_points():
    rng = np.random.default_rng(0)
    n = 150
    X_WB = np.tile(np.eye(4), (n, 1, 1))
    X_WB[:, :3, :3] = Rotation.random(n, random_state=2).as_matrix()
    X_WB[:, :3, 3] = rng.normal(scale=0.1, size=(n, 3))
    points = rng.normal(scale=0.1, size=(40, 3))
    lower = rng.uniform(-0.05, 0, (n, 3, 3))
    upper = lower + rng.uniform(0.01, 0.05, (n, 3, 3))
    found = clearance(points, X_WB, lower, upper, np.zeros(3, bool))
    for i in range(n):
        p_B = (points - X_WB[i, :3, 3]) @ X_WB[i, :3, :3]
        gap = np.maximum(lower[i][:, None] - p_B, p_B - upper[i][:, None])
        assert found[i] == pytest.approx(gap.max(axis=-1).min(), abs=1e-6)


def test_nothing_is_infinitely_far():
    box = LOWER, UPPER, np.zeros(1, bool)
    assert np.isinf(clearance(np.zeros((0, 3)), np.eye(4)[None], *box)[0])
    assert clearance(np.zeros((5, 3)), np.zeros((0, 4, 4)), *box).shape == (0,)
