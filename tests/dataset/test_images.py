import numpy as np
import pytest

from xray_drake.dataset.images import LabelledImages, downscale
from xray_drake.occupancy.learned.augmented_depth import (
    NO_READING,
    augmented_depth,
)


def test_the_network_sees_mask_depth_depth() -> None:
    depth = np.array([[0.8, 0.7, 0.0, np.inf, np.nan, 3.0, 0.1]])
    modal = np.array([[False, True, False, False, False, False, False]])
    seen = augmented_depth(depth, modal)
    assert seen.dtype == np.float32
    assert seen.shape == (3, 1, 7)
    np.testing.assert_array_equal(seen[0], modal)
    np.testing.assert_array_equal(seen[1], seen[2])
    far = NO_READING
    np.testing.assert_allclose(
        seen[1, 0], [0, -1, far, far, far, far, -far], atol=1e-6
    )


def _images(depth: np.ndarray, mask: np.ndarray) -> LabelledImages:
    return LabelledImages(
        depth=depth.astype(np.float32),
        modal=mask,
        amodal=mask,
        occupancy=mask.astype(np.float32),
        focal_length=100.0,
    )


def test_missing_readings_are_not_mixed_in() -> None:
    depth = np.array([[0.8, 0.6, 0.5, 0.0], [0.0, 0.0, 0.0, 0.0]])
    mask = np.array([[1, 1, 1, 0], [1, 0, 1, 0]], bool)
    small = downscale(_images(depth, mask), 2)
    # Two of four have a reading: their mean. One of four: none.
    np.testing.assert_allclose(small.depth, [[0.7, 0.0]], rtol=1e-6)
    np.testing.assert_array_equal(small.modal, [[True, False]])
    np.testing.assert_allclose(small.occupancy, [[0.75, 0.5]])
    assert small.focal_length == 50.0
    assert small.depth.dtype == small.occupancy.dtype == np.float32
    assert small.modal.dtype == small.amodal.dtype == bool


def test_means_stay_within_what_was_seen() -> None:
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.6, 0.9, (24, 32)) * (rng.random((24, 32)) > 0.3)
    small = downscale(_images(depth, depth > 0.7), 4)
    seen = small.depth[small.depth > 0]
    assert small.depth.shape == (6, 8)
    assert np.all((seen > 0.6) & (seen < 0.9))


def test_a_factor_of_one_changes_nothing() -> None:
    images = _images(np.ones((3, 5)), np.ones((3, 5), bool))
    assert downscale(images, 1) is images


@pytest.mark.parametrize("factor", [0, -1, 2, 5])
def test_a_factor_must_divide_the_image(factor: int) -> None:
    with pytest.raises(ValueError, match="3×5 cannot be scaled down"):
        downscale(_images(np.ones((3, 5)), np.ones((3, 5), bool)), factor)
