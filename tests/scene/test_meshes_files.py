import os
from dataclasses import replace

import pytest
from pydrake.multibody.parsing import Parser
from pydrake.systems.framework import DiagramBuilder

from xray_drake.scene.meshes.files import find_meshes, masses_of
from xray_drake.scene.meshes.formats import side_files
from xray_drake.scene.plant import add_object, add_plant, default_plant_config
from xray_drake.scene.sdf import write_sdf
from xray_drake.scene.targets import target_model


def touch(folder, *names):
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    return folder


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        (["b.stl", "a.obj"], {"a": "a.obj", "b": "b.stl"}),
        (["a.off", "a.PLY", "a.stl"], {"a": "a.PLY"}),
        (["a.glb", "a.obj", "a.ply"], {"a": "a.obj"}),
        (["duck/textured.obj"], {"duck": "duck/textured.obj"}),
        (["duck/Model.glb"], {"duck": "duck/Model.glb"}),
        (["duck/left.obj"], {"duck/left": "duck/left.obj"}),
        (
            ["duck/16k/textured.obj", "duck/16k/nontextured.stl"],
            {"duck/16k": "duck/16k/textured.obj"},
        ),
        (
            ["duck/textured.obj", "duck/egg.obj"],
            {
                "duck/egg": "duck/egg.obj",
                "duck/textured": "duck/textured.obj",
            },
        ),
        (
            ["duck.obj", "duck/textured.obj"],
            {"duck": "duck.obj", "duck/textured": "duck/textured.obj"},
        ),
        (["textured.obj"], {"textured": "textured.obj"}),
        (
            ["duck/visual.obj", "duck/collision.obj", "duck/coacd_0.obj"],
            {"duck": "duck/visual.obj"},
        ),
        (["a.obj", "a_collision.obj", "a_vhacd.obj"], {"a": "a.obj"}),
        (["a_collision.obj"], {"a_collision": "a_collision.obj"}),
        ([".hidden/a.obj", "._a.obj", "a.txt", "b.obj"], {"b": "b.obj"}),
    ],
)
def test_one_mesh_is_found_per_object(tmp_path, files, expected):
    folder = touch(tmp_path / "toys", *files)
    found = find_meshes(folder)
    assert {
        file.name: file.path.relative_to(folder).as_posix() for file in found
    } == {f"toys/{name}": path for name, path in expected.items()}
    assert [file.path for file in found] == sorted(file.path for file in found)


def found_in(folder):
    return {
        file.name: file.problem or file.path for file in find_meshes(folder)
    }


def test_a_link_to_a_folder_is_the_folder_and_each_is_looked_at_once(tmp_path):
    touch(tmp_path, "far/mug.obj", "far/deep/cup.obj", "set/own/bowl.obj")
    folder = tmp_path / "set"
    for name, target in {
        "ycb": "../far",
        "again": "own",  # found without the link
        "own/loop": "..",
        "ring": "ring",
        "cup.obj": "../far/deep/cup.obj",
    }.items():
        (folder / name).symlink_to(target)
    assert found_in(folder) == {
        "set/own/bowl": folder / "own/bowl.obj",
        "set/ycb/mug": folder / "ycb/mug.obj",
        "set/ycb/deep/cup": folder / "ycb/deep/cup.obj",
        "set/cup": folder / "cup.obj",
        "set/ring": "it is a link to nothing (ring)",
    }


def test_what_cannot_be_read_is_named(tmp_path, monkeypatch):
    folder = touch(tmp_path / "set", "a.obj", "README", "note.txt")
    (folder / "annex.obj").symlink_to(".git/annex/objects/x")
    (folder / "ycb").symlink_to("/data/ycb")
    (folder / "lost.txt").symlink_to("nothing")
    (folder / "text").write_text("../set")  # as Git leaves it without links
    os.mkfifo(folder / "pipe.obj")
    locked = touch(folder / "locked", "b.obj")
    listed = os.listdir

    def refuse(path):  # root may list all
        if path == locked:
            raise PermissionError(13, "Permission denied")
        return listed(path)

    monkeypatch.setattr(os, "listdir", refuse)
    assert found_in(folder) == {
        "set/a": folder / "a.obj",
        "set/annex": "it is a link to nothing (.git/annex/objects/x)",
        "set/ycb": "it is a link to nothing (/data/ycb)",
        "set/text": "it is a link written as a text (../set)",
        "set/pipe": "it is not a regular file",
        "set/locked": "cannot be listed (Permission denied)",
    }


ODD_NAMES = [
    "new\nline",
    "new_line",
    "tab\t",
    "sco::ped",
    "a b'\"<&>#?%20",
    "-dash:colon",
    "mugé日",
    os.fsdecode(b"latin-\xe9"),
]


def test_any_name_of_a_file_is_one_that_drake_takes(tmp_path):
    touch(tmp_path / "in", *(f"{name}.obj" for name in ODD_NAMES))
    names = list(found_in(tmp_path / "in"))
    assert len(names) == len(ODD_NAMES)
    plant, _ = add_plant(DiagramBuilder(), default_plant_config())
    for name in names:
        model = replace(target_model("lid"), name=name)
        add_object(plant, model)
        path = write_sdf(replace(model, name=f"{name}_"), tmp_path / "sdf")
        assert path.parent == tmp_path / "sdf"
        Parser(plant).AddModels(str(path))
        name.encode()
    plant.Finalize()


def test_a_mass_may_be_named_by_the_file(tmp_path):
    folder = touch(
        tmp_path / "in",
        *("mug.obj", "mug.stl", "duck/textured.obj", "a/cup.ply", "d.obj.ply"),
    )
    masses = {
        "mug.obj": 1.0,
        ".\\duck\\textured.obj": 2.0,
        "in/a/cup": 3.0,
        "d.obj": 4.0,
        "mugg.obj": 5.0,
        "b/cup": 6.0,
    }
    found = find_meshes(folder)
    mass, idle = masses_of(found, masses)
    by_name = dict(zip((file.name for file in found), mass, strict=True))
    assert by_name == {
        "in/mug": 1.0,
        "in/duck": 2.0,
        "in/a/cup": 3.0,
        "in/d.obj": 4.0,
    }
    assert idle == ["mugg.obj", "b/cup"]


@pytest.mark.parametrize(("mass", "idle"), [(1.0, []), (2.0, ["mug.obj"])])
def test_a_name_that_contradicts_a_surer_one_is_idle(tmp_path, mass, idle):
    found = find_meshes(touch(tmp_path, "mug.obj"))
    assert masses_of(found, {"mug": 1.0, "mug.obj": mass}) == ([1.0], idle)


def test_directories_do_not_count_as_files(tmp_path):
    (tmp_path / "odd.obj").mkdir()
    with pytest.raises(ValueError, match="looks for OBJ, GLB, PLY, STL, OFF"):
        find_meshes(tmp_path)


def test_materials_and_textures_belong_to_an_obj_file(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text("mtllib a b.mtl\nmtllib missing.mtl\nv 0 0 0\n")
    (tmp_path / "a b.mtl").write_text(
        "newmtl m\nKd 1 1 1\nmap_Kd -s 1 1 wood.png\nmap_Bump gone.png\n"
    )
    (tmp_path / "wood.png").touch()
    assert [side.name for side in side_files(path)] == ["a b.mtl", "wood.png"]
    scan = tmp_path / "scan.ply"
    scan.write_text(
        "ply\nformat ascii 1.0\ncomment TextureFile wood.png\nend_header\n"
    )
    assert [side.name for side in side_files(scan)] == ["wood.png"]
