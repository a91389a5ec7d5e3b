"""What solid the triangles of a file are."""

from itertools import pairwise

import manifold3d
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.nominal import BIN
from xray_drake.scene.meshes import import_meshes, load_meshes
from xray_drake.scene.meshes.closing import closed_solid
from xray_drake.scene.meshes.prepare import LARGEST


def box(*size, at=(0, 0, 0), inside_out=False):
    mesh = trimesh.creation.box(size)
    mesh.apply_translation(at)
    if inside_out:
        mesh.invert()
    return mesh


def ball():
    return trimesh.creation.icosphere(3, 0.03)


def closed(*meshes, grouped=False):
    whole = trimesh.util.concatenate(meshes)
    groups = np.repeat(
        np.arange(len(meshes)), [len(mesh.faces) for mesh in meshes]
    )
    made = closed_solid(
        np.asarray(whole.vertices, dtype=float),
        np.asarray(whole.faces),
        groups if grouped else np.zeros_like(groups),
    )
    assert made.mesh.is_volume
    return made


def volume(*meshes, **options):
    """cm³, where nothing had to be repaired."""
    made = closed(*meshes, **options)
    assert made.repairs == ()
    return made.mesh.volume * 1e6


OUTER, INNER = (0.08, 0.06, 0.04), (0.06, 0.04, 0.02)


@pytest.mark.parametrize("grouped", [True, False])
def test_cavities_are_hollow_and_what_lies_in_them_is_not(grouped):
    cavity = box(*INNER, inside_out=True)
    core = box(0.02, 0.02, 0.01)
    hole = box(0.01, 0.01, 0.005, inside_out=True)
    hollow = [box(*OUTER), cavity]
    assert volume(*hollow, grouped=grouped) == pytest.approx(144)
    assert volume(*hollow, core, grouped=grouped) == pytest.approx(148)
    four = volume(*hollow, core, hole, grouped=grouped)
    assert four == pytest.approx(147.5)
    assert closed(*hollow, grouped=grouped).convex == ()


@pytest.mark.parametrize("grouped", [True, False])
@pytest.mark.parametrize(
    "shift",
    [(0.04, 0, 0), (0.04, 0.04, 0), (0.04, 0.04, 0.04), (0.04, 0.01, 0)],
)
def test_bodies_may_touch_in_a_face_an_edge_or_a_corner(shift, grouped):
    cube = [0.04] * 3
    made = volume(box(*cube), box(*cube, at=shift), grouped=grouped)
    assert made == pytest.approx(128)


def test_bodies_that_touch_are_convex_pieces_where_they_are_groups():
    cubes = [box(0.04, 0.04, 0.04, at=(0.04 * k, 0, 0)) for k in range(3)]
    assert len(closed(*cubes, grouped=True).convex) == 3


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(2, 5))
def test_closed_bodies_are_their_union(seed, count):
    rng = np.random.default_rng(seed)
    boxes = [
        box(*rng.uniform(0.01, 0.06, 3), at=rng.uniform(-0.04, 0.04, 3))
        for _ in range(count)
    ]
    united = manifold3d.Manifold.batch_boolean(
        [
            manifold3d.Manifold.hull_points(np.array(one.vertices))
            for one in boxes
        ],
        manifold3d.OpType.Add,
    )
    made = closed(*boxes).mesh.volume
    assert made == pytest.approx(united.volume(), rel=1e-6)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_order_and_place_of_faces_change_nothing(seed):
    rng = np.random.default_rng(seed)
    mesh = trimesh.util.concatenate([box(*OUTER), box(*INNER, inside_out=True)])
    soup = mesh.triangles[rng.permutation(len(mesh.faces))]
    soup = np.stack(
        [np.roll(triangle, rng.integers(3), axis=0) for triangle in soup]
    )
    soup = soup.reshape(-1, 3) + rng.uniform(-1, 1, 3)
    noise = rng.normal(scale=2e-8, size=soup.shape)
    faces = np.arange(len(soup)).reshape(-1, 3)
    loose = trimesh.Trimesh(soup + noise, faces, process=False)
    assert volume(loose) == pytest.approx(144, rel=1e-4)


