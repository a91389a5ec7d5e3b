import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from xray_drake.dataset.augmentation import (
    Augmentation,
    DepthNoise,
    flip,
    resize_mask,
    rotate,
    unlit,
)
from xray_drake.dataset.images import LabelledImages
from xray_drake.dataset.sample import Sample

_FIELDS = ("depth", "modal", "amodal", "occupancy")


@pytest.fixture
def images(make_sample: Callable[..., Sample]) -> LabelledImages:
    sample = make_sample(4, shape=(48, 64))
    return LabelledImages(
        depth=sample.depth,
        modal=sample.target_modal,
        amodal=sample.target_amodal,
        occupancy=sample.occupancy,
        focal_length=70.0,
    )


def _coordinates(height: int = 30, width: int = 41) -> LabelledImages:
    """Images whose pixels all differ, and say the same."""
    values = np.arange(1, height * width + 1, dtype=np.float32)
    values = values.reshape(height, width)
    return LabelledImages(
        depth=values,
        modal=values % 2 == 1,
        amodal=values % 3 == 1,
        occupancy=values / values.max(),
        focal_length=50.0,
    )


def _assert_same(a: LabelledImages, b: LabelledImages) -> None:
    for name in _FIELDS:
        assert getattr(a, name).dtype == getattr(b, name).dtype
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def _assert_consistent(images: LabelledImages) -> None:
    """All images were moved alike: made of :func:`_coordinates`."""
    values = images.depth
    inside = values > 0
    np.testing.assert_array_equal(images.modal, inside & (values % 2 == 1))
    np.testing.assert_array_equal(images.amodal, inside & (values % 3 == 1))
    np.testing.assert_allclose(images.occupancy, values / (30 * 41))


@pytest.mark.parametrize("left_right", [True, False])
@pytest.mark.parametrize("up_down", [True, False])
def test_mirroring_twice_changes_nothing(
    left_right: bool, up_down: bool
) -> None:
    images = _coordinates()
    once = flip(images, left_right=left_right, up_down=up_down)
    _assert_consistent(once)
    assert (once.depth[0, 0] == images.depth[0, 0]) == (
        not left_right and not up_down
    )
    _assert_same(flip(once, left_right=left_right, up_down=up_down), images)


@pytest.mark.parametrize("turns", [-2, -1, 0, 1, 2])
def test_whole_turns_change_nothing(turns: int) -> None:
    _assert_same(rotate(_coordinates(), turns * 2 * math.pi), _coordinates())


def test_half_a_turn_is_both_mirrors() -> None:
    images = _coordinates()
    _assert_same(
        rotate(images, math.pi), flip(images, left_right=True, up_down=True)
    )


@pytest.mark.parametrize("shape", [(30, 30), (31, 31)])
def test_a_quarter_turn_of_a_square_is_exact(shape: tuple[int, int]) -> None:
    images = _coordinates(*shape)
    turned = rotate(images, math.pi / 2)
    np.testing.assert_array_equal(turned.depth, np.rot90(images.depth))
    four = images
    for _ in range(4):
        four = rotate(four, math.pi / 2)
    _assert_same(four, images)


@given(angle=st.floats(-10, 10))
def test_all_images_turn_alike(angle: float) -> None:
    turned = rotate(_coordinates(), angle)
    _assert_consistent(turned)
    # The centre stays, the shape too.
    assert turned.depth[15, 20] > 0
    assert turned.shape == (30, 41)


@given(angle=st.floats(-math.pi, math.pi))
def test_turning_back_gives_the_middle_back(angle: float) -> None:
    v, u = np.mgrid[:30, :41]
    values = (1 + 0.01 * u + 0.02 * v).astype(np.float32)
    images = replace(_coordinates(), depth=values)
    back = rotate(rotate(images, angle), -angle)
    middle = np.hypot(u - 20, v - 14.5) < 12
    # Each turn rounds by half a pixel in u and v.
    np.testing.assert_allclose(
        back.depth[middle], values[middle], atol=2 * 0.5 * 0.03 + 1e-5
    )


def test_what_is_missing_stays_missing(images: LabelledImages) -> None:
    holes = images.depth.copy()
    holes[10:14, 20:30] = 0
    noisy = DepthNoise()(replace(images, depth=holes), np.random.default_rng(0))
    assert not noisy.depth[holes == 0].any()
    _assert_same(replace(noisy, depth=images.depth), images)


