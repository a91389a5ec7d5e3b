import dataclasses

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.occupancy.scenes import make_camera
from xray_drake.geometry.silhouette import project_mesh_mask
from xray_drake.occupancy.learned.inputs import (
    lengths_in_image,
    size_features,
)
from xray_drake.occupancy.learned.window import target_window

CAMERA = make_camera(size=(512, 384))


def outline(
    size: tuple[float, float], place: np.ndarray, angle: float
) -> np.ndarray:
    """(H, W) bool: a flat rectangle on the floor, seen by the camera."""
    mesh = trimesh.creation.box([*size, 1e-9])
    X_WO = trimesh.transformations.rotation_matrix(angle, [0, 0, 1])
    X_WO[:2, 3] = place
    return project_mesh_mask(mesh.vertices, mesh.faces, X_WO, CAMERA)


_length = st.floats(0.02, 0.12)
_place = st.tuples(st.floats(-0.2, 0.2), st.floats(-0.14, 0.14))
_angle = st.floats(0, np.pi)
_inside = st.tuples(st.floats(-0.45, 0.45), st.floats(-0.45, 0.45))


@given(
    size=st.tuples(_length, _length),
    shared=_place,
    poses=st.tuples(st.tuples(_inside, _angle), st.tuples(_inside, _angle)),
    cut=st.integers(0, 100),
)
@settings(max_examples=60)
def test_it_holds_every_pose_that_covers_what_is_seen(
    size: tuple[float, float],
    shared: tuple[float, float],
    poses: tuple[tuple[tuple[float, float], float], ...],
    cut: int,
) -> None:
    # Two poses that both show the point: either might be the true one.
    masks = []
    for inside, angle in poses:
        c, s = np.cos(angle), np.sin(angle)
        from_middle = np.multiply(inside, size) @ [[c, s], [-s, c]]
        masks.append(outline(size, shared - from_middle, angle))
    seen = masks[0] & masks[1]
    columns = np.flatnonzero(seen.any(axis=0))
    # What lies right of a line is hidden.
    seen[:, columns[0] + 1 + (len(columns) * cut) // 100 :] = False
    features = size_features(np.array([*size, 0.005]), seen, CAMERA)
    window = target_window(seen, features)
    for mask in (seen, *masks):
        left_out = mask.copy()
        left_out[window.rows, window.columns] = False
        assert not left_out.any()


@given(
    shape=st.sampled_from([(384, 512), (192, 256), (64, 96), (32, 32)]),
    spots=st.lists(
        st.tuples(st.floats(0, 0.999), st.floats(0, 0.999)),
        min_size=1,
        max_size=3,
    ),
    size=st.tuples(_length, _length),
)
def test_it_is_a_square_in_the_image_or_as_large_as_that(
    shape: tuple[int, int],
    spots: list[tuple[float, float]],
    size: tuple[float, float],
) -> None:
    height, width = shape
    mask = np.zeros(shape, bool)
    for v, u in spots:
        mask[int(v * height), int(u * width)] = True
    camera = dataclasses.replace(CAMERA, width=width, height=height)
    window = target_window(
        mask, size_features(np.array([*size, 0.005]), mask, camera)
    )
    assert window.top % 4 == window.left % 4 == 0
    assert window.height % 32 == window.width % 32 == 0
    assert 0 <= window.top <= height - window.height
    assert 0 <= window.left <= width - window.width
    side = max(window.height, window.width)
    assert window.height == min(side, height)
    assert window.width == min(side, width)
    assert window.of(mask).sum() == mask.sum()


def test_a_small_target_has_a_small_window() -> None:
    mask = np.zeros(CAMERA.shape, bool)
    mask[200:204, 300:306] = True
    features = size_features(np.array([0.04, 0.02, 0.005]), mask, CAMERA)
    assert lengths_in_image(features, 512) == pytest.approx(
        [0.04 * CAMERA.floor_scale, 0.02 * CAMERA.floor_scale], rel=0.01
    )
    window = target_window(mask, features)
    assert window.height == window.width == 96
    assert abs(window.top + 48 - 202) <= 2
    assert abs(window.left + 48 - 303) <= 2


def test_a_target_that_is_not_seen_has_none() -> None:
    mask = np.zeros(CAMERA.shape, bool)
    with pytest.raises(ValueError, match="can be anywhere"):
        target_window(mask, np.zeros(5, np.float32))
