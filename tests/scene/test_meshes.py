import json
import logging
import re

import numpy as np
import pytest
import trimesh

from xray_drake.scene.meshes import (
    COLLISION_VERTICES,
    load_meshes,
    simplified_hull,
)


def write(path, mesh):
    path.parent.mkdir(parents=True, exist_ok=True)
    mesh.export(path)


@pytest.fixture
def folder(tmp_path):
    folder = tmp_path / "toys"
    bench = trimesh.util.concatenate(
        [
            trimesh.creation.box((0.1, 0.04, 0.01)),
            trimesh.creation.box(
                (0.01, 0.04, 0.05),
                trimesh.transformations.translation_matrix([0.04, 0, -0.03]),
            ),
        ]
    )
    bench.apply_translation([1.0, 2.0, 3.0])
    write(folder / "bench.obj", bench)
    write(folder / "ball" / "textured.obj", trimesh.creation.icosphere(3, 0.03))
    write(
        folder / "duck" / "textured.obj", trimesh.creation.capsule(0.08, 0.02)
    )
    return folder


def test_reads_hulls_in_metres_about_their_centre_of_mass(folder):
    models = load_meshes(folder)
    assert [model.name for model in models] == [
        "toys/ball/textured",
        "toys/bench",
        "toys/duck/textured",
    ]
    bench = models[1]
    assert bench.visual.is_convex
    np.testing.assert_allclose(bench.extents, [0.1, 0.04, 0.06], atol=1e-6)
    for model in models:
        assert model.visual.is_volume
        np.testing.assert_allclose(model.p_OCom, 0, atol=1e-9)
        np.testing.assert_allclose(model.visual.center_mass, 0, atol=1e-9)
        assert model.mass == pytest.approx(300 * model.visual.volume)
        assert np.linalg.eigvalsh(model.inertia).min() > 0


def test_collision_hull_has_few_vertices_and_lies_inside(folder):
    for model in load_meshes(folder):
        (piece,) = model.pieces
        hull = trimesh.Trimesh(piece).convex_hull
        assert len(piece) <= COLLISION_VERTICES == 12
        assert len(hull.vertices) == len(piece)
        planes = model.visual.face_normals
        offsets = np.sum(planes * model.visual.triangles[:, 0], axis=1)
        assert (piece @ planes.T - offsets).max() < 1e-6
        assert 0.5 < hull.volume / model.visual.volume <= 1 + 1e-6
    (finer,) = load_meshes(folder, collision_vertices=40)[0].pieces
    assert len(finer) == 40


def test_simplified_hull_of_a_box_is_the_box():
    corners = trimesh.creation.box((0.1, 0.05, 0.02)).vertices
    mesh = trimesh.creation.box((0.1, 0.05, 0.02)).subdivide().subdivide()
    chosen = simplified_hull(np.asarray(mesh.vertices), 12)
    assert len(chosen) == 8, chosen
    assert {tuple(p) for p in chosen} == {tuple(p) for p in corners}


def test_masses_file_is_used(folder):
    masses = {"ball": 0.05, "bench": 0.2}
    (folder / "masses.json").write_text(json.dumps(masses))
    ball, bench, duck = load_meshes(folder, density=500)
    assert ball.mass == pytest.approx(0.05)
    assert bench.mass == pytest.approx(0.2)
    assert duck.mass == pytest.approx(500 * duck.visual.volume)
    solid_ball = 0.4 * 0.05 * 0.03**2
    np.testing.assert_allclose(
        ball.inertia, solid_ball * np.eye(3), atol=0.02 * solid_ball
    )


@pytest.mark.parametrize(
    "text", ["not json", "[1]", '{"a": -1}', '{"a": "1"}', '{"a": NaN}']
)
def test_bad_masses_file_is_an_error(folder, text):
    (folder / "masses.json").write_text(text)
    with pytest.raises(ValueError, match=r"masses\.json"):
        load_meshes(folder)


BAD_FILES = {
    "nan": ("v nan 0 0\nv 0.1 0 0\nv 0 0.1 0\nf 1 2 3\n", "not finite"),
    "empty": ("", "read|faces"),
    "vertices_only": ("v 0 0 0\nv 0 0 0.1\n", "read|faces"),
    "missing_vertex": ("v 0 0 0\nv 0.1 0 0\nf 1 2 9\n", "read"),
    "noise": ("\x00\x01 what is this\nf x y z\n", "read|faces"),
    "flat": ("v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nf 1 2 3\n", "flat"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_broken_files_are_skipped_with_a_reason(folder, caplog, name):
    text, reason = BAD_FILES[name]
    (folder / f"{name}.obj").write_text(text)
    check_skipped(folder, caplog, f"{name}.obj", reason)


@pytest.mark.parametrize(
    ("size", "mass", "reason"),
    [
        (0.3, 0.1, "longest side is 0.3 m"),
        (0.004, 0.1, "longest side is 0.004 m"),
        (0.05, 1e-6, "weighs only 1 mg"),
    ],
)
def test_what_is_too_large_small_or_light_is_skipped(
    folder, caplog, size, mass, reason
):
    write(folder / "odd.obj", trimesh.creation.box((size, size / 2, size / 3)))
    (folder / "masses.json").write_text(json.dumps({"odd": mass}))
    check_skipped(folder, caplog, "odd.obj", reason)


def check_skipped(folder, caplog, file, reason):
    with caplog.at_level(logging.WARNING, logger="xray_drake"):
        assert len(load_meshes(folder)) == 3
    (record,) = caplog.records
    assert file in record.getMessage()
    assert "\n" not in record.getMessage()
    assert re.search(reason, record.getMessage())


def test_no_usable_mesh_is_one_clear_line(tmp_path):
    for folder in (tmp_path / "nowhere", tmp_path):
        with pytest.raises(ValueError, match=str(folder)) as caught:
            load_meshes(folder)
        assert "\n" not in str(caught.value)
    (tmp_path / "flat.obj").write_text(BAD_FILES["flat"][0])
    with pytest.raises(ValueError, match="none of the 1 OBJ files"):
        load_meshes(tmp_path)
