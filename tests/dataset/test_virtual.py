import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.occupancy.brute_force import Caster
from tests.occupancy.scenes import make_camera
from xray_drake.cell.bin import Bin
from xray_drake.dataset.sample import IMAGES, Sample, problems
from xray_drake.dataset.virtual import (
    draw_target,
    is_virtual,
    make_target,
    target_depth,
    virtual_sample,
    virtual_target,
)
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.occupancy.label.ground_truth import occupancy_label

_MakeSample = Callable[..., Sample]

_KINDS = ("box", "disc", "rod")
_SIZE = np.array([0.09, 0.04, 0.015])
_SHAPE = (96, 128)


def _camera(**change: float) -> PinholeCamera:
    settings = {"focal_length": 138.0, "center": (63.5, 47.5), **change}
    return make_camera(size=(128, 96), **settings)  # type: ignore[arg-type]


_CAMERAS = {
    "nominal": _camera(),
    "tilted": _camera(tilt=10, azimuth=57),
    "low": _camera(radius=0.7, tilt=6, azimuth=230, roll=-6, focal_length=140),
    "aside": _camera(tilt=60, azimuth=300, roll=20),
    "close": _camera(radius=0.1, tilt=30),
}


def _mesh(kind: str, size: np.ndarray) -> trimesh.Trimesh:
    if kind == "box":
        return trimesh.creation.box(size)
    mesh = trimesh.creation.cylinder(radius=0.5, height=1.0, sections=24)
    if kind == "rod":
        turn = trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0])
        mesh.apply_transform(turn)
    return mesh.apply_scale(size)


def _pose(
    x: float = 0.0, y: float = 0.0, z: float = 0.0, seed: int | None = None
) -> np.ndarray:
    X_WT = np.eye(4)
    if seed is not None:
        X_WT = trimesh.transformations.random_rotation_matrix(
            np.random.default_rng(seed).random(3)
        )
    X_WT[:3, 3] = x, y, z
    return X_WT


def _cast(
    kind: str, size: np.ndarray, X_WT: np.ndarray, camera: PinholeCamera
) -> np.ndarray:
    mesh = _mesh(kind, size).apply_transform(X_WT)
    rays = camera.rays().reshape(-1, 3)
    origins = np.tile(camera.X_WC[:3, 3], (len(rays), 1))
    depth = Caster(mesh).depth(origins, rays).reshape(camera.shape)
    return np.where(np.isfinite(depth), depth, 0.0)


def _assert_same(rendered: np.ndarray, expected: np.ndarray) -> None:
    """Up to a ray that just touches an edge; rays are cast in float32."""
    assert rendered.dtype == np.float32
    assert np.count_nonzero((rendered > 0) != (expected > 0)) <= 1
    both = (rendered > 0) & (expected > 0)
    np.testing.assert_allclose(
        rendered[both], expected[both], rtol=0, atol=1e-5
    )


_PLACES = {
    "flat": _pose(0.011, -0.007, _SIZE[2] / 2),
    "turned": _pose(0.011, -0.007, _SIZE[2] / 2, seed=1),
    "turned otherwise": _pose(0.011, -0.007, _SIZE[2] / 2, seed=2),
    **{
        f"cut off at {x}, {y}": _pose(x, y, 0.01, seed=3)
        for x in (-0.37, 0.355, 0.37)
        for y in (0.0, 0.265, -0.27)
    },
    "beside": _pose(0.9),
    "below": _pose(0, -2),
    "behind": _pose(0, 0, 0.9),
}


