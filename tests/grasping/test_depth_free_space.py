import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.grasping.depth_scenes import block, clutter, see
from tests.nominal import BIN
from tests.occupancy.scenes import CAMERAS
from tests.poses import at, downwards
from xray_drake.cell.gripper import load_gripper
from xray_drake.grasping.evidence.approach_shape import ApproachShape
from xray_drake.grasping.evidence.free_space import FreeSpace
from xray_drake.grasping.gripper_geometry import gripper_geometry
from xray_drake.messages import GraspKind

GRIPPER = gripper_geometry(load_gripper())
KINDS = (GraspKind.JAW, GraspKind.SUCTION)
SHAPES = {
    kind: ApproachShape(
        kind, GRIPPER, approach_distance=0.10, cup_standoff=0.002
    )
    for kind in KINDS
}
CAMERA = CAMERAS["tilted"]


def space(*meshes, camera=CAMERA):
    return FreeSpace(see(camera, *meshes)[0], camera, SHAPES, BIN)


def poses(rng, count):
    """Grippers about the middle, most of them near the floor."""
    X = np.array([downwards(0, 0, 0)] * count)
    lean = rng.normal(scale=0.25, size=(count, 3)) * [1, 1, 6]
    X[:, :3, :3] = Rotation.from_rotvec(lean).as_matrix() @ X[:, :3, :3]
    X[:, :3, 3] = rng.uniform([-0.1, -0.1, 0.005], [0.1, 0.1, 0.06], (count, 3))
    return X


def unknown_points(depth, camera):
    """What the camera has not seen to be free, and the bin: (m, 3).

    Of what is outside the image only what is next to it: grippers come in from
    there.
    """
    depth = depth[::3, ::3].astype(float)
    rays = camera.rays()[::3, ::3]
    clouds = [
        camera.X_WC[:3, 3] + rays * (depth + beyond)[..., None]
        for beyond in np.arange(0.0, 0.10, 0.004)
    ]
    points = np.concatenate(clouds).reshape(-1, 3)
    points = points[points[:, 2] > 0.003]
    return np.concatenate([points, beside_the_image(camera), bin_faces()])


def beside_the_image(camera):
    """Points up to 15 pixels outside the image, (m, 3)."""
    size = camera.width, camera.height
    u, v = np.meshgrid(*(np.arange(-15, n + 16, 7.5) for n in size))
    inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    pixels = np.stack([u, v, np.ones_like(u)], axis=-1)[~inside]
    rays = pixels @ np.linalg.inv(camera.intrinsics).T
    p_C = np.concatenate([z * rays for z in np.arange(0.4, 0.8, 0.01)])
    return p_C @ camera.X_WC[:3, :3].T + camera.X_WC[:3, 3]


def bin_faces():
    """The inner faces of the bin, every 5 mm, the floor 3 mm lower: it is no
    obstacle within 2 mm of where it is. (m, 3)."""
    heights = -0.003, BIN.wall_height
    corners = np.column_stack([BIN.floor.x, BIN.floor.y, heights])
    box = trimesh.creation.box(bounds=corners).subdivide_to_size(0.005)
    return box.vertices[box.vertices[:, 2] < BIN.wall_height - 1e-6]


def depth_inside(points_W, X_WG, kind, opening):
    """How deep the points are in the gripper's boxes, one box at a time."""
    tool = GRIPPER.approach(kind, 0.10, 0.002)
    lower, upper = tool.lower, tool.upper
    if kind is GraspKind.JAW:
        shift = tool.closing_shift(opening)
        lower, upper = lower + shift, upper + shift
    X_BW = tool.frame(kind) @ np.linalg.inv(X_WG)
    p_B = points_W @ X_BW[:3, :3].T + X_BW[:3, 3]
    deepest = -np.inf
    for a, b, tube in zip(lower, upper, tool.round, strict=True):
        inside = np.minimum(p_B - a, b - p_B)
        depth = inside.min(axis=1)
        if tube:
            across = np.hypot(*(p_B - 0.5 * (a + b))[:, 1:].T)
            radius = 0.5 * (b - a)[1]
            depth = np.minimum(inside[:, 0], radius - across)
        deepest = max(deepest, depth.max())
    return deepest


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(3))
def test_against_brute_force(kind, seed):
    """Free is free of unknown points, also where it is moved sideways by
    less than its room; and what is far from all of them is free."""
    rng = np.random.default_rng(seed)
    depth, _ = see(CAMERA, *clutter(rng, 5))
    unknown = unknown_points(depth, CAMERA)
    X_WG = poses(rng, 40)
    opening = rng.uniform(0.01, 0.05, len(X_WG))
    room = FreeSpace(depth, CAMERA, SHAPES, BIN).room(kind, X_WG, opening)
    free = np.flatnonzero(room >= 0)
    assert 3 < len(free) < 37
    for i in free:
        angle = rng.uniform(0, 2 * np.pi)
        aside = CAMERA.X_WC[:3, :2] @ [np.cos(angle), np.sin(angle)]
        for shift in (0.0, 0.7 * room[i]):
            X = X_WG[i].copy()
            X[:3, 3] += shift * aside
            assert depth_inside(unknown, X, kind, opening[i]) < 0.001
    for i in np.flatnonzero(room < 0):
        assert depth_inside(unknown, X_WG[i], kind, opening[i]) > -0.012


