from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.nominal import BIN
from xray_drake.cell.bin import Bin
from xray_drake.scene.drop import release_heap
from xray_drake.scene.heap import (
    Heap,
)
from xray_drake.scene.heap_file import AT_REST, load_heap_file, save_heap
from xray_drake.scene.library import make_object
from xray_drake.scene.targets import make_target
from xray_drake.station.objects import make_heap
from xray_drake.station.scenario import Scenario, ScenarioError
from xray_drake.trees import ConfigurationError

BLOCK = """- name: {name}
  mesh: block.stl
  mass: 0.05
  X_WO: {{translation: [{x}, 0, {z}], rotation: !Rpy {{deg: [0, 0, {yaw}]}}}}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A mesh whose frame is at a corner, 10 mm beside it."""
    folder = tmp_path_factory.mktemp("heap")
    block = trimesh.creation.box([0.06, 0.04, 0.02])
    block.apply_translation([0.04, 0.03, 0.02])
    block.export(folder / "block.stl")
    return folder


def heap_file(folder: Path, text: str) -> Path:
    path = folder / "heap.yaml"
    path.write_text(text)
    return path


def pile(release: str) -> str:
    return (
        f"release: {release}\ntarget: red\nobjects:\n"
        + BLOCK.format(name="red", x=-0.04, z=0.0, yaw=0)
        + BLOCK.format(name="other", x=-0.02, z=0.06, yaw=0)
    )


FALLING = pile("as_is")
LID = "target: a\nobjects:\n- {{name: a, object: lid, X_WB: {}}}"


def test_a_pose_is_that_of_the_meshs_frame(folder: Path) -> None:
    text = "target: lid\nobjects:\n" + BLOCK.format(
        name="it", x=0.1, z=0.5, yaw=90
    )
    text += "- {name: lid, object: lid, X_WO: {translation: [0, 0, 0.3]}}\n"
    file = load_heap_file(heap_file(folder, text))
    np.testing.assert_allclose(
        file.poses["it"][:3, 3], [0.1 - 0.03, 0.04, 0.52], atol=1e-9
    )
    np.testing.assert_allclose(file.poses["lid"][:3, 3], [0, 0, 0.3])
    assert file.target.name == "lid"
    assert [model.mass for model in file.objects] == [0.05]


@pytest.mark.parametrize("release", ["as_is", "in_turn"])
def test_objects_come_to_rest(folder: Path, release: str) -> None:
    file = load_heap_file(heap_file(folder, pile(release)))
    # Its frame is turned to how it lies, and lies where the mesh does.
    low, high = file.target.visual.bounds
    np.testing.assert_allclose(low, -high, atol=1e-9)
    corners = trimesh.transform_points(
        file.target.visual.vertices, file.poses["red"]
    )
    np.testing.assert_allclose(corners.min(axis=0), [-0.03, 0.01, 0.01])
    heap = release_heap(
        file.target,
        file.objects,
        file.poses,
        release=file.release,
        order=file.order,
    )
    tops = [heap.poses[name][2, 3] for name in ("red", "other")]
    np.testing.assert_allclose(tops, [0.01, 0.03], atol=0.001)


def test_a_heap_comes_back_equal(folder: Path, tmp_path: Path) -> None:
    file = load_heap_file(heap_file(folder, pile("as_is")))
    copy = replace(make_object("bottle_000"), name="bottle_000_copy_1")
    packaged = make_object("bottle_002_packaged")
    for target in (file.target, make_target("70x40x12mm"), make_target("mug")):
        objects = (*file.objects, copy, packaged)
        rng = np.random.default_rng(0)
        poses = {
            model.name: trimesh.transformations.random_rotation_matrix(
                rng.random(3)
            )
            for model in (target, *objects)
        }
        heap = Heap(target, objects, poses, 0, len(objects), 1, 0.0)
        save_heap(heap, tmp_path / "saved.yaml", BIN)
        saved = load_heap_file(tmp_path / "saved.yaml")
        assert saved.release == AT_REST
        again = saved.heap()
        for one, other in zip(heap.models, again.models, strict=True):
            assert (one.name, one.mass) == (other.name, other.mass)
            assert (one.color, one.friction) == (other.color, other.friction)
            for a, b in (
                (one.visual.vertices, other.visual.vertices),
                (heap.poses[one.name], again.poses[one.name]),
                (np.concatenate(one.pieces), np.concatenate(other.pieces)),
            ):
                np.testing.assert_array_equal(a, b)
            np.testing.assert_allclose(one.inertia, other.inertia, rtol=1e-12)


def test_what_no_file_can_name_is_refused(tiny_heap: Heap) -> None:
    with pytest.raises(ValueError, match="neither from the library nor"):
        save_heap(tiny_heap, Path("never.yaml"), BIN)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("target: red", "the target is 'red', which is none of the 0"),
        (pile("soon"), "release is 'soon': choose one of"),
        (FALLING.replace("block", "none"), "objects[0]: "),
        (FALLING.replace("other", "red"), "objects[1]: a second 'red'"),
        (FALLING.replace("target: red", "target: blue"), "'blue'"),
        (FALLING.replace("X_WO", "pose"), "unknown key objects[0].pose"),
        (FALLING.replace("0.05", "-1"), "mass is -1"),
        (
            FALLING.replace("mesh: block.stl", "object: spaceship_000"),
            "no family is called 'spaceship'",
        ),
        (FALLING.replace("mesh: block.stl", "scale: 1"), "give either"),
        ("[1]", "its top level must be"),
        (FALLING.replace("!Rpy {deg: [0, 0, 0]}", "!Uniform {}"), "drawn"),
        (FALLING.replace("rotation:", "base_frame: a, rotation:"), "'a'"),
        (FALLING.replace("name: other", "name: tote"), "part of the cell"),
        (FALLING.replace("name: other", "name: a::b"), "no such name"),
        (LID.format("[[1, 2], [3]]"), "X_WB is no pose"),
        (LID.format(np.diag([2, 1, 1, 1]).tolist()), "its rotation is none"),
    ],
)
def test_what_is_no_heap(folder: Path, text: str, said: str) -> None:
    path = heap_file(folder, text)
    with pytest.raises(ConfigurationError) as error:
        load_heap_file(path)
    assert said in str(error.value) and str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_the_bin_must_hold_the_workspace(folder: Path) -> None:
    path = heap_file(folder, "workspace: [0.3, 0.45]\n" + pile("at_rest"))
    scenario = Scenario()
    scenario.scene.heap_file = str(path)
    with pytest.raises(ScenarioError, match="give a larger one in the cell"):
        scenario.cell.bin = Bin(length=0.4, width=0.4)
        make_heap(scenario)
    scenario.cell.bin = Bin(length=0.3, width=0.45)
    assert make_heap(scenario).target.name == "red"
    scenario.cell.bin = Bin(length=0.45, width=0.3)
    with pytest.raises(ScenarioError, match="give a larger one in the cell"):
        make_heap(scenario)
