import json
import logging
import os
import re
import signal
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull
from trimesh.creation import icosphere

from xray_drake.scene.meshes import (
    MAX_PIECES,
    MAX_VERTICES,
    LossLimits,
    import_meshes,
    importer,
    load_meshes,
)
from xray_drake.scene.meshes.prepare import prepare_cached
from xray_drake.scene.shapes import cup


def write(path, mesh):
    path.parent.mkdir(parents=True, exist_ok=True)
    mesh.export(path)


def box(*size, at=(0, 0, 0)):
    mesh = trimesh.creation.box(size)
    mesh.apply_translation(at)
    return mesh


def bench():
    return trimesh.util.concatenate(
        [box(0.1, 0.04, 0.01), box(0.01, 0.04, 0.05, at=(0.04, 0, -0.03))]
    )


BENCH = "toys/bench"


@pytest.fixture
def folder(tmp_path):
    folder = tmp_path / "toys"
    moved = bench()
    moved.apply_translation([1.0, 2.0, 3.0])
    write(folder / "bench.obj", moved)
    ball, duck = icosphere(3, 0.03), trimesh.creation.capsule(0.08, 0.02)
    write(folder / "ball" / "textured.obj", ball)
    write(folder / "duck" / "textured.obj", duck)
    return folder


def test_reads_objects_in_metres_about_their_centre_of_mass(folder):
    made = import_meshes(folder)
    assert [m.name for m in made.models] == ["toys/ball", BENCH, "toys/duck"]
    for model in made.models:
        assert model.visual.is_volume
        np.testing.assert_allclose(model.p_OCom, 0, atol=1e-9)
        np.testing.assert_allclose(model.visual.center_mass, 0, atol=1e-6)
        assert model.mass == pytest.approx(300 * model.visual.volume, rel=1e-4)
        assert np.linalg.eigvalsh(model.inertia).min() > 0
        assert all(len(piece) <= MAX_VERTICES for piece in model.pieces)
    losses = made.losses[BENCH]
    assert max(losses.missing, losses.added) < 1e-3
    assert losses.silhouette < 0.03
    assert abs(made.losses["toys/ball"].volume) < 0.15


def nodes():
    """The bench as two nodes of a scene."""
    scene = trimesh.Scene(box(0.1, 0.04, 0.01))
    move = trimesh.transformations.translation_matrix([0.04, 0, -0.03])
    scene.add_geometry(box(0.01, 0.04, 0.05), transform=move)
    return scene


@pytest.mark.parametrize(
    ("made", "suffix"),
    [
        *((bench, s) for s in ("obj", "stl", "ply", "glb", "off")),
        (nodes, "glb"),
    ],
)
def test_every_format_gives_the_same_object(tmp_path, made, suffix):
    millimetres = made().apply_scale(1000)
    write(tmp_path / "in" / f"bench.{suffix}", millimetres)
    (model,) = load_meshes(tmp_path / "in", scale=0.001)
    assert model.name == "in/bench"
    extents = np.sort(model.extents)
    np.testing.assert_allclose(extents, [0.04, 0.06, 0.1], atol=1e-6)
    assert model.mass == pytest.approx(300 * 6e-5, rel=1e-3)
    assert len(model.pieces) == 2


def test_convex_groups_are_the_pieces(tmp_path):
    boxes = [box(0.02, 0.02, 0.03 + k / 100, at=(k / 50, 0, 0)) for k in (0, 1)]
    lines = []
    for k, mesh in enumerate(boxes):
        lines += [f"o convex_{k}"]
        lines += [f"v {x} {y} {z}" for x, y, z in mesh.vertices]
        lines += [f"f {a} {b} {c}" for a, b, c in mesh.faces + 8 * k + 1]
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "steps.obj").write_text("\n".join(lines))
    made = import_meshes(tmp_path / "in")
    (model,) = made.models
    assert [len(piece) for piece in model.pieces] == [8, 8]
    volumes = [np.prod(np.ptp(piece, axis=0)) for piece in model.pieces]
    np.testing.assert_allclose(volumes, [1.2e-5, 1.6e-5], rtol=1e-5)
    assert made.losses["in/steps"].missing < 1e-4
    (hull,) = load_meshes(tmp_path / "in", max_pieces=1)[0].pieces
    assert len(hull) > 8


