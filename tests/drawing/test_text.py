import numpy as np

from xray_drake.drawing.text import text_mesh, text_picture


def area(vertices: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = (vertices.T[faces[k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def test_the_triangles_cover_the_ink() -> None:
    lines = ("seed 7: box_2to1", "xray")
    ink = text_picture(lines)
    assert ink.shape[0] == 72
    assert 0.05 < ink.mean() < 0.5
    vertices, faces = text_mesh(lines, height=0.036)
    # A pixel is a millimetre wide then.
    np.testing.assert_allclose(area(vertices, faces), ink.sum() * 1e-6)
    assert faces.shape[1] < 2 * ink.sum() / 3
    rows, columns = np.nonzero(ink)
    np.testing.assert_allclose(
        [vertices[0].min(), vertices[0].max()],
        [columns.min() * 1e-3, (columns.max() + 1) * 1e-3],
    )
    np.testing.assert_allclose(
        [vertices[1].min(), vertices[1].max()],
        [(71 - rows.max()) * 1e-3, (72 - rows.min()) * 1e-3],
    )
    assert not vertices[2].any()


def test_all_triangles_face_the_reader() -> None:
    vertices, faces = text_mesh(("L",), height=0.02)
    a, b, c = (vertices.T[faces[k]] for k in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


def test_no_ink_no_triangles() -> None:
    for lines in ((), ("",), ("  ",)):
        vertices, faces = text_mesh(lines, height=0.02)
        assert vertices.shape == (3, 0)
        assert faces.shape == (3, 0)
