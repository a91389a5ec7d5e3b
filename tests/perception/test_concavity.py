import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from xray_drake.perception.concavity import concavity

F = 100.0


def roof(slope: float, width: int = 41) -> np.ndarray:
    """Two planes that meet in the middle column, 0.8 m away.

    Args:
        slope: of the inverse depth, 1/m per pixel; where it is positive, the
            planes come nearer from there.
        width: of the image.
    """
    aside = np.abs(np.arange(width) - width // 2)
    return np.tile((1 / (1.25 + slope * aside)).astype(np.float32), (30, 1))


@given(
    a=st.floats(-0.003, 0.003),
    b=st.floats(-0.003, 0.003),
    arm=st.integers(1, 6),
    across=st.booleans(),
)
def test_planes_are_not_concave(
    a: float, b: float, arm: int, across: bool
) -> None:
    v, u = np.mgrid[:30, :40]
    depth = (1 / (1.25 + a * (u - 20) + b * (v - 15))).astype(np.float32)
    found = concavity(depth, F, arm, across=across)
    assert found.shape == depth.shape
    np.testing.assert_allclose(found, 0, atol=1e-6)


def test_folds() -> None:
    convex = concavity(roof(-0.00625), F, 3)
    np.testing.assert_allclose(convex, 0, atol=1e-6)
    concave = concavity(roof(0.00625), F, 3)
    # The chord over the fold lies as much before it as its ends do.
    np.testing.assert_allclose(concave[3:-3, 20], 0.012, rtol=0.02)
    assert np.all(concave[:, :17] < 1e-6)
    assert np.all(concave[:, 24:] < 1e-6)


def test_the_far_side_of_a_step() -> None:
    depth = np.full((30, 40), 0.8, np.float32)
    depth[:, :20] = 0.76
    along = concavity(depth, F, 3, across=False)
    assert np.all(along[:, :20] == 0)
    np.testing.assert_allclose(along[3:-3, 20:23], 0.02, rtol=0.06)
    assert np.all(along[:, 23:] == 0)
    # Across a chord it is never farther than the chord is long.
    far = np.float32(5.0)
    depth[:, 20:] = far
    across = concavity(depth, F, 3)
    assert 0 < across.max() < 3 * far / F * np.sqrt(2)


@pytest.mark.parametrize("shape", [(1, 1), (3, 50), (50, 4)])
def test_images_smaller_than_a_chord(shape: tuple[int, int]) -> None:
    found = concavity(np.ones(shape, np.float32), F, 10)
    np.testing.assert_array_equal(found, np.zeros(shape))