def test_hollow_objects_stay_hollow(tmp_path):
    (surface,) = cup(0.025, 0.03, 0.06, 0.003, 0.003).surfaces
    write(tmp_path / "in" / "cup.stl", surface)
    made = import_meshes(tmp_path / "in")
    (model,) = made.models
    assert len(model.pieces) <= MAX_PIECES
    assert model.visual.volume == pytest.approx(surface.volume, rel=1e-3)
    ball = icosphere(3, 0.018)  # fits in, above the floor
    height = float(surface.bounds[0, 2] - surface.center_mass[2]) + 0.005
    ball.apply_translation([0, 0, height + 0.018])
    for piece in model.pieces:
        planes = ConvexHull(piece).equations
        outside = ball.vertices @ planes[:, :3].T + planes[:, 3]
        assert (outside.max(axis=1) > 0).all()
    losses = made.losses["in/cup"]
    assert losses.missing < 0.1
    assert losses.added < 0.3


def test_losses_beyond_the_limits_are_rejected(folder):
    made = import_meshes(folder, max_loss=LossLimits(silhouette=0.05))
    assert [model.name for model in made.models] == [BENCH]
    assert len(made.rejected) == 2
    for _, reason in made.rejected:
        assert re.search("silhouette by .* allow more", reason)


def comb(teeth):
    parts = [box(0.2, 0.01, 0.01)]
    for k in range(teeth):
        at = (0.19 * (k / (teeth - 1) - 0.5), 0.03, 0)
        parts.append(box(0.004, 0.06, 0.004, at=at))
    return trimesh.util.concatenate(parts)


ALL_MAY_GO = LossLimits(missing=1, added=1, silhouette=1)


@pytest.mark.parametrize(
    ("teeth", "options", "pieces"),
    [(12, {}, 13), (3, {}, 4), (12, {"max_loss": ALL_MAY_GO}, 8)],
)
def test_what_few_pieces_change_too_much_gets_more(
    tmp_path, teeth, options, pieces
):
    write(tmp_path / "in" / "comb.stl", comb(teeth))
    made = import_meshes(tmp_path / "in", **options)
    assert len(made.models[0].pieces) == pieces
    if pieces == 13:
        assert made.losses["in/comb"].silhouette < 0.05
        with pytest.raises(ValueError, match="allow more pieces"):
            import_meshes(tmp_path / "in", max_pieces=8)


def test_masses_file_is_used(folder):
    masses = {"ball": 0.05, "bench": 0.2}
    (folder / "masses.json").write_text(json.dumps(masses))
    ball, bench, duck = load_meshes(folder, density=500)
    assert ball.mass == pytest.approx(0.05)
    assert bench.mass == pytest.approx(0.2)
    assert duck.mass == pytest.approx(500 * duck.visual.volume, rel=1e-4)
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


def tray():
    mesh = box(0.1, 0.1, 0.03)
    mesh.update_faces(mesh.face_normals[:, 2] < 0.5)
    return mesh


FLAT = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nf 1 2 3\n"

