from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.systems.sensors import CameraConfig

from xray_drake.cell.bin import Bin
from xray_drake.cell.cameras import pinhole_camera
from xray_drake.cell.cell import Cell, dump_cell, load_cell, parse_cell
from xray_drake.cell.names import cell_names
from xray_drake.station.scenario import (
    ScenarioError,
    dump_scenario,
    load_scenario,
    parse_scenario,
)
from xray_drake.trees import ConfigurationError

LARGE = "bin: {length: 0.6, width: 0.4}\n"


@pytest.mark.parametrize("name", cell_names())
def test_cells_of_the_package(name: str) -> None:
    cell = load_cell(name)
    assert cell.name == name
    assert cell.looks_nominal() == (name == "nominal")
    assert (cell == Cell()) == (name == "nominal")
    assert parse_cell(dump_cell(cell), "again") == cell


@settings(max_examples=30)
@given(
    length=st.floats(0.2, 0.6),
    size=st.tuples(st.integers(320, 1920), st.floats(0.6, 1.2)),
    home=st.sampled_from([[], [0.1, 0.2, 0.3]]),
)
def test_what_is_written_is_read_again(
    length: float, size: tuple[int, float], home: list[float]
) -> None:
    text = f"overhead: {{width: {size[0]}, height: {int(size[0] * size[1])}}}"
    cell = replace(parse_cell(text, "cell"), bin=Bin(length=length), home=home)
    assert parse_cell(dump_cell(cell), "again") == cell
    cell.overhead.focal = CameraConfig.FocalLength(x=0.9 * size[0], y=size[0])
    assert parse_cell(dump_cell(cell), "again") == cell


def test_the_lens_follows_the_size() -> None:
    nominal = pinhole_camera(Cell().overhead)
    for size in ({"width": 1024, "height": 768}, {"width": 1024}):
        text = f"overhead: {size}"
        camera = pinhole_camera(parse_cell(text, "cell").overhead)
        wide = nominal.resized(1024, 768)
        assert camera.intrinsics[0, 0] == wide.intrinsics[0, 0]
        assert camera.intrinsics[0, 2] == pytest.approx(
            wide.intrinsics[0, 2], abs=1e-9
        )
    kept = "overhead: {width: 640, height: 480, focal: {x: 600, y: 600}}"
    assert pinhole_camera(parse_cell(kept, "cell").overhead).intrinsics[
        0, 0
    ] == pytest.approx(600)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("bin: {lenght: 0.5}", "unknown key bin.lenght; did you mean"),
        ("bin: {width: -1}", "bin.width is -1: it must be"),
        ("bin: {wall_slope: 60}", "bin.wall_slope is 60"),
        ("tote: {position: [0.3, 0, 0]}", "the tote stands in the bin"),
        ("overhead: {X_PB: {translation: [0, 0, -1]}}", "does not look at"),
        ("overhead: {X_PB: {translation: [5, 0, 0.8]}}", "does not look at"),
        ("overhead: {z_near: 2.5}", "out of the sensor's range"),
        ("overhead: {z_near: 4.0}", "overhead.z_near is 4.0: it must be"),
        ("overhead: {name: ''}", "overhead.name is empty"),
        ("overhead: {renderer_class: RenderEngineGl}", "only RenderEngineVtk"),
        ("cameras: {side: {width: 0}}", "cameras.side.width is 0"),
        ("cameras: {overhead: {}}", "has the name of the overhead camera"),
        ("bin: {length: 3, width: 3}", "% of the bin's floor: move it"),
        ("bin: {wall_height: 0.9}", "put the camera above them"),
        ("tote: {position: [0.8, 0, 0.1]}", "z must be 0"),
        (
            "cameras: {hand: {X_PB: {base_frame: gripper_base}}}",
            "cameras.hand: camera 'hand' is fixed to 'gripper_base'",
        ),
        ("cameras: 3", "cameras is 3: it must be keys and values"),
        ("home: [0, 1]", "home is [0, 1]: it must be 0 or 3 numbers"),
        ("- 1", "its top level must be keys and values"),
    ],
)
def test_what_cannot_be_is_said_in_a_line(text: str, said: str) -> None:
    with pytest.raises(ConfigurationError) as error:
        parse_cell(text, "my.yaml")
    assert str(error.value).startswith("my.yaml: ")
    assert said in str(error.value) and "\n" not in str(error.value)


def test_a_scenario_names_its_cell(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text(f"name: mine\n{LARGE}")
    for cell in ("mine.yaml", f"{{name: mine, {LARGE.strip()}}}"):
        path = tmp_path / "scenario.yaml"
        path.write_text(f"cell: {cell}\n")
        scenario = load_scenario(path)
        assert scenario.cell.name == "mine"
        assert scenario.cell.bin == Bin(length=0.6)
        assert parse_scenario(dump_scenario(scenario), "again") == scenario
    with pytest.raises(ScenarioError, match="no cell 'other': choose one of"):
        parse_scenario("cell: other", "s")


def test_inference_is_geometric_where_no_network_has_been() -> None:
    usual = {
        "": "learned",
        f"cell: {{{LARGE.strip()}}}": "geometric",
        "cell: {overhead: {width: 640, height: 480}}": "geometric",
        "cell: {home: [0, 0.5, 0.4]}": "learned",
        f"cell: {{{LARGE.strip()}}}\nperception: {{occupancy: learned}}": (
            "learned"
        ),
    }
    usual["cell: large\nperception: {weights: w}"] = "learned"
    for text, occupancy in usual.items():
        scenario = parse_scenario(text, "s", searched=False)
        assert scenario.perception.occupancy == occupancy, text
        again = parse_scenario(dump_scenario(scenario), "a", searched=False)
        assert again == scenario


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "scene: {target: none.stl}",
            "scene.target is 'none.stl': there is no",
        ),
        ("scene: {heap_file: none}", "scene.heap_file is 'none': there is no"),
        ("cell: {directives: none}", "cell.directives is 'none': there is no"),
        ("scene: {target: 1x1mm}", "scene.target is '1x1mm': choose one of"),
        ("scene: {target: 1x2x900mm}", "from 3 to 300 mm"),
        ("scene: {heap_file: a, target: lid}", "target is given beside"),
        (
            "scene: {target_color: [0, 0, 1]}\nperception: {detector: hsv}",
            "finds what is red",
        ),
        (
            "perception: {geometric: {floor: [0, 1, 0, 1]}}",
            "perception.geometric.floor is now the cell's bin",
        ),
    ],
)
def test_what_a_heap_is_made_of_is_looked_at_first(
    text: str, said: str
) -> None:
    with pytest.raises(ScenarioError) as error:
        parse_scenario(text, "s")
    assert said in str(error.value) and "\n" not in str(error.value)


def test_records_are_read_where_their_files_are_not() -> None:
    text = "scene: {target: none.stl}\ncell: {directives: none}"
    read = parse_scenario(text, "record", searched=False)
    assert read.scene.target == "none.stl"


def test_cameras_of_version_0_1_are_read_as_they_were() -> None:
    old = parse_scenario("camera: {width: 640, height: 480}", "s")
    lens = pinhole_camera(old.camera).intrinsics
    nominal = pinhole_camera(Cell().overhead).intrinsics
    np.testing.assert_array_equal(lens, nominal)
    assert old.perception.occupancy == "learned"
    assert parse_scenario(dump_scenario(old), "again") == old
    for text, said in (
        ("camera: 3", "cell.overhead is 3"),
        ("cell: nominal\ncamera: {width: 640}", "unknown key camera"),
    ):
        with pytest.raises(ScenarioError, match=said):
            parse_scenario(text, "s")
