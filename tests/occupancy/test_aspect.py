import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from xray_drake.occupancy.learned.single_box import (
    aspect_ratio,
    box_scale,
    nearest_ratio,
    oriented_size,
    rescale_input,
    rescale_output,
)

_SHAPE = (96, 128)
_SCALES = st.floats(0.5, 2.5)


def _box(extents: tuple[float, float, float], seed: int) -> trimesh.Trimesh:
    """A box, turned at random."""
    return trimesh.creation.box(
        extents,
        transform=trimesh.transformations.random_rotation_matrix(
            np.random.default_rng(seed).random(3)
        ),
    )


def _from_center(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) rows and columns, from the image's centre."""
    rows, columns = np.mgrid[: shape[0], : shape[1]].astype(float)
    return rows - (shape[0] - 1) / 2, columns - (shape[1] - 1) / 2


def _radius_and_center(mask: np.ndarray) -> tuple[float, np.ndarray]:
    """Of a disc: by its area, and (2,) from the image's centre."""
    rows, columns = _from_center(mask.shape)
    center = np.array([rows[mask].mean(), columns[mask].mean()])
    return float(np.sqrt(mask.sum() / np.pi)), center


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("ratio", [1, 2, 5, 10])
def test_a_turned_box_is_measured_along_its_sides(
    ratio: int, seed: int
) -> None:
    sides = (0.005, 0.03 * ratio**0.5, 0.03 / ratio**0.5)
    mesh = _box(sides, seed)
    np.testing.assert_allclose(oriented_size(mesh), sorted(sides)[::-1])
    assert aspect_ratio(mesh) == pytest.approx(ratio)
    assert box_scale(mesh) == pytest.approx(1)


@pytest.mark.parametrize(
    ("extents", "ratio", "scale"),
    [
        ((0.060, 0.057, 0.010), 60 / 57, 1.949),  # lid
        ((0.0075, 0.024, 0.048), 2, 1.131),  # domino
        ((0.110, 0.022, 0.016), 5, 1.640),  # flute
        ((0.03, 0.0, 0.03), 1, 1),  # a sheet
    ],
)
def test_the_two_longer_sides_count(
    extents: tuple[float, float, float], ratio: float, scale: float
) -> None:
    assert aspect_ratio(extents) == pytest.approx(ratio)
    assert box_scale(np.array(extents)) == pytest.approx(scale, abs=5e-4)


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
        aspect_ratio(extents)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="no size of a target"):
        box_scale(extents)  # type: ignore[arg-type]


def test_the_nearest_ratio_is_nearest_in_logarithm() -> None:
    assert nearest_ratio(1.05, [10, 5, 2, 1]) == 1
    assert nearest_ratio(1.45, [1, 2, 5, 10]) == 2  # 1.5 were halfway, linearly
    assert nearest_ratio(7.0, [1, 2, 5, 10]) == 5  # and here 7.5
    assert nearest_ratio(7.2, [1, 2, 5, 10]) == 10
    assert nearest_ratio(100, [1, 2]) == 2
    assert nearest_ratio(2, [4, 1]) == 1  # as near: the smaller
    for ratio, available in ((2, []), (0, [1]), (np.nan, [1]), (2, [1, -1])):
        with pytest.raises(ValueError, match="aspect ratio"):
            nearest_ratio(ratio, available)


def test_a_target_of_the_right_size_changes_nothing() -> None:
    depth = np.array([[0.8, np.nan, np.inf], [-0.0, 0.1, 0.7]], np.float32)
    mask = np.array([[0, 1, 0], [1, 1, 0]], bool)
    same_depth, same_mask = rescale_input(depth, mask, 1.0)
    assert same_depth is depth
    assert same_mask is mask
    assert rescale_output(depth, 1.0) is depth


@pytest.mark.parametrize("s", [0, -1, np.nan, np.inf])
def test_scales_are_above_0(s: float) -> None:
    image = np.zeros(_SHAPE, np.float32)
    with pytest.raises(ValueError, match="no scale"):
        rescale_input(image, image > 0, s)
    with pytest.raises(ValueError, match="no scale"):
        rescale_output(image, s)


