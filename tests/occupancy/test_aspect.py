import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from xray_drake.occupancy.learned.single_box import (
    aspect_ratio,
    box_scale,
    nearest_ratio,
    oriented_size,
    rescale_input,
    rescale_output,
)

_SHAPES = st.sampled_from([(24, 32), (23, 31), (24, 31)])


@pytest.mark.parametrize("ratio", [1, 2, 5, 10])
def test_a_turned_box_is_measured_along_its_sides(ratio: int) -> None:
    sides = (0.005, 0.03 * ratio**0.5, 0.03 / ratio**0.5)
    turn = trimesh.transformations.random_rotation_matrix
    angles = np.random.default_rng(ratio).random(3)
    mesh = trimesh.creation.box(sides, transform=turn(angles))
    np.testing.assert_allclose(oriented_size(mesh), sorted(sides)[::-1])
    assert aspect_ratio(mesh) == pytest.approx(ratio)
    assert box_scale(mesh) == pytest.approx(1)


def test_a_sheet_has_a_ratio_and_a_scale() -> None:
    assert aspect_ratio((0.03, 0.0, 0.06)) == pytest.approx(2)
    assert box_scale((0.03, 0.0, 0.06)) == pytest.approx(2**0.5)


@pytest.mark.parametrize(
    "extents",
    [
        (0.1, 0.1),
        (0.1, 0.0, 0.0),
        (0.1, -0.1, 0.1),
        (0.1, np.nan, 0.1),
        (np.inf, 0.1, 0.1),
        0.1,
    ],
)
def test_what_has_no_size(extents: object) -> None:
    with pytest.raises(ValueError, match="no size of a target"):
        oriented_size(extents)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("ratio", "available", "nearest"),
    [
        (1.05, [10, 5, 2, 1], 1),
        (1.45, [1, 2, 5, 10], 2),  # 1.5 were halfway, linearly
        (7.0, [1, 2, 5, 10], 5),  # and here 7.5
        (7.2, [1, 2, 5, 10], 10),
        (100, [1, 2], 2),
        (2, [4, 1], 1),  # as near: the smaller
    ],
)
def test_the_nearest_ratio_is_nearest_in_logarithm(
    ratio: float, available: list[float], nearest: float
) -> None:
    assert nearest_ratio(ratio, available) == nearest


def test_a_target_of_the_right_size_changes_nothing() -> None:
    depth = np.array([[0.8, np.nan, np.inf], [-0.0, 0.1, 0.7]], np.float32)
    mask = np.array([[0, 1, 0], [1, 1, 0]], bool)
    same_depth, same_mask = rescale_input(depth, mask, 1.0)
    assert same_depth is depth
    assert same_mask is mask
    assert rescale_output(depth, 1.0) is depth


def _shown(shape: tuple[int, int], s: float) -> np.ndarray:
    """(2, H, W): v₀ + s (v − v₀) and u₀ + s (u − u₀)."""
    center = (np.array(shape)[:, None, None] - 1) / 2
    return center + s * (np.indices(shape) - center)


@settings(max_examples=40)
@given(s=st.floats(0.5, 2.5), shape=_SHAPES, seed=st.integers(0, 99))
def test_each_pixel_shows_the_nearest_to_where_it_comes_from(
    s: float, shape: tuple[int, int], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.5, 0.9, shape).astype(np.float32)
    mask = depth > 0.7
    small_depth, small_mask = rescale_input(depth, mask, s)
    assert small_depth.shape == small_mask.shape == shape
    assert small_depth.dtype == np.float32
    assert small_mask.dtype == bool
    shown = np.floor(_shown(shape, s) + 0.5).astype(int)
    for pixel in np.ndindex(shape):
        v, u = shown[:, *pixel]
        known = 0 <= v < shape[0] and 0 <= u < shape[1]
        assert small_depth[pixel] == (depth[v, u] if known else 0)
        assert small_mask[pixel] == (known and mask[v, u])


@settings(max_examples=40)
@given(s=st.floats(0.5, 2.5), shape=_SHAPES, seed=st.integers(0, 99))
def test_an_answer_is_scaled_back_bilinearly(
    s: float, shape: tuple[int, int], seed: int
) -> None:
    answer = np.random.default_rng(seed).random(shape, dtype=np.float32)
    back = rescale_output(answer, s)
    assert back.shape == shape
    assert back.dtype == np.float32
    expected = ndimage.map_coordinates(
        answer, _shown(shape, 1 / s), order=1, mode="grid-constant"
    )
    # OpenCV rounds places to 1/32 of a pixel.
    assert np.abs(back - expected).max() < 0.07
    assert np.abs(back - expected).mean() < 0.015
