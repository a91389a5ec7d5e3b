"""What lies behind an object, against a slow search and by laws."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.occupancy.scenes import make_camera
from tests.policy.blocks import (
    CAMERA_HEIGHT,
    SHAPE,
    Block,
    heights_of,
    look,
    overhead_camera,
)
from xray_drake.geometry.floor_grid import observed_heights
from xray_drake.policy.removal import Removal, surface_behind


def brute_force(
    heights: np.ndarray, mask: np.ndarray
) -> dict[tuple[int, int], set[float]]:
    """Returns for each pixel of a mask the heights that may lie behind it."""
    rows, columns = mask.shape
    lower = []
    for i in range(rows):
        for j in range(columns):
            if mask[i, j] or not np.isfinite(heights[i, j]):
                continue
            edge = [
                heights[a, b]
                for a in range(max(i - 1, 0), min(i + 2, rows))
                for b in range(max(j - 1, 0), min(j + 2, columns))
                if mask[a, b]
            ]
            if edge and heights[i, j] < max(edge) - 0.001:
                lower.append((i, j))
    result = {}
    for i, j in np.argwhere(mask).tolist():
        if not lower:
            result[i, j] = {min(heights[i, j], np.float32(0))}
            continue
        away = [(a - i) ** 2 + (b - j) ** 2 for a, b in lower]
        result[i, j] = {
            min(heights[i, j], heights[lower[k]])
            for k in np.flatnonzero(np.array(away) == min(away))
        }
    return result


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1))
def test_it_is_what_a_slow_search_finds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    coarse = rng.choice([-np.inf, 0.0, 0.01, 0.02, 0.05], (3, 4))
    heights = np.kron(coarse, np.ones((4, 4))).astype(np.float32)
    heights += rng.choice([0.0, 0.0004], heights.shape).astype(np.float32)
    mask = np.kron(rng.random((4, 4)) < 0.3, np.ones((3, 4))) > 0
    behind = surface_behind(heights, mask)
    np.testing.assert_array_equal(behind[~mask], heights[~mask])
    for place, allowed in brute_force(heights, mask).items():
        assert behind[place] in allowed


SLAB = Block("slab", 20, 20, 30, 40, 0.01)
CUP = Block("cup", 30, 30, 8, 8, 0.06)
LOW = Block("low", 20, 20, 10, 10, 0.02)
TALL = Block("tall", 20, 30, 10, 10, 0.08)


@pytest.mark.parametrize(
    ("stays", "goes"),
    [
        pytest.param(SLAB, CUP, id="the slab goes on under the cup"),
        pytest.param(TALL, LOW, id="what is higher does not go on under it"),
        pytest.param(CUP, None, id="nothing goes"),
    ],
)
def test_what_an_object_leaves(stays: Block, goes: Block | None) -> None:
    seen = look([stays, goes] if goes else [stays])
    mask = goes.mask if goes else np.zeros(SHAPE, bool)
    depth, heights = Removal(seen.depth, overhead_camera()).without(mask)
    np.testing.assert_allclose(depth, look([stays]).depth, atol=1e-6)
    np.testing.assert_allclose(heights, heights_of(depth), atol=1e-6)


@pytest.mark.parametrize("view", [{}, {"tilt": 10, "azimuth": 57, "roll": 8}])
def test_depth_and_height_agree_under_any_camera(view: dict) -> None:
    camera = make_camera(
        focal_length=138, center=(63.5, 47.5), size=SHAPE[::-1], **view
    )
    depth = camera.plane_depth(0.0).astype(np.float32)
    mask = Block("cup", 40, 50, 10, 12).mask
    depth[mask] = camera.plane_depth(0.05)[mask]
    without, heights = Removal(depth, camera).without(mask)
    np.testing.assert_allclose(
        observed_heights(without, camera, 0.0), heights, atol=1e-5
    )
    np.testing.assert_allclose(
        without[mask], camera.plane_depth(0.0)[mask], atol=1e-5
    )
    assert camera.X_WC[2, 3] <= CAMERA_HEIGHT
