import pytest

from xray_drake.scene.meshes.files import find_meshes
from xray_drake.scene.meshes.formats import side_files


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