def test_noise_grows_with_the_square_of_depth() -> None:
    noise = DepthNoise(
        inverse_depth_step=0, baseline=0, blobs=0, speckle=0, sigma=0.001
    )
    spread = []
    for depth in (0.5, 1.0):
        images = replace(
            _coordinates(100, 100), depth=np.full((100, 100), depth, "f4")
        )
        noisy = noise(images, np.random.default_rng(1)).depth
        assert noisy.mean() == pytest.approx(depth, abs=1e-4)
        spread.append(noisy.std())
    assert spread[1] == pytest.approx(4 * spread[0], rel=0.05)
    assert 0 < spread[1] < 0.001


def test_depth_comes_in_steps() -> None:
    noise = DepthNoise(sigma=0.001, inverse_depth_step=0.01)
    images = replace(
        _coordinates(100, 100), depth=np.full((100, 100), 0.8, "f4")
    )
    noisy = noise(images, np.random.default_rng(1)).depth
    steps = 1 / noisy[noisy > 0] / 0.01
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-4)


def test_edges_and_blobs_have_no_reading(images: LabelledImages) -> None:
    # Too steep are the pixels beside a step, nothing else.
    edges = DepthNoise(baseline=0, blobs=0, speckle=0)
    lost = edges(images, np.random.default_rng(2)).depth == 0
    lost &= images.depth > 0
    v, u = np.nonzero(lost)
    assert 0 < len(v) < 0.2 * lost.size
    depth = np.pad(images.depth, 1, mode="edge")
    for row, column in zip(v, u, strict=True):
        assert np.ptp(depth[row : row + 3, column : column + 3]) > 0.01
    blobs = DepthNoise(baseline=0, speckle=0, blobs=30, max_incidence=1.57)
    lost = blobs(images, np.random.default_rng(2)).depth == 0
    assert 0.002 < lost.mean() < 0.5


def test_a_projector_leaves_shadows_beside_what_is_near() -> None:
    depth = np.full((4, 40), 0.8)
    depth[:, 15:20] = 0.4
    f, b = 100.0, 0.04  # disparities 5 and 10
    shadow = unlit(depth, f, b)
    assert shadow[0].nonzero()[0].tolist() == [10, 11, 12, 13, 14]
    # On the other side for a projector on the other side.
    shadow = unlit(depth, f, -b)
    assert shadow[0].nonzero()[0].tolist() == [20, 21, 22, 23, 24]
    assert not unlit(depth, f, 0.0).any()
    depth[:, 15:20] = 0.0
    assert not unlit(depth, f, b).any()


@given(
    row=st.lists(
        st.sampled_from([0.0, 0.4, 0.45, 0.5, 0.8, 0.81]),
        min_size=2,
        max_size=40,
    ),
    baseline=st.sampled_from([-0.07, 0.03, 0.11]),
)
def test_shadows_as_ray_by_ray(row: list[float], baseline: float) -> None:
    depth = np.array([row])
    found = unlit(depth, 60.0, baseline)[0]
    for u, z in enumerate(row):
        at = u - 60.0 * baseline / z if z else 0
        crossed = z > 0 and any(
            (other - 60.0 * baseline / y - at) * (other - u) <= 0
            for other, y in enumerate(row)
            if y > 0 and other != u and (other - u) * baseline > 0
        )
        assert found[u] == crossed


def test_masks_grow_and_shrink(images: LabelledImages) -> None:
    grown, shrunk = resize_mask(images, 1).modal, resize_mask(images, -1).modal
    assert np.all(images.modal <= grown)
    assert np.all(shrunk <= images.modal)
    assert shrunk.sum() < images.modal.sum() < grown.sum()
    assert grown.dtype == bool
    assert resize_mask(images, 0) is images
    blank = replace(images, modal=np.zeros_like(images.modal))
    assert not resize_mask(blank, 3).modal.any()


@pytest.mark.parametrize(
    "augmentation",
    [
        Augmentation(),
        Augmentation(flips=False, noise=None),
        Augmentation(max_rotation=0.3, mask_noise=2),
    ],
)
def test_a_seed_decides(
    images: LabelledImages, augmentation: Augmentation
) -> None:
    def once(seed: int) -> LabelledImages:
        return augmentation(images, np.random.default_rng(seed))

    before = {name: getattr(images, name).copy() for name in _FIELDS}
    _assert_same(once(5), once(5))
    assert not np.array_equal(once(5).depth, once(6).depth)
    for name, value in before.items():
        np.testing.assert_array_equal(getattr(images, name), value)
    for seed in range(5):
        seen = once(seed)
        assert seen.shape == images.shape
        assert seen.depth.dtype == np.float32
        assert np.isfinite(seen.depth).all()
        assert seen.depth.min() >= 0
        assert seen.occupancy.max() <= 1


def test_nothing_asked_for_nothing_done(images: LabelledImages) -> None:
    nothing = Augmentation(flips=False, max_rotation=0, noise=None)
    assert nothing(images, np.random.default_rng(0)) is images