@settings(max_examples=8)
@given(seed=st.integers(0, 1000))
def test_one_object_more_leaves_no_more_room(seed):
    rng = np.random.default_rng(seed)
    meshes = clutter(rng, 4)
    X_WG, opening = poses(rng, 20), np.full(20, 0.04)
    for kind in KINDS:
        fewer = space(*meshes[:-1]).room(kind, X_WG, opening)
        more = space(*meshes).room(kind, X_WG, opening)
        assert (more <= fewer).all()


NOMINAL, HIGH = CAMERAS["nominal"], CAMERAS["high"]


def has_room(seen, p_WG):
    """A jaw that is 30 mm open."""
    X_WG = downwards(*p_WG)[None]
    return seen.room(GraspKind.JAW, X_WG, np.array([0.03]))[0] >= 0


def between(gap):
    """Two blocks, the second so far from the jaw's pad at y = 15 mm."""
    return [
        block([0.04, 0.02, 0.03], at(0, 0, 0.015)),
        block([0.04, 0.04, 0.03], at(0, 0.015 + gap + 0.02, 0.015)),
    ]


@pytest.mark.parametrize(
    ("camera", "meshes", "p_WG", "free"),
    [
        # The gripper's body reaches 40 mm aside, below the walls' top, and
        # stays 2 mm clear of them, though they are not seen.
        (HIGH, [], (0, 0.157, 0.03), True),
        (HIGH, [], (0, 0.159, 0.03), False),
        (HIGH, [], (0, 0.159, 0.10), True),
        # A finger is 8 mm thick; 2 to 3 mm are kept on either side.
        (NOMINAL, between(0.014), (0, 0, 0.02), True),
        (NOMINAL, between(0.007), (0, 0, 0.02), False),
    ],
)
def test_where_a_jaw_has_room(camera, meshes, p_WG, free):
    assert has_room(space(*meshes, camera=camera), p_WG) == free


@pytest.mark.parametrize(("z", "free"), [(0.0035, True), (-0.002, False)])
def test_a_noisy_floor_is_no_obstacle(z, free):
    rng = np.random.default_rng(0)
    depth = see(NOMINAL)[0] + rng.normal(scale=0.0004, size=NOMINAL.shape)
    assert (
        has_room(FreeSpace(depth, NOMINAL, SHAPES, BIN), (0.02, 0, z)) == free
    )


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_outside_the_image_is_taken_as_full(kind):
    """The image ends beside one gripper, and another is outside it."""
    whole, depth = NOMINAL, see(NOMINAL)[0]
    top = int(whole.project(np.array([0.0, 0.08, 0.0]))[1])
    part = whole.cropped(slice(top, whole.height), slice(0, whole.width))
    X_WG = np.array([downwards(0, y, 0.02) for y in (0.12, 0.06, -0.06)])
    opening = np.full(len(X_WG), 0.03)
    for seen, free in (
        (FreeSpace(depth, whole, SHAPES, BIN), [True, True, True]),
        (FreeSpace(depth[top:], part, SHAPES, BIN), [False, False, True]),
    ):
        room = seen.room(kind, X_WG, opening)
        np.testing.assert_array_equal(room >= 0, free)
        tips = seen.tips_are_free(kind, X_WG, opening)
        assert tips[0] == free[0]
        assert seen.room(kind, X_WG[:0], opening[:0]).shape == (0,)
