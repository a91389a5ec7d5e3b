"""What solid the triangles of a file are."""

from itertools import pairwise

import manifold3d
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from xray_drake.scene.meshes import import_meshes, load_meshes
from xray_drake.scene.meshes.closing import closed_solid
from xray_drake.scene.meshes.prepare import LARGEST
from xray_drake.scene.plant import BIN_FLOOR_X, BIN_FLOOR_Y


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


def test_a_file_inside_out_is_turned():
    hollow = [box(*OUTER, inside_out=True), box(*INNER)]
    assert volume(*hollow) == pytest.approx(144)
    assert volume(box(*OUTER, inside_out=True)) == pytest.approx(192)


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


def test_faces_that_are_there_twice_count_once():
    shape = ball()
    twice = np.concatenate([shape.faces, shape.faces])
    mesh = trimesh.Trimesh(shape.vertices, twice, process=False)
    assert volume(mesh) == pytest.approx(shape.volume * 1e6)
    both = np.concatenate([shape.faces, shape.faces[:, ::-1]])
    made = closed(trimesh.Trimesh(shape.vertices, both, process=False))
    assert made.mesh.volume == pytest.approx(shape.volume)
    assert "twice" in made.repairs[0]


def test_faces_that_look_anywhere_are_turned_and_that_is_said():
    shape = ball()
    flip = np.random.default_rng(0).random(len(shape.faces)) < 0.3
    faces = np.where(flip[:, None], shape.faces[:, ::-1], shape.faces)
    made = closed(trimesh.Trimesh(shape.vertices, faces, process=False))
    assert made.mesh.volume == pytest.approx(shape.volume)
    assert "faces turned over" in made.repairs[0]


def test_a_body_inside_out_beside_others_is_turned_and_that_is_said():
    cube = [0.04] * 3
    made = closed(box(*cube), box(*cube, at=(0.06, 0, 0), inside_out=True))
    assert made.mesh.volume == pytest.approx(1.28e-4)
    assert "inside out" in made.repairs[0]


def test_holes_are_filled_and_that_is_said():
    shape = ball()
    few = shape.copy()
    few.update_faces(np.arange(len(shape.faces)) % 60 != 0)
    made = closed(few)
    assert made.mesh.volume == pytest.approx(shape.volume, rel=0.02)
    assert "21 holes filled (2% of its surface)" in made.repairs
    tall = box(0.04, 0.04, 0.12)
    tall.update_faces(tall.face_normals[:, 2] < 0.5)
    made = closed(tall)
    assert made.mesh.volume == pytest.approx(1.92e-4)
    assert "a hole filled (7% of its surface)" in made.repairs


def test_a_shell_that_looks_outward_is_filled_and_that_is_said():
    made = closed(box(*OUTER), box(*INNER))
    assert made.mesh.volume == pytest.approx(1.92e-4)
    assert "within other bodies taken as solid (20%)" in made.repairs[0]


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
    faces = [
        [0, 2, 1],
        [0, 3, 2],
        [end, end + 1, end + 2],
        [end, end + 2, end + 3],
    ]
    for start in range(0, end, 4):
        for k in range(4):
            a, b = start + k, start + (k + 1) % 4
            faces += [[a, b, b + 4], [a, b + 4, a + 4]]
    return trimesh.Trimesh(vertices, faces, process=False)


def test_a_surface_that_passes_through_itself_is_named():
    path = np.array([(0, 0), (10, 0), (10, 6), (5, 6), (5, -4)]) / 100
    made = closed(ribbon(path, 0.02))
    assert "passes through itself" in made.repairs[0]
    assert closed(ribbon(path[:4], 0.02)).repairs == ()


def test_a_hole_that_is_concave_is_filled_as_it_is():
    outline = [(0, 0), (8, 0), (8, 2), (2, 2), (2, 6), (0, 6)]
    prism = trimesh.Trimesh(
        [(x / 100, y / 100, z) for z in (0, 0.2) for x, y in outline],
        [
            face
            for k in range(6)
            for a, b in [(k, (k + 1) % 6)]
            for face in ((a, b, b + 6), (a, b + 6, a + 6))
        ],
        process=False,
    )
    made = closed(prism)
    assert made.mesh.volume == pytest.approx(24e-4 * 0.2)
    assert made.mesh.area == pytest.approx(prism.area + 2 * 24e-4)


def test_walls_inside_and_crumbs_outside_enclose_nothing():
    wall = trimesh.Trimesh(
        [
            [0, -0.03, -0.02],
            [0, 0.03, -0.02],
            [0, 0.03, 0.02],
            [0, -0.03, 0.02],
        ],
        [[0, 1, 2], [0, 2, 3]],
        process=False,
    )
    made = closed(box(*OUTER), wall)
    assert made.mesh.volume == pytest.approx(1.92e-4)
    crumb = trimesh.Trimesh(
        [[0.05, 0, 0], [0.06, 0, 0], [0.06, 0.01, 0]], [[0, 1, 2]]
    )
    made = closed(box(*OUTER), crumb)
    assert made.mesh.volume == pytest.approx(1.92e-4)
    assert "20% shorter" in made.repairs[-1]


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


@pytest.mark.parametrize(
    ("mesh", "reason"),
    [
        (box(0.1, 0.1, 0.03), "filling its holes would make 6"),
        (trimesh.creation.cylinder(0.03, 0.08), "filling its holes would"),
    ],
)
def test_what_is_mostly_hole_is_refused(mesh, reason):
    mesh.update_faces(np.abs(mesh.face_normals[:, 2]) < 0.5)
    with pytest.raises(ValueError, match=reason):
        closed(mesh)


def test_a_sheet_encloses_nothing():
    sheet = trimesh.creation.box((0.1, 0.1, 0.02))
    sheet.update_faces(sheet.face_normals[:, 0] > 0.5)
    both = trimesh.Trimesh(
        sheet.vertices, np.concatenate([sheet.faces, sheet.faces[:, ::-1]])
    )
    for mesh in (sheet, both):
        with pytest.raises(ValueError, match=r"encloses nothing|its holes"):
            closed(mesh)


def test_repairs_reach_the_log_and_the_summary(tmp_path, caplog):
    tall = box(0.04, 0.04, 0.12)
    tall.update_faces(tall.face_normals[:, 2] < 0.5)
    tall.export(tmp_path / "tall.stl")
    box(0.04, 0.04, 0.04).export(tmp_path / "whole.stl")
    made = import_meshes(tmp_path, cache_dir=tmp_path / "cache")
    (record,) = caplog.records
    assert "tall.stl: a hole filled (7%" in record.getMessage()
    assert list(made.notes) == [f"{tmp_path.name}/tall"]
    assert "1 of them with a remark" in made.summary()
    again = import_meshes(tmp_path, cache_dir=tmp_path / "cache")
    assert again.from_cache == 2
    assert again.notes == made.notes


def test_what_is_as_long_as_the_floor_is_welcome(tmp_path):
    longer = max(
        BIN_FLOOR_X[1] - BIN_FLOOR_X[0], BIN_FLOOR_Y[1] - BIN_FLOOR_Y[0]
    )
    assert longer == LARGEST
    box(0.03, 0.02, 0.5).export(tmp_path / "rod.stl")
    (model,) = load_meshes(tmp_path, cache_dir=tmp_path / "cache")
    assert model.extents.max() == pytest.approx(0.5)
