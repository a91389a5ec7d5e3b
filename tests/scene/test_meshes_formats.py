"""One box, one prism and one colour in every syntax that people write."""

import re
import struct

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from xray_drake.scene.meshes.closing import closed_solid
from xray_drake.scene.meshes.formats import read_file, side_files
from xray_drake.scene.meshes.formats.file_mesh import triangulate

CORNERS = np.array(
    [[x, y, z] for x in (0, 0.08) for y in (0, 0.05) for z in (0, 0.03)]
)
QUADS = np.reshape(
    [1, 2, 4, 3, 5, 7, 8, 6, 1, 5, 6, 2, 3, 4, 8, 7, 1, 3, 7, 5, 2, 6, 8, 4],
    (6, 4),
)
V = [f"v {x} {y} {z}" for x, y, z in CORNERS]
F = ["f " + " ".join(map(str, quad)) for quad in QUADS]
BOX = "\n".join([*V, *F, ""])


def read(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    if isinstance(content, str):
        content = content.encode()
    path.write_bytes(content)
    return read_file(path)


def check_box(file):
    closed = closed_solid(file.vertices, file.triangles, file.groups)
    assert closed.mesh.volume == pytest.approx(1.2e-4, rel=1e-5)
    np.testing.assert_allclose(
        np.sort(closed.mesh.extents), [0.03, 0.05, 0.08], rtol=1e-5
    )
    assert closed.repairs == ()
    assert file.notes == ()


OBJ_SYNTAX = {
    "plain": BOX,
    "comment after a vertex": BOX.replace(" 0.03\n", " 0.03 # corner\n"),
    "comment after a face": BOX.replace("4 3\n", "4 3#quad\n"),
    "continued lines": BOX.replace("f 1 2 4 3", "f 1 2 \\\n4 3"),
    "comment that ends in a backslash": "# C:\\objects\\\n" + BOX,
    "byte order mark": "\ufeff" + BOX,
    "UTF-16": BOX.encode("utf-16"),
    "old Macintosh": BOX.replace("\n", "\r"),
    "Windows": BOX.replace("\n", "\r\n"),
    "tabs and form feeds": BOX.replace(" ", "\t").replace("\nf", "\n\f f"),
    "indented": "\n".join("   " + line for line in BOX.split("\n")),
    "Latin-1 name": b"o W\xfcrfel\n" + BOX.encode(),
    "Latin-1 name with a line separator": b"o a\x85b\n" + BOX.encode(),
    "Fortran's exponents": BOX.replace("0.08", "8.0D-2"),
    "weights": BOX.replace(" 0.03\n", " 0.03 1.0\n"),
    "texture and normals": BOX.replace("f 1 2 4 3", "f 1/1/1 2//2 4/9 3/"),
    "no newline at the end": BOX.rstrip(),
    "empty groups": "o a\ng b\ng\n" + BOX + "o c\n",
    "other elements": "vn 0 0 1\np 1\nl 1 2 3\ns off\nusemtl x\n" + BOX,
    "a face of two corners": BOX + "f 1 2\n",
    "faces before vertices": "\n".join([*F, *V]),
    "a face of each group": "\n".join(
        V + [line for k, face in enumerate(F) for line in (f"g side{k}", face)]
    ),
}


def test_relative_indices_count_from_where_they_stand(tmp_path):
    blocks = []
    for k in range(2):
        blocks += [f"v {x} {y} {z + 0.03 * k}" for x, y, z in CORNERS]
        blocks += [
            "f " + " ".join(str(corner - 9) for corner in quad)
            for quad in QUADS
        ]
    file = read(tmp_path / "a.obj", "\n".join(blocks))
    closed = closed_solid(file.vertices, file.triangles, file.groups)
    assert closed.mesh.volume == pytest.approx(2.4e-4)
    assert np.sort(closed.mesh.extents) == pytest.approx([0.05, 0.06, 0.08])


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("v 0 0 0\nf 1 2 3\n", "names vertex 3 of 1"),
        ("v 0 0 0\nf 1 0 1\n", "line 2, 'f 1 0 1': there is no vertex 0"),
        ("v 0 0 0\nf -2 1 1\n", "no vertex -2"),
        ("v 0 0\n", "line 1, 'v 0 0': a vertex has three coordinates"),
        ("v 0 0 0\n\nv 0,1 0 0\n", "line 3, 'v 0,1 0 0'"),
    ],
)
def test_an_obj_line_that_cannot_be_read_is_named(tmp_path, text, reason):
    with pytest.raises(ValueError, match=re.escape(reason)) as caught:
        read(tmp_path / "a.obj", text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("word", ["nan", "-1.#IND", "1.#QNAN00", "inf"])
def test_what_is_not_finite_is_read_as_such(tmp_path, word):
    text = BOX.replace("v 0.0", f"v {word}", 1)
    assert not np.isfinite(read(tmp_path / "a.obj", text).vertices).all()


def ply(order, faces, extra=""):
    """A PLY file; faces are 0-based corners each, order "" is ASCII."""
    name = {"": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}
    head = (
        f"ply\nformat {name[order]} 1.0\ncomment made by hand\n"
        "element vertex 8\nproperty float x\nproperty double y\n"
        "property float z\nproperty uchar quality\n"
        f"element face {len(faces)}\n{extra}"
        "property list uchar int vertex_indices\nproperty short flags\n"
        "element edge 1\nproperty int vertex1\nend_header\n"
    ).encode()
    if not order:
        rows = [f"{x} {y} {z} 7" for x, y, z in CORNERS]
        rows += [f"{len(f)} {' '.join(map(str, f))} 3" for f in faces]
        return head + "\n".join([*rows, "1"]).encode()
    body = b"".join(struct.pack(order + "fdfB", *p, 7) for p in CORNERS)
    for face in faces:
        body += struct.pack(f"{order}B{len(face)}ih", len(face), *face, 3)
    return head + body + struct.pack(order + "i", 1)


QUAD_FACES = (QUADS - 1).tolist()
MIXED_FACES = [
    *QUAD_FACES[1:],
    QUAD_FACES[0][:3],
    [QUAD_FACES[0][k] for k in (0, 2, 3)],
]


@pytest.mark.parametrize("order", ["", "<", ">"])
@pytest.mark.parametrize("faces", [QUAD_FACES, MIXED_FACES])
def test_a_box_in_any_ply(tmp_path, order, faces):
    content = ply(order, faces)
    check_box(read(tmp_path / "a.ply", content))
    with pytest.raises(ValueError, match="ends before the last of its"):
        read(tmp_path / "b.ply", content[:-20])


def test_ply_headers_of_windows_and_strips(tmp_path):
    strip = [0, 1, 2, 3, -1, 4, 6, 5, 7, -1, 0, 4, 1, 5, -1]
    strip += [2, 3, 6, 7, -1, 0, 2, 4, 6, -1, 1, 5, 3, 7]
    text = (
        "ply\r\nformat ascii 1.0\r\nelement vertex 8\r\nproperty float x\r\n"
        "property float y\r\nproperty float z\r\nelement tristrips 1\r\n"
        "property list int int vertex_indices\r\nend_header\r\n"
    )
    text += "".join(f"{x} {y} {z}\r\n" for x, y, z in CORNERS)
    text += f"{len(strip)} {' '.join(map(str, strip))}\r\n"
    check_box(read(tmp_path / "a.ply", text))


def facets(triangles, close=True):
    lines = []
    for triangle in triangles:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += ["vertex " + " ".join(map(str, p)) for p in triangle]
        lines += ["endloop", "endfacet"]
    return "\n".join(
        ["solid a b", *lines, *(["endsolid a b"] if close else [])]
    )


def box_triangles():
    made = triangulate(CORNERS[np.concatenate(QUAD_FACES)], [4] * 6)
    return CORNERS[np.concatenate(QUAD_FACES)][made.corners]


def binary_stl(triangles, header=b"", after=b""):
    body = b"".join(
        struct.pack("<12fH", 0, 0, 0, *t.ravel(), 0) for t in triangles
    )
    return header.ljust(80) + struct.pack("<I", len(triangles)) + body + after


STL_SYNTAX = {
    "ASCII": facets(box_triangles()),
    "without end": facets(box_triangles(), close=False),
    "capitals and CR": facets(box_triangles()).upper().replace("\n", "\r"),
    "quads": facets(CORNERS[np.array(QUAD_FACES)]),
    "binary": binary_stl(box_triangles()),
    "binary that begins with solid": binary_stl(box_triangles(), b"solid x"),
    "binary with more behind": binary_stl(
        box_triangles(), b"\0solid", after=b"made by"
    ),
}


def test_a_cut_stl_file_is_named(tmp_path):
    with pytest.raises(ValueError, match="ends before the last of its 12"):
        read(tmp_path / "a.stl", binary_stl(box_triangles(), b"\0")[:-60])


OFF_ROWS = "\n".join(" ".join(map(str, p)) for p in CORNERS)
OFF_FACES = "\n".join("4 " + " ".join(map(str, f)) for f in QUAD_FACES)
OFF_SYNTAX = {
    "plain": f"OFF\n8 6 12\n{OFF_ROWS}\n{OFF_FACES}\n",
    "one line, comments": f"# box\nOFF 8 6 0 # n\n\n{OFF_ROWS}\n{OFF_FACES}",
    "without keyword": f"8 6 0\n{OFF_ROWS}\n{OFF_FACES}\n",
    "normals": "NOFF\n8 6 0\n"
    + OFF_ROWS.replace("\n", " 0 0 1\n")
    + f" 0 0 1\n{OFF_FACES}",
}


SYNTAX = {
    f"{suffix}, {name}": (suffix, content)
    for suffix, of_suffix in {
        "obj": OBJ_SYNTAX,
        "stl": STL_SYNTAX,
        "off": OFF_SYNTAX,
    }.items()
    for name, content in of_suffix.items()
}


@pytest.mark.parametrize("name", SYNTAX)
def test_a_box_in_any_syntax(tmp_path, name):
    suffix, content = SYNTAX[name]
    check_box(read(tmp_path / f"a.{suffix}", content))


@settings(max_examples=50, deadline=None)
@given(
    radii=st.lists(st.floats(0.2, 1.0), min_size=3, max_size=12),
    turn=st.integers(0, 2**32 - 1),
)
def test_triangles_of_a_polygon_have_its_area(radii, turn):
    """A star-shaped polygon, however concave, lying anyhow in space."""
    count = len(radii)
    angles = np.arange(count) * 2 * np.pi / count
    x, y = np.array(radii) * [np.cos(angles), np.sin(angles)]
    area = (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2
    R = trimesh.transformations.random_rotation_matrix(
        np.random.default_rng(turn).random(3)
    )[:3, :3]
    space = np.column_stack([x, y, 0 * x]) @ R.T
    made = triangulate(space, [count])
    assert len(made.corners) == count - 2
    a, b, c = np.moveaxis(space[made.corners] @ R, 1, 0)
    signed = np.cross(b - a, c - a)[:, 2] / 2
    assert signed.sum() == pytest.approx(area, rel=1e-6)
    assert (signed > -1e-6).all()


def test_a_prism_over_a_concave_polygon_is_itself(tmp_path):
    outline = [(0, 0), (8, 0), (8, 2), (2, 2), (2, 6), (0, 6)]
    for start in range(6):
        turned = outline[start:] + outline[:start]
        lines = [f"v {x} {y} {z}" for z in (0, 3) for x, y in turned]
        lines += ["f 6 5 4 3 2 1", "f 7 8 9 10 11 12"]
        lines += [
            f"f {k + 1} {(k + 1) % 6 + 1} {(k + 1) % 6 + 7} {k + 7}"
            for k in range(6)
        ]
        file = read(tmp_path / "a.obj", "\n".join(lines))
        made = closed_solid(file.vertices, file.triangles, file.groups)
        assert made.mesh.volume == pytest.approx(72)


MATERIALS = "newmtl blue\nKd 0.1 0.2 0.9\nnewmtl grey\nKd 0.5\n"


@pytest.mark.parametrize(
    ("library", "named"),
    [("a.mtl", "a.mtl"), ("A.MTL", "a.mtl"), ("a.mtl", "C:\\x\\a.mtl")],
)
def test_the_colour_of_a_material_counts(tmp_path, library, named):
    (tmp_path / library).write_text(MATERIALS)
    text = f"mtllib {named}\nusemtl blue\n{BOX}"
    file = read(tmp_path / "a.obj", text)
    np.testing.assert_allclose(file.color, [0.1, 0.2, 0.9])
    assert file.visual is None
    assert file.notes == ()
    assert [path.name for path in side_files(tmp_path / "a.obj")] == [library]


def test_colours_are_weighed_by_area(tmp_path):
    (tmp_path / "a.mtl").write_text(MATERIALS)
    lines = ["mtllib a.mtl", *V, "usemtl grey", *F[:2], "usemtl blue", *F[2:]]
    file = read(tmp_path / "a.obj", "\n".join(lines))
    grey = 2 * 0.05 * 0.03 / (2 * (0.05 * 0.03 + 0.08 * 0.03 + 0.08 * 0.05))
    expected = grey * 0.5 + (1 - grey) * np.array([0.1, 0.2, 0.9])
    np.testing.assert_allclose(file.color, expected)


def test_what_a_material_lacks_is_named(tmp_path):
    text = f"mtllib gone.mtl a.mtl\nusemtl wood\nvt 0 0\n{BOX}"
    (tmp_path / "a.mtl").write_text("newmtl wood\nmap_Kd -s 1 1 1 my wood.png")
    file = read(tmp_path / "a.obj", text.replace("1 2 4 3", "1/1 2/1 4/1 3/1"))
    assert file.notes == (
        "its material library gone.mtl does not exist",
        "its texture my wood.png does not exist",
    )
    Image.new("RGB", (2, 2), (0, 255, 0)).save(tmp_path / "My Wood.PNG")
    file = read_file(tmp_path / "a.obj")
    assert file.visual is not None
    assert len(file.notes) == 1


@pytest.mark.parametrize("end", [" 0.1 0.2 0.9", " 25.5 51 229.5", " 1 1 1"])
def test_colours_of_vertices_count(tmp_path, end):
    text = "\n".join([line + end for line in V] + F)
    file = read(tmp_path / "a.obj", text)
    expected = [1, 1, 1] if "1 1 1" in end else [0.1, 0.2, 0.9]
    np.testing.assert_allclose(file.color, expected)


def test_colours_of_ply_and_off_count(tmp_path):
    off = f"OFF\n8 6 0\n{OFF_ROWS}\n"
    off += OFF_FACES.replace("\n", " 26 51 230\n") + " 26 51 230\n"
    header = "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    head, _, body = ply("", QUAD_FACES, header).decode().partition("end_header")
    rows = body.split("\n")
    rows[9:-1] = [f"26 51 230 {row}" for row in rows[9:-1]]
    text = head + "end_header" + "\n".join(rows)
    for file in (
        read(tmp_path / "a.off", off),
        read(tmp_path / "a.ply", text),
    ):
        np.testing.assert_allclose(file.color, [0.1, 0.2, 0.9], atol=0.002)
        check_box(file)


@pytest.mark.parametrize("factor", [[26, 51, 230, 255], None])
def test_the_colour_of_a_glb_material_counts(tmp_path, factor):
    box = trimesh.creation.box((0.08, 0.05, 0.03))
    material = trimesh.visual.material.PBRMaterial(baseColorFactor=factor)
    box.visual = trimesh.visual.TextureVisuals(material=material)
    box.export(tmp_path / "a.glb")
    file = read_file(tmp_path / "a.glb")
    check_box(file)
    if factor:
        np.testing.assert_allclose(file.color, [0.1, 0.2, 0.9], atol=0.002)


def test_two_textures_become_one(tmp_path):
    colors = {"a.png": (0, 255, 0), "b.png": (0, 0, 255)}
    for name, color in colors.items():
        Image.new("RGB", (4, 4), color).save(tmp_path / name)
    (tmp_path / "a.mtl").write_text(
        "newmtl a\nmap_Kd a.png\nnewmtl b\nmap_Kd b.png\n"
    )
    uv = ["f " + " ".join(f"{k}/1" for k in face.split()[1:]) for face in F]
    lines = ["mtllib a.mtl", "vt 0.5 0.5", *V, "usemtl a", *uv[:3]]
    lines += ["usemtl b", *uv[3:]]
    file = read(tmp_path / "a.obj", "\n".join(lines))
    shown = np.asarray(file.visual.visual.to_color().vertex_colors)[:, :3]
    found = {tuple(color) for color in shown.tolist()}
    assert found == set(colors.values())
    assert len(file.visual.faces) == 12
