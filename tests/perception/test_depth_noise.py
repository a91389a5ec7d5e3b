import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from xray_drake.perception.depth_noise import DepthNoise, unlit


def flat(depth: float = 0.8) -> np.ndarray:
    return np.full((100, 100), depth, np.float32)


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_noise_grows_with_the_square_of_depth() -> None:
    noise = DepthNoise(
        inverse_depth_step=0, baseline=0, blobs=0, speckle=0, sigma=0.001
    )
    spread = []
    for depth in (0.5, 1.0):
        noisy = noise.noisy(flat(depth), 50.0, rng())
        assert noisy.mean() == pytest.approx(depth, abs=1e-4)
        spread.append(noisy.std())
    assert spread[1] == pytest.approx(4 * spread[0], rel=0.05)
    assert 0 < spread[1] < 0.001


def test_depth_comes_in_steps() -> None:
    noise = DepthNoise(sigma=0.001, inverse_depth_step=0.01)
    noisy = noise.noisy(flat(), 50.0, rng())
    steps = 1 / noisy[noisy > 0] / 0.01
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-4)


def test_edges_have_no_reading() -> None:
    depth = flat()
    depth[30:60, 40:80] = 0.7
    edges = DepthNoise(baseline=0, blobs=0, speckle=0)
    lost = edges.noisy(depth, 1e5, rng()) == 0
    # All pixels along the step, and none but those.
    ring = np.zeros_like(lost)
    ring[29:61, 39:81] = True
    ring[31:59, 41:79] = False
    np.testing.assert_array_equal(lost, ring)


def test_blobs_have_no_reading() -> None:
    blobs = DepthNoise(baseline=0, speckle=0, blobs=30, blob_radius=20)
    lost = blobs.noisy(flat(), 500.0, rng()) == 0
    assert 0.02 < lost.mean() < 0.8


@pytest.mark.parametrize("nothing", [-1.0, np.inf, -np.inf, np.nan])
def test_what_is_no_reading_counts_as_none(nothing: float) -> None:
    depth, zero = flat(), flat()
    depth[10:14, 20:30] = nothing
    zero[10:14, 20:30] = 0.0
    noisy = DepthNoise().noisy(depth, 500.0, rng())
    assert not noisy[10:14, 20:30].any()
    np.testing.assert_array_equal(noisy, DepthNoise().noisy(zero, 500.0, rng()))


def test_a_seed_decides() -> None:
    depth = flat()
    noisy = DepthNoise().noisy(depth, 500.0, rng(1))
    np.testing.assert_array_equal(
        noisy, DepthNoise().noisy(depth, 500.0, rng(1))
    )
    assert np.any(noisy != DepthNoise().noisy(depth, 500.0, rng(2)))
    np.testing.assert_array_equal(depth, flat())


@given(
    row=st.lists(
        st.sampled_from([0.0, 0.4, 0.45, 0.5, 0.8, 0.81]),
        min_size=2,
        max_size=40,
    ),
    baseline=st.sampled_from([-0.07, 0.0, 0.03, 0.11]),
)
def test_shadows_as_ray_by_ray(row: list[float], baseline: float) -> None:
    """A projector leaves shadows beside what is near, on its other side."""
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
