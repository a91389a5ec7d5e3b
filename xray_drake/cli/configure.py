"""The scenario that the command line asks for."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from xray_drake.cell.camera_files import read_camera
from xray_drake.cell.cell import load_cell
from xray_drake.scene.targets import is_mesh
from xray_drake.station.scenario import (
    Scenario,
    ScenarioError,
    check_scenario,
    load_scenario,
    says_occupancy,
    usual_occupancy,
)

_IN_CELL = ("cell", "cell.overhead")
_OCCUPANCY = "perception.occupancy"


def configure(
    name: str, overrides: Mapping[str, Any], *, searched: bool = True
) -> Scenario:
    """Loads a scenario and puts in what the command line says.

    Where that gives another bin or camera and no inference, the one is taken
    that is usual there.

    Args:
        name: of a scenario, or a YAML file.
        overrides: see :func:`xray_drake.cli.options.overrides`.
        searched: see :func:`xray_drake.station.scenario.check_scenario`.

    Raises:
        ScenarioError: see :func:`xray_drake.station.scenario.load_scenario`;
            a cell, a camera or a colour that cannot be read.
    """
    scenario = load_scenario(name, searched=searched)
    for path in sorted(overrides):
        *parents, field = path.split(".")
        owner: Any = scenario
        for parent in parents:
            owner = getattr(owner, parent)
        setattr(owner, field, _value(scenario, path, overrides[path]))
    elsewhere = set(_IN_CELL) & set(overrides)
    if elsewhere and _OCCUPANCY not in overrides and not says_occupancy(name):
        scenario.perception.occupancy = usual_occupancy(scenario)
    beside = {path for path in overrides if path.startswith("scene.target")}
    beside |= {"scene.num_objects", "scene.meshes"} & set(overrides)
    if "scene.heap_file" in overrides and beside:
        option = min(beside).removeprefix("scene.").replace("_", "-")
        raise ScenarioError(
            f"--{option} beside --heap, whose file has its own: leave one out"
        )
    check_scenario(scenario, "command line", searched=searched)
    return scenario


def _value(scenario: Scenario, path: str, value: Any) -> Any:
    """Returns what an option stands for.

    Raises:
        ScenarioError: a file that cannot be read, or no colour.
    """
    if path == "cell":
        return load_cell(value)
    if path == "cell.overhead":
        return read_camera(Path(value), scenario.camera)
    if path == "scene.target" and is_mesh(value):
        return str(Path(value).expanduser().absolute())
    if path == "scene.target_color":
        from matplotlib.colors import to_rgb

        try:
            return list(to_rgb(value))
        except ValueError as error:
            raise ScenarioError(
                f"--target-color {value!r} is no colour: give a name, as blue, "
                "or #rrggbb"
            ) from error
    return value