BAD_FILES = {
    "nan.obj": (FLAT.replace("0", "nan", 1), "not finite|read"),
    "empty.obj": ("", "read|faces"),
    "vertices_only.obj": ("v 0 0 0\nv 0 0 0.1\n", "read|faces"),
    "missing_vertex.obj": (FLAT.replace("2 3", "2 9"), "read"),
    "noise.obj": ("\x00\x01 what is this\nf x y z\n", "read|faces"),
    "noise.glb": ("glTF what is this", "read"),
    "noise.stl": ("solid nothing", "read|faces"),
    "noise.ply": ("ply\nformat what 1.0\n", "read|faces"),
    "noise.off": ("OFF\n1 2\n", "read|faces"),
    "flat.obj": (FLAT, "flat"),
    "open.stl": (tray(), "not closed: filling its holes"),
    "large.stl": (
        box(0.6, 0.3, 0.2),
        "longest side is 0.6 m.* give a scale",
    ),
    "small.stl": (box(0.004, 0.002, 0.001), "longest side is 0.004 m"),
    "light.stl": (box(0.05, 0.02, 0.01), "weighs only 1 mg"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_what_cannot_be_used_is_skipped_with_a_reason(tmp_path, caplog, name):
    content, reason = BAD_FILES[name]
    folder = tmp_path / "toys"
    write(folder / "good.stl", box(0.03, 0.04, 0.05))
    if isinstance(content, str):
        (folder / name).write_text(content)
    else:
        write(folder / name, content)
    (folder / "masses.json").write_text('{"light": 1e-6, "good": 0.1}')
    caplog.set_level(logging.WARNING, logger="xray_drake")
    made = import_meshes(folder)
    assert [model.name for model in made.models] == ["toys/good"]
    ((path, why),) = made.rejected
    assert path == folder / name
    assert re.search(reason, why)
    told = caplog.messages[-1]
    assert "\n" not in told
    assert str(path) in told
    assert why in told


def trouble(paths, settings, cache, index):
    """Prepares a mesh; native code does to some of them what it may do."""
    match paths[index].stem:
        case "crash":
            os.kill(os.getpid(), signal.SIGSEGV)
        case "memory":
            os.kill(os.getpid(), signal.SIGKILL)
        case "slow":
            time.sleep(600)
        case "assertion":
            sys.exit("Failure at qhull.cc:1: condition 'x'\n failed.")
        case "fault":
            np.zeros(3) + np.zeros(4)
    return prepare_cached(paths[index], settings, cache)


@pytest.fixture
def boxes(tmp_path):
    """A folder of one box, in the cache already, and what is to be added."""
    folder = tmp_path / "boxes"
    write(folder / "good.stl", box(0.03, 0.04, 0.05))
    import_meshes(folder)
    return folder


@pytest.mark.parametrize(
    ("file", "reason", "cached"),
    [
        ("crash", r"its process was killed by SIGSEGV \(2 times\)", True),
        ("memory", r"killed by SIGKILL, perhaps since memory ran out", False),
        ("slow", r"takes longer than 0\.5 s", True),
        ("assertion", r"SystemExit: Failure at qhull\.cc:1: cond.* failed", 0),
        ("fault", r"ValueError: operands could not be broadcast", False),
    ],
)
def test_native_code_costs_one_file(
    boxes, caplog, monkeypatch, file, reason, cached
):
    monkeypatch.setattr(importer, "_prepare", trouble)
    options = {"time_limit": 0.5} if file == "slow" else {}
    write(boxes / f"{file}.stl", box(0.03, 0.04, 0.06))
    caplog.set_level(logging.DEBUG, logger="xray_drake")
    for from_cache in (1, 1 + cached):
        caplog.clear()
        made = import_meshes(boxes, **options)
        assert len(made.models) == 1
        assert made.from_cache == from_cache
        (told,) = [r for r in caplog.records if r.levelname == "WARNING"]
        assert "\n" not in told.getMessage()
        assert f"{file}.stl" in told.getMessage()
        assert re.search(reason, told.getMessage())
    # The traceback of a fault is in the log.
    fault = file in ("assertion", "fault")
    assert ("in trouble" in caplog.text) == fault


def test_what_took_too_long_has_another_chance_with_more_time(
    boxes, cache, monkeypatch
):
    monkeypatch.setattr(importer, "_prepare", trouble)
    write(boxes / "slow.stl", box(0.03, 0.04, 0.06))
    assert len(import_meshes(boxes, time_limit=0.5).models) == 1
    monkeypatch.undo()
    monkeypatch.setenv("XRAY_DRAKE_CACHE", str(cache.parent))
    assert import_meshes(boxes, time_limit=0.4).from_cache == 2
    assert len(import_meshes(boxes, time_limit=100).models) == 2


def test_what_is_not_used_is_named(folder, caplog):
    """Links, names of masses, files of odd names."""
    (folder / "annex.obj").symlink_to("nothing")
    (folder / "masses.json").write_text('{"bench.obj": 0.4, "stool": 0.2}')
    write(folder / "new\nline.stl", box(0.3, 0.4, 0.6))
    caplog.set_level(logging.WARNING, logger="xray_drake")
    made = import_meshes(folder)
    assert {m.name: m.mass for m in made.models}["toys/bench"] == 0.4
    masses, annex, odd = (record.getMessage() for record in caplog.records)
    assert "'stool'" in masses
    assert "bench" not in masses
    assert "annex.obj: it is a link to nothing" in annex
    assert "new_line.stl: its longest side" in odd


def test_a_daemonic_process_imports_too(folder, monkeypatch):
    """It may not have children: those of gymnasium's vector environments."""
    process = SimpleNamespace(daemon=True)
    monkeypatch.setattr("multiprocessing.current_process", lambda: process)
    assert len(load_meshes(folder)) == 3


def test_no_usable_mesh_is_one_clear_line(tmp_path):
    empty = tmp_path / "empty"
    empty.mkdir()
    for folder in (tmp_path / "nowhere", empty):
        with pytest.raises(ValueError, match=str(folder)) as caught:
            load_meshes(folder)
        assert "\n" not in str(caught.value)
    (empty / "flat.obj").write_text(FLAT)
    with pytest.raises(ValueError, match=r"none of the 1 .* flat\.obj: it is"):
        load_meshes(empty)


@pytest.mark.parametrize(
    "option",
    [
        {"scale": 0.0},
        {"scale": float("nan")},
        {"density": -1.0},
        {"max_pieces": 0},
        {"max_vertices": 3},
        {"workers": 0},
    ],
)
def test_options_without_sense_are_errors(folder, option):
    (name,) = option
    with pytest.raises(ValueError, match=name):
        load_meshes(folder, **option)


def same(a, b):
    return (
        a.name == b.name
        and a.mass == b.mass
        and np.array_equal(a.visual.vertices, b.visual.vertices)
        and all(map(np.array_equal, a.pieces, b.pieces))
    )


def test_the_second_time_comes_from_the_cache(folder, cache, monkeypatch):
    """Reasons are kept too."""
    (folder / "flat.obj").write_text(FLAT)
    first = import_meshes(folder)
    assert first.from_cache == 0
    assert len(list(cache.iterdir())) == len(list(cache.glob("*.npz"))) == 4

    def fail(_, files, **__):
        assert not files, "prepared again"
        return []

    monkeypatch.setattr(importer, "run_jobs", fail)
    (folder / "bench.obj").rename(folder / "stool.obj")
    second = import_meshes(folder)
    assert second.from_cache == 4
    assert second.rejected == first.rejected
    assert same(first.models[0], second.models[0])
    assert [model.name for model in second.models][-1] == "toys/stool"
    for options in ({"max_vertices": 16}, {"scale": 0.5}, {"max_pieces": 3}):
        with pytest.raises(AssertionError, match="prepared again"):
            import_meshes(folder, **options)


def test_a_change_of_the_file_counts(folder):
    import_meshes(folder)
    write(folder / "ball" / "textured.obj", icosphere(2, 0.02))
    made = import_meshes(folder)
    assert made.from_cache == 2
    assert made.models[0].extents.max() < 0.041


def test_damaged_cache_files_are_made_anew(folder, cache):
    first = import_meshes(folder)
    cut, flipped, other = sorted(cache.glob("*.npz"))
    content = bytearray(flipped.read_bytes())
    content[200:260] = bytes(60)
    flipped.write_bytes(content)
    cut.write_bytes(cut.read_bytes()[:1000])
    np.savez(other, wrong=np.zeros(3))
    second = import_meshes(folder)
    assert second.from_cache == 0
    assert all(map(same, first.models, second.models))
    assert import_meshes(folder).from_cache == 3


def test_a_cache_that_cannot_be_written_gives_one_warning(folder, caplog):
    (folder / "file").write_text("not a directory")
    caplog.set_level(logging.WARNING, logger="xray_drake")
    assert len(load_meshes(folder, cache_dir=folder / "file" / "cache")) == 3
    assert len(caplog.messages) == 1
    assert "cannot write" in caplog.messages[0]


def test_a_stopped_import_goes_on(folder):
    class StopError(Exception):
        pass

    def stop(share):
        if share > 0.5:
            raise StopError

    with pytest.raises(StopError):
        import_meshes(folder, progress=stop)
    shares = []
    assert import_meshes(folder, progress=shares.append).from_cache == 2
    assert shares == pytest.approx([1 / 3, 2 / 3, 1])


def test_workers_make_the_same_objects(folder, tmp_path):
    alone = load_meshes(folder)
    several = load_meshes(folder, workers=2, cache_dir=tmp_path / "other")
    assert all(map(same, alone, several))