def ribbon(path, width):
    """A bar of square section along a path in a plane."""
    path = np.array(path, dtype=float)
    along = np.diff(path, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    left = np.stack([-along[:, 1], along[:, 0]], axis=1)
    mitres = [(a + b) / (1 + a @ b) for a, b in pairwise(left)]
    vertices = [
        [*(point + side * width / 2 * mitre), z * width / 2]
        for point, mitre in zip(path, [left[0], *mitres, left[-1]], strict=True)
        for side, z in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    end = 4 * (len(path) - 1)
    quads = [[0, 3, 2, 1], [end, end + 1, end + 2, end + 3]]
    for start in range(0, end, 4):
        for k in range(4):
            a, b = start + k, start + (k + 1) % 4
            quads.append([a, b, b + 4, a + 4])
    return loose(vertices, quads)


def loose(vertices, faces):
    return trimesh.Trimesh(
        vertices, trimesh.geometry.triangulate_quads(faces), process=False
    )


def pipe():
    """A prism over an L, open at both ends; 48 cm³ per 2 cm of length."""
    outline = [(0, 0), (8, 0), (8, 2), (2, 2), (2, 6), (0, 6)]
    return loose(
        [(x / 100, y / 100, z) for z in (0, 0.2) for x, y in outline],
        [[k, (k + 1) % 6, (k + 1) % 6 + 6, k + 6] for k in range(6)],
    )


def ball_of(faces):
    return trimesh.Trimesh(ball().vertices, faces, process=False)


def lidless(*size):
    mesh = box(*size)
    mesh.update_faces(mesh.face_normals[:, 2] < 0.5)
    return mesh


FACES = np.array(ball().faces)
BACK = FACES[:, ::-1]
TURNED = np.random.default_rng(0).random((len(FACES), 1)) < 0.3
BALL = ball().volume * 1e6
PATH = np.array([(0, 0), (10, 0), (10, 6), (5, 6), (5, -4)]) / 100
CUBE = (0.04, 0.04, 0.04)
WALL = loose(
    [[0, y, z] for y, z in ((-3, -2), (3, -2), (3, 2), (-3, 2))]
    * np.array(0.01),
    [[0, 1, 2, 3]],
)
CRUMB = loose([[0.05, 0, 0], [0.06, 0, 0], [0.06, 0.01, 0]], [[0, 1, 2]])

FILES = {
    "inside out, hollow": (
        [box(*OUTER, inside_out=True), box(*INNER)],
        (144, ""),
    ),
    "inside out": ([box(*OUTER, inside_out=True)], (192, "")),
    "faces that are there twice": (
        [ball_of(np.concatenate([FACES, FACES]))],
        (BALL, ""),
    ),
    "faces both ways": (
        [ball_of(np.concatenate([FACES, BACK]))],
        (BALL, "twice"),
    ),
    "faces that look anywhere": (
        [ball_of(np.where(TURNED, BACK, FACES))],
        (BALL, "faces turned over"),
    ),
    "a body inside out beside others": (
        [box(*CUBE), box(*CUBE, at=(0.06, 0, 0), inside_out=True)],
        (128, "inside out"),
    ),
    "many holes": (
        [ball_of(FACES[np.arange(len(FACES)) % 60 != 0])],
        (0.99 * BALL, "21 holes filled (2% of its surface)"),
    ),
    "one large hole": (
        [lidless(0.04, 0.04, 0.12)],
        (192, "a hole filled (7% of its surface)"),
    ),
    "holes that are concave": ([pipe()], (480, "2 holes filled")),
    "a shell that looks outward": (
        [box(*OUTER), box(*INNER)],
        (192, "within other bodies taken as solid (20%)"),
    ),
    "a surface that passes through itself": (
        [ribbon(PATH, 0.02)],
        (None, "passes through itself"),
    ),
    "a bent bar": ([ribbon(PATH[:4], 0.02)], (84, "")),
    "a wall inside": ([box(*OUTER), WALL], (192, "")),
    "a crumb outside": ([box(*OUTER), CRUMB], (192, "20% shorter")),
}


@pytest.mark.parametrize("name", FILES)
def test_what_is_mended_is_said(name):
    meshes, (cubic_centimetres, said) = FILES[name]
    made = closed(*meshes)
    if cubic_centimetres:
        assert made.mesh.volume * 1e6 == pytest.approx(
            cubic_centimetres, rel=0.015 if "many" in name else 1e-6
        )
    if said:
        assert any(said in repair for repair in made.repairs)
    elif "wall" not in name:
        assert made.repairs == ()
    if "concave" in name:
        assert made.mesh.area == pytest.approx(pipe().area + 48e-4)


def test_vertices_are_merged_relative_to_the_size():
    shape = ball()
    rng = np.random.default_rng(0)
    for noise, said in ((2e-8, 0), (2e-6, 1)):
        soup = shape.triangles.reshape(-1, 3)
        soup = soup + rng.uniform(-noise, noise, soup.shape)
        faces = np.arange(len(soup)).reshape(-1, 3)
        for factor in (1, 0.1):
            made = closed(trimesh.Trimesh(soup * factor, faces, process=False))
            assert made.mesh.volume == pytest.approx(
                shape.volume * factor**3, rel=1e-3
            )
            assert len(made.repairs) == said


def sheet(sides):
    """One side of a box, or both sides of it."""
    mesh = box(0.1, 0.1, 0.02)
    mesh.update_faces(mesh.face_normals[:, 0] > 0.5)
    both = [mesh.faces, mesh.faces[:, ::-1]][:sides]
    return trimesh.Trimesh(mesh.vertices, np.concatenate(both))


@pytest.mark.parametrize(
    ("mesh", "reason"),
    [
        (box(0.1, 0.1, 0.03), "filling its holes would make 6"),
        (trimesh.creation.cylinder(0.03, 0.08), "filling its holes would"),
        (sheet(1), "its holes"),
        (sheet(2), "its holes"),
    ],
)
def test_what_is_mostly_hole_or_a_sheet_is_refused(mesh, reason):
    mesh.update_faces(np.abs(mesh.face_normals[:, 2]) < 0.5)
    with pytest.raises(ValueError, match=reason):
        closed(mesh)


def test_repairs_reach_the_log_and_the_summary(tmp_path, caplog):
    lidless(0.04, 0.04, 0.12).export(tmp_path / "tall.stl")
    box(0.04, 0.04, 0.04).export(tmp_path / "whole.stl")
    made = import_meshes(tmp_path)
    (record,) = caplog.records
    assert "tall.stl: a hole filled (7%" in record.getMessage()
    assert list(made.notes) == [f"{tmp_path.name}/tall"]
    assert "1 of them with a remark" in made.summary()
    again = import_meshes(tmp_path)
    assert again.from_cache == 2
    assert again.notes == made.notes


def test_what_is_as_long_as_the_floor_is_welcome(tmp_path):
    assert max(np.ptp(BIN.floor.x), np.ptp(BIN.floor.y)) == LARGEST
    box(0.03, 0.02, LARGEST).export(tmp_path / "rod.stl")
    (model,) = load_meshes(tmp_path)
    assert model.extents.max() == pytest.approx(LARGEST)
