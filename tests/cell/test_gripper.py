"""What a gripper can do: read from YAML, changed in a cell, refused."""

import shutil
from dataclasses import fields
from pathlib import Path

import pytest

from xray_drake.cell.cell import Cell, dump_cell, load_cell, parse_cell
from xray_drake.cell.gripper import (
    CellGripper,
    GripperSpec,
    gripper_names,
    load_gripper,
)
from xray_drake.configuration import ConfigurationError
from xray_drake.resources import models_dir
from xray_drake.station.scenario import dump_scenario, parse_scenario

FOLDER = models_dir() / "gripper"


def test_the_package_has_two() -> None:
    assert gripper_names() == ("parallel_85", "yumi")
    assert load_gripper() == load_gripper("yumi") == Cell().gripper.spec
    for name in gripper_names():
        spec = load_gripper(name)
        assert spec.file == FOLDER / f"{name}.sdf"
        assert load_gripper(spec.file) == spec
        assert spec.has_cup == (name == "yumi")


READ = {
    # what is changed: (model, its overrides, field, value)
    "as it is": ("yumi", {}, "force", 20.0),
    "a whole number": ("yumi", {"force": 15}, "force", 15.0),
    "of another": ("parallel_85", {"friction": 0.8}, "friction", 0.8),
    "without cup": ("yumi", {"cup_radius": 0}, "cup_radius", 0.0),
}


@pytest.mark.parametrize(
    ("model", "overrides", "name", "value"), READ.values(), ids=READ
)
def test_a_cell_is_written_and_read_with_its_gripper(
    model: str, overrides: dict[str, float], name: str, value: float
) -> None:
    cell = Cell(gripper=CellGripper(model, overrides))
    read = parse_cell(dump_cell(cell), "cell.yaml")
    assert read == cell
    assert getattr(read.gripper.spec, name) == value
    assert isinstance(getattr(read.gripper.spec, name), float)
    usual = load_gripper(model)
    for field in fields(GripperSpec):
        if field.name not in overrides:
            assert getattr(read.gripper.spec, field.name) == getattr(
                usual, field.name
            )


REFUSED = """
cell: {gripper: {parameters: {friction: -1}}}
    | cell.gripper.parameters.friction is -1.0: it must be above 0
cell: {gripper: {parameters: {frictoin: 1}}}
    | cell.gripper.parameters.frictoin does not exist; did you mean friction?
cell: {gripper: {parameters: {file: 1}}}
    | cell.gripper.parameters.file does not exist
cell: {gripper: {parameters: {force: much}}}
    | cell.gripper.parameters.force is 'much': it must be a number
cell: {gripper: {parameters: [1]}} | cell.gripper.parameters is [1]
cell: {gripper: {parameters: {vacuum_force: 0}}} | yumi.yaml: vacuum_force is 0
cell: {gripper: {parameters: {opening: 0.06}}} | cell.gripper: opening is 0.06
cell: {gripper: {model: robotiq}} | no gripper 'robotiq': choose one of para
cell: {gripper: {model: wrist}} | no gripper 'wrist'
cell: {gripper: {model: /no/such.sdf}} | /no/such.sdf is not there
cell: {gripper: yumi} | cell.gripper is 'yumi': it must be keys and values
gripper: {parameters: {friction: -1}} | cell.gripper.parameters.friction is -1
gripper: {parameters: 3} | cell.gripper.parameters is 3
"""


@pytest.mark.parametrize(
    ("text", "said"),
    [
        line.split(" | ")
        for line in REFUSED.replace("\n    ", " ").strip().splitlines()
    ],
)
def test_what_is_said_of_a_bad_gripper(text: str, said: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse_scenario(text, "mine.yaml")
    message = str(caught.value)
    assert message.startswith("mine.yaml")
    assert said in message
    assert "\n" not in message


def test_scenarios_written_before_the_cell_had_it_are_read() -> None:
    text = "gripper: {grasps: depth, parameters: {force: 12, friction: 0.4}}"
    scenario = parse_scenario(text, "old.yaml")
    assert scenario.cell.gripper.parameters == {"force": 12, "friction": 0.4}
    assert scenario.gripper.grasps == "depth"
    assert parse_scenario(dump_scenario(scenario), "new.yaml") == scenario
    assert scenario.cell.looks_nominal()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("force: 20.0", "", "force is missing"),
        ("force: 20.0", "forse: 20.0", "forse does not exist"),
        ("force: 20.0", "force: 2000", "force is 2000: it must be above 0"),
        ("force: 20.0", "force: [", "is not YAML"),
        ("cup_elasticity: 2.2", "", "cup_elasticity is 0"),
    ],
)
def test_a_gripper_of_ones_own(
    tmp_path: Path, old: str, new: str, said: str
) -> None:
    """Its paths are relative to the cell's file."""
    shutil.copy(FOLDER / "yumi.sdf", tmp_path / "own.sdf")
    text = (FOLDER / "yumi.yaml").read_text(encoding="utf-8")
    (tmp_path / "own.yaml").write_text(text, encoding="utf-8")
    cell_file = tmp_path / "cell.yaml"
    cell_file.write_text("gripper: {model: own.sdf}\n")
    gripper = load_cell(cell_file).gripper
    assert gripper.model == str(tmp_path / "own.sdf")
    assert gripper.spec.opening == 0.05
    assert old in text
    (tmp_path / "own.yaml").write_text(text.replace(old, new), "utf-8")
    with pytest.raises(ConfigurationError, match=r"own\.yaml") as caught:
        _ = gripper.spec
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_model_needs_a_yaml_beside_it() -> None:
    with pytest.raises(ConfigurationError, match=r"cannot read .*wrist\.yaml"):
        load_gripper(FOLDER / "wrist.sdf")