@pytest.mark.parametrize("kind", _KINDS)
@pytest.mark.parametrize(
    ("place", "camera"),
    [
        *((place, "nominal") for place in _PLACES),
        *((p, c) for p in list(_PLACES)[:3] for c in list(_CAMERAS)[1:]),
    ],
)
def test_a_target_is_rendered_as_rays_meet_it(
    kind: str, place: str, camera: str
) -> None:
    """Cut off at the image's border; nothing beside or behind the camera."""
    X_WT, seen_by = _PLACES[place], _CAMERAS[camera]
    rendered = target_depth(make_target(kind, _SIZE), X_WT, seen_by)
    expected = _cast(kind, _SIZE, X_WT, seen_by)
    edges = expected[[0, -1]].any() or expected[:, [0, -1]].any()
    assert edges or not place.startswith("cut off")
    if place in ("beside", "below", "behind"):
        assert not expected.any()
    else:
        assert edges or np.count_nonzero(expected) > 25
    _assert_same(rendered, expected)


@pytest.mark.parametrize("shift", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("axis", [0, 1])
def test_rays_along_a_face_that_miss_it_miss_the_target(
    shift: float, axis: int
) -> None:
    """The ray through the principal point is parallel to four faces."""
    camera = _camera(center=(64, 48))
    place = np.zeros(2)
    # The nearest face is so many pixels beside that ray.
    place[axis] = _SIZE[axis] / 2 + shift * 0.79 / 138
    X_WT = _pose(*place, 0.005)
    depth = target_depth(make_target("box", _SIZE), X_WT, camera)
    assert depth[48, 64] == 0
    _assert_same(depth, _cast("box", _SIZE, X_WT, camera))


@given(seed=st.integers(0, 2**32))
@settings(deadline=None, max_examples=150)
def test_targets_keep_their_bounds(seed: int) -> None:
    target = draw_target(np.random.default_rng(seed))
    assert is_virtual(target.name)
    kind = target.name.split("_")[1]
    length, width, thickness = target.size
    for sign in (-1, 1):
        np.testing.assert_allclose(
            (sign * target.vertices).max(axis=0), target.size / 2, atol=1e-12
        )
    assert 0.018 - 1e-9 <= length <= 0.14
    assert 0.007 <= width <= length + 1e-9
    assert length / width <= 10 + 1e-9
    assert np.sqrt(length * width) < 2.4 * 0.03 + 1e-9
    assert 0.003 <= thickness <= width
    if kind == "rod":
        assert thickness == width <= 0.03
    else:
        assert kind in ("box", "disc")
        assert thickness <= 0.018
    # The planes touch the body and hold it.
    ones = np.ones((len(target.vertices), 1))
    sides = np.hstack([target.vertices, ones]) @ target.planes.T
    assert sides.max() < 1e-8
    assert (sides.max(axis=0) > -1e-8).all()
    np.testing.assert_allclose(
        trimesh.convex.convex_hull(target.vertices).volume,
        _mesh(kind, target.size).volume,
    )


def test_targets_are_of_every_kind_and_size() -> None:
    rng = np.random.default_rng(0)
    targets = [draw_target(rng) for _ in range(600)]
    kinds = [target.name.split("_")[1] for target in targets]
    shares = [kinds.count(kind) / len(kinds) for kind in _KINDS]
    assert shares == pytest.approx([0.6, 0.25, 0.15], abs=0.06)
    length, width, _ = np.array([target.size for target in targets]).T
    for values, low, high in (
        (length / width, 1.3, 8),
        (np.sqrt(length * width) / 0.03, 0.7, 2),
    ):
        assert values.min() < low < high < values.max()


def test_names_tell_virtual_targets_apart(make_sample: _MakeSample) -> None:
    name = make_target("disc", np.array([0.05, 0.04, 0.003])).name
    assert name == "virtual_disc_50x40x3"
    assert [*map(is_virtual, (name, "box_2to1", "disc"))] == [
        True,
        *[False] * 2,
    ]
    with pytest.raises(ValueError, match="no kind of target is called 'ball'"):
        make_target("ball", _SIZE)
    with pytest.raises(ValueError, match="'box_2to1' is no virtual target"):
        virtual_target(make_sample())


@pytest.fixture(scope="module")
def pairs(make_sample: _MakeSample) -> list[tuple[Sample, Sample]]:
    """Samples, and each with a virtual target."""
    found = []
    for seed in range(40):
        sample = make_sample(
            seed, cover=(0.0, 0.3, 0.7, 1.0)[seed % 4], shape=_SHAPE
        )
        if seed % 2:
            tilted = _camera(tilt=seed / 5, azimuth=37 * seed)
            depth = tilted.plane_depth(0.0)
            block = (slice(20, 60), slice(40, 90))
            depth[block] = tilted.plane_depth(0.05)[block]
            instances = np.zeros(_SHAPE)
            instances[block] = 3
            sample = dataclasses.replace(
                sample,
                depth=depth,
                depth_without_target=depth,
                instances=instances,
                X_WC=tilted.X_WC,
                intrinsics=tilted.intrinsics,
            )
        made = virtual_sample(sample, np.random.default_rng(seed))
        if made is not None:
            found.append((sample, made))
    assert len(found) > 35
    return found


def test_virtual_samples_are_sound(pairs: list[tuple[Sample, Sample]]) -> None:
    """All but the target is as it was; that is as if it were rendered alone."""
    yaws = set()
    for sample, made in pairs:
        assert problems(made) == []
        for name in ("object_names", "heap_seed", "view", "num_dropped"):
            assert getattr(made, name) == getattr(sample, name)
        for name in ("X_WC", "intrinsics", "depth_without_target"):
            np.testing.assert_array_equal(
                getattr(made, name), getattr(sample, name)
            )
        seen, scene = made.target_modal, sample.depth_without_target
        np.testing.assert_allclose(
            made.depth[~seen], scene[~seen], rtol=0, atol=6e-5
        )
        nearer = made.depth[seen] < scene[seen]
        assert (nearer | (scene[seen] == 0)).all()
        # The one that was there is gone.
        others = np.where(sample.instances > 1, sample.instances, 0)
        np.testing.assert_array_equal(made.instances, np.where(seen, 1, others))
        X_WT = made.X_WT
        alone = target_depth(virtual_target(made), X_WT, made.camera)
        np.testing.assert_array_equal(made.target_amodal, alone > 0)
        label = occupancy_label(alone, scene, sample.camera, X_WT[:3, 3])
        np.testing.assert_array_equal(made.occupancy, label.distribution)
        np.testing.assert_array_equal(made.target_modal, label.modal)
        assert made.occupancy.max() == 1
        # It lies flat in the bin.
        np.testing.assert_array_equal(X_WT[2], [0, 0, 1, X_WT[2, 3]])
        assert X_WT[2, 3] == made.target_size[2] / 2
        assert (np.abs(_corners(made)[:, :2]) <= [0.25, 0.20]).all()
        yaws.add(round(float(np.arctan2(X_WT[1, 0], X_WT[0, 0])), 3))
    assert len(yaws) == len(pairs)


def _corners(made: Sample) -> np.ndarray:
    """Returns the (n, 3) corners of a virtual target in the world, m."""
    target = virtual_target(made)
    assert target.name == made.target_name
    X_WT = made.X_WT
    return target.vertices @ X_WT[:3, :3].T + X_WT[:3, 3]


def test_size_of_a_box_and_floor_are_as_asked_for(
    make_sample: _MakeSample,
) -> None:
    sample = dataclasses.replace(
        make_sample(2, cover=0.7, shape=_SHAPE),
        bin=Bin(length=0.2, width=0.16),
    )
    size = np.array([0.06, 0.015, 0.005])
    for seed in range(5):
        rng = np.random.default_rng(seed)
        made = virtual_sample(sample, rng, size=size)
        assert made is not None
        assert made.target_name.startswith("virtual_box_60x15x5")
        np.testing.assert_array_equal(made.target_size, size)
        assert (np.abs(_corners(made)[:, :2]) <= [0.1, 0.08]).all()


@pytest.mark.parametrize(
    ("how", "least", "most"),
    [({}, 0.2, 0.8), ({"hidden": 0}, 0, 0.1), ({"hidden": 1}, 0.4, 1)],
)
def test_some_are_hidden_and_one_may_ask_for_those(
    pairs: list[tuple[Sample, Sample]],
    how: dict[str, float],
    least: float,
    most: float,
) -> None:
    blank, partly = [], 0
    for seed, (sample, _) in enumerate(pairs):
        made = virtual_sample(sample, np.random.default_rng(seed), **how)
        if made is None:
            continue
        blank.append(not made.target_modal.any())
        assert made.target_amodal.any()
        partly += 0 < made.visible_fraction < 0.95
    assert len(blank) > 30
    assert least <= np.mean(blank) <= most
    assert how or partly > 5


def test_most_targets_are_placed_under_what_stands_in_the_bin(
    make_sample: _MakeSample,
) -> None:
    sample = make_sample(1, cover=0.0, shape=_SHAPE)
    scene = sample.camera.plane_depth(0.0)
    posts = np.zeros(_SHAPE, bool)
    posts[30:70:13, 30:100:13] = True
    scene[posts] = sample.camera.plane_depth(0.03)[posts]
    sample = dataclasses.replace(sample, depth_without_target=scene)
    under = []
    for seed in range(40):
        made = virtual_sample(sample, np.random.default_rng(seed))
        assert made is not None
        p_W = np.array([*made.X_WT[:2, 3], 0.03])
        u, v, _ = made.camera.project(p_W)
        under.append(posts[round(v), round(u)])
    assert np.mean(under) > 0.6


def test_targets_keep_within_the_image(make_sample: _MakeSample) -> None:
    sample = make_sample(2, cover=0.0, shape=_SHAPE)
    zoomed = sample.intrinsics * [[2.5], [2.5], [1]]
    zoomed[:2, 2] = sample.intrinsics[:2, 2]
    sample = dataclasses.replace(sample, intrinsics=zoomed)
    for seed in range(20):
        made = virtual_sample(sample, np.random.default_rng(seed))
        if made is not None:
            uv = made.camera.project(_corners(made))[:, :2]
            assert ((uv >= 0) & (uv <= [127, 95])).all()


def test_nothing_is_placed_where_the_camera_has_no_reading(
    make_sample: _MakeSample,
) -> None:
    """Such pixels, taken for points, all lie at the camera itself."""
    sample = make_sample(1, cover=0.0, shape=_SHAPE)
    scene = np.array(sample.depth_without_target)
    scene[:20] = 0
    sample = dataclasses.replace(sample, depth_without_target=scene)
    nadir = sample.X_WC[:2, 3]
    for seed in range(15):
        made = virtual_sample(sample, np.random.default_rng(seed))
        assert made is None or not np.allclose(made.X_WT[:2, 3], nadir)


def test_a_seed_decides_the_sample(make_sample: _MakeSample) -> None:
    sample = make_sample(2, cover=0.7, shape=_SHAPE, color=True)

    def draw(seed: int) -> Sample:
        made = virtual_sample(sample, np.random.default_rng(seed))
        assert made is not None
        return made

    first, again, other = draw(5), draw(5), draw(6)
    assert first.key == again.key
    # No picture of it was taken.
    assert sample.color is not None
    assert first.color is None
    for name in (*IMAGES, "X_WT", "target_size"):
        np.testing.assert_array_equal(
            getattr(first, name), getattr(again, name)
        )
    assert not np.array_equal(first.X_WT, other.X_WT)
    assert not np.array_equal(first.target_size, other.target_size)


def test_where_there_is_no_place_there_is_no_sample(
    make_sample: _MakeSample,
) -> None:
    sample = make_sample(2, cover=0.7, shape=_SHAPE)
    tiny = dataclasses.replace(sample, bin=Bin(length=0.01, width=0.01))
    rng = np.random.default_rng(0)
    assert virtual_sample(tiny, rng) is None
    # The camera looks past the bin.
    X_WC = sample.X_WC.copy()
    X_WC[0, 3] += 2.0
    past = dataclasses.replace(sample, X_WC=X_WC)
    assert virtual_sample(past, rng) is None
