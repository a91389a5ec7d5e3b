import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import QhullError
from scipy.spatial.transform import Rotation

from xray_drake.geometry.convex import half_thickness


def cuboid(size: tuple[float, float, float]) -> np.ndarray:
    corners = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T
    return corners * size


sizes = st.floats(0.003, 0.2)


@settings(deadline=None, max_examples=60)
@given(sizes, sizes, sizes, st.integers(0, 2**32 - 1))
def test_half_the_least_side_of_a_box_however_it_lies(
    x: float, y: float, z: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    turn = Rotation.from_quat(rng.normal(size=4)).as_matrix()
    vertices = cuboid((x, y, z))
    vertices = np.vstack([vertices, 0.3 * vertices])  # some inside
    vertices = vertices @ turn.T + rng.uniform(-1, 1, 3)
    assert half_thickness(vertices) == pytest.approx(min(x, y, z) / 2)


def test_a_tetrahedron_from_a_face_to_the_opposite_vertex() -> None:
    edge = np.sqrt(2.0)
    vertices = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]]) * 1.0
    assert half_thickness(vertices) == pytest.approx(edge * np.sqrt(2 / 3) / 2)


def test_a_flat_piece_is_an_error() -> None:
    with pytest.raises(QhullError):
        half_thickness(cuboid((0.1, 0.1, 0.0)))