def test_images_must_fit() -> None:
    image = np.zeros(_SHAPE, np.float32)
    with pytest.raises(ValueError, match=r"both must be \(H, W\)"):
        rescale_input(image, np.zeros((5, 5), bool), 2)
    with pytest.raises(ValueError, match=r"both must be \(H, W\)"):
        rescale_input(image[0], image[0] > 0, 2)
    with pytest.raises(ValueError, match=r"is \(H, W\), not"):
        rescale_output(image[0], 2)


@pytest.mark.parametrize("shape", [(96, 128), (95, 127)])
def test_twice_as_large_is_every_other_pixel(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.5, 0.9, shape).astype(np.float32)
    small, _ = rescale_input(depth, depth > 0.7, 2.0)
    known = small > 0
    rows, columns = np.flatnonzero(known.any(1)), np.flatnonzero(known.any(0))
    inside = small[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    assert abs(len(rows) - shape[0] / 2) <= 0.5
    assert abs(len(columns) - shape[1] / 2) <= 0.5
    starts = [(i, j) for i in (0, 1) for j in (0, 1)]
    assert any(
        np.array_equal(inside, depth[i::2, j::2][: len(rows), : len(columns)])
        for i, j in starts
    )


@settings(max_examples=40, deadline=None)
@given(
    s=_SCALES,
    radius=st.floats(6, 16),
    row=st.floats(-8, 8),
    column=st.floats(-12, 12),
)
def test_a_disc_shrinks_towards_the_centre(
    s: float, radius: float, row: float, column: float
) -> None:
    rows, columns = _from_center(_SHAPE)
    mask = np.hypot(rows - row, columns - column) <= radius
    depth = np.where(mask, 0.7, 0.8).astype(np.float32)
    small_depth, small_mask = rescale_input(depth, mask, s)
    assert small_depth.shape == small_mask.shape == _SHAPE
    assert small_depth.dtype == np.float32
    assert small_mask.dtype == bool

    got, center = _radius_and_center(small_mask)
    assert got == pytest.approx(radius / s, abs=1)
    np.testing.assert_allclose(center, np.array([row, column]) / s, atol=1)
    # The depth goes with the mask, and stays metric.
    np.testing.assert_array_equal(small_mask, small_depth == np.float32(0.7))
    assert set(np.unique(small_depth)) <= set(np.float32([0, 0.7, 0.8]))

    back = rescale_output(small_mask.astype(np.float32), s)
    assert back.shape == _SHAPE
    assert back.dtype == np.float32
    got, center = _radius_and_center(back > 0.5)
    assert got == pytest.approx(radius, abs=max(1, s))
    np.testing.assert_allclose(center, [row, column], atol=max(1, s))


@settings(max_examples=40, deadline=None)
@given(s=_SCALES)
def test_only_what_the_camera_saw_is_known(s: float) -> None:
    depth = np.full(_SHAPE, 0.8, np.float32)
    small_depth, small_mask = rescale_input(depth, depth > 0, s)
    rows, columns = _from_center(_SHAPE)
    outside = np.maximum(
        s * np.abs(rows) - _SHAPE[0] / 2, s * np.abs(columns) - _SHAPE[1] / 2
    )
    assert np.all(small_depth[outside > 1e-9] == 0)
    assert np.all(small_depth[outside < -1e-9] == np.float32(0.8))
    np.testing.assert_array_equal(small_mask, small_depth > 0)
    ones = rescale_output(np.ones(_SHAPE, np.float32), s)
    beyond = np.maximum(
        np.abs(rows) / s - _SHAPE[0] / 2, np.abs(columns) / s - _SHAPE[1] / 2
    )
    assert np.all(ones[beyond > 1] == 0)
    np.testing.assert_allclose(ones[beyond < -1], 1, atol=1e-6)
