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
    sense,
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
def test_images_are_mirrored_alike(left_right: bool, up_down: bool) -> None:
    images = _coordinates()
    once = flip(images, left_right=left_right, up_down=up_down)
    _assert_consistent(once)
    axes = [a for a, chosen in enumerate((up_down, left_right)) if chosen]
    np.testing.assert_array_equal(once.depth, np.flip(images.depth, axes))
    if left_right and up_down:
        _assert_same(once, rotate(images, math.pi))


@pytest.mark.parametrize("side", [30, 31])
def test_quarter_turns_of_a_square_are_exact(side: int) -> None:
    images = _coordinates(side, side)
    for turns in range(-4, 5):
        turned = rotate(images, turns * math.pi / 2)
        np.testing.assert_array_equal(
            turned.depth, np.rot90(images.depth, turns)
        )


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
    images = replace(images, depth=holes)
    noisy = sense(images, DepthNoise(), np.random.default_rng(0))
    assert not noisy.depth[holes == 0].any()
    _assert_same(replace(noisy, depth=images.depth), images)


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
    for seen in map(once, range(5)):
        assert seen.shape == images.shape
        assert seen.depth.dtype == np.float32
        assert np.isfinite(seen.depth).all()
        assert seen.depth.min() >= 0
        assert seen.occupancy.max() <= 1
    nothing = Augmentation(flips=False, max_rotation=0, noise=None)
    assert nothing(images, np.random.default_rng(0)) is images
