import numpy as np
import pytest
from matplotlib.textpath import TextPath

from xray_drake.drawing.text import text_mesh


def areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (vertices.T[faces[k]] for k in range(3))
    return np.cross(b - a, c - a)[:, 2] / 2


@pytest.mark.parametrize("text", ["seed 7: box_2to1", "B8%", "$5 or $6", "i"])
def test_the_triangles_cover_the_ink_and_face_the_reader(text: str) -> None:
    vertices, faces = text_mesh((text,), height=0.036)
    assert not vertices[2].any()
    assert (areas(vertices, faces) > 0).all()
    # Letters' holes turn the other way.
    path = TextPath((0, 0), text.replace("$", r"\$"), size=0.8 * 36)
    signed = [
        np.sum(p[:-1, 0] * p[1:, 1] - p[1:, 0] * p[:-1, 1]) / 2
        for p in path.to_polygons()
    ]
    ink = abs(sum(signed)) * 1e-6
    assert areas(vertices, faces).sum() == pytest.approx(ink, rel=0.02)
    np.testing.assert_allclose(
        np.ptp(vertices[:2], axis=1),
        np.ptp(path.get_extents().get_points(), axis=0) * 1e-3,
        rtol=0.02,
    )


def test_lines_stand_one_below_the_other() -> None:
    lower, _ = text_mesh(("g",), height=0.02)
    both, _ = text_mesh(("L", "g"), height=0.02)
    assert 0 < lower[1].min() == both[1].min() < lower[1].max() < 0.02
    assert 0.02 < both[1].max() < 0.04


def test_no_ink_no_triangles() -> None:
    for lines in ((), ("",), ("  ",)):
        vertices, faces = text_mesh(lines, height=0.02)
        assert vertices.shape == faces.shape == (3, 0)
