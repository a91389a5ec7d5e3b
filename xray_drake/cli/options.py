"""Options that several commands share, and the fields that they replace."""

from collections.abc import Callable, Sequence
from functools import wraps
from inspect import Parameter, signature
from pathlib import Path
from typing import Annotated, Any

import typer

from xray_drake.cell.names import cell_names
from xray_drake.choices import (
    BOX_TARGETS,
    CARRIERS,
    DETECTORS,
    DTYPES,
    EXECUTIONS,
    GRASPS,
    OCCUPANCIES,
    SEGMENTERS,
    TALL_TARGETS,
    TARGET_NAMES,
    current_occupancy,
)
from xray_drake.policy.registry import POLICIES
from xray_drake.splits import SPLITS
from xray_drake.threads import usable_cores


def one_of(names: Sequence[str]) -> str:
    """Returns names in words: "a, b or c"."""
    *others, last = names
    return f"{', '.join(others)} or {last}" if others else last


def names_in(text: str) -> list[str]:
    """Returns names that have commas between."""
    return [name.strip() for name in text.split(",") if name.strip()]


BOXES = f"{BOX_TARGETS[0]} … {BOX_TARGETS[-1]}"
"""The boxes in short; it takes the place of their names."""

FLAT_TARGETS = (BOXES, *(n for n in TARGET_NAMES if n not in BOX_TARGETS))

CORES = usable_cores()

ScenarioName = Annotated[
    str, typer.Option(help="Name of a scenario, or a YAML file.")
]
Mix = Annotated[
    bool,
    typer.Option(
        "--mix",
        help="Go on even with what other code, weights, versions or number "
        "type have made; reports say so.",
    ),
]
Workers = Annotated[int, typer.Option(min=1, help="Processes.")]
Seed = Annotated[int, typer.Option(min=0, help="Of all that is random.")]
OfSplit = Annotated[str | None, typer.Option(help=f"{one_of(SPLITS)}.")]
OfTargets = Annotated[
    list[str] | None, typer.Option(help="Of this target; repeatable.")
]
Dataset = Annotated[
    Path, typer.Argument(metavar="DATASET", help="Holds dataset.json.")
]
Incomplete = Annotated[
    bool,
    typer.Option("--incomplete", help="Of what is there of the dataset, too."),
]
AsJson = Annotated[
    bool, typer.Option("--json", help="Print JSON and nothing else.")
]

DTYPE_HELP = (
    f"{one_of(DTYPES)}: what a network computes in; the second is faster on "
    "some processors, and less exact."
)
Dtype = Annotated[str | None, typer.Option(help=DTYPE_HELP)]

_REPLACING: dict[str, tuple[str, Any, str]] = {
    "policy": ("policy.name", str, f"{one_of([*POLICIES])}."),
    "target_first": (
        "policy.target_first",
        bool,
        "Grasp the target whenever a grasp on it exists.",
    ),
    "target": (
        "scene.target",
        str,
        f"{one_of((*FLAT_TARGETS, *TALL_TARGETS))}; a mesh file; or the size "
        "of a box, as 70x40x12mm.",
    ),
    "target_scale": (
        "scene.target_scale",
        float,
        "Factor from the unit of the target's mesh to metres.",
    ),
    "target_mass": ("scene.target_mass", float, "Of the target, kg."),
    "target_color": (
        "scene.target_color",
        str,
        "Of the target, as 'blue' or '#0050ff'; red by default.",
    ),
    "heap": (
        "scene.heap_file",
        Path,
        "Heap file: objects and poses in place of a heap that is dropped.",
    ),
    "cell": (
        "cell",
        str,
        f"{one_of(cell_names())}, or the YAML file of a cell: bin, tote, "
        "cameras, gripper.",
    ),
    "camera": (
        "cell.overhead",
        Path,
        "File of the overhead camera: Drake's CameraConfig, ROS's CameraInfo, "
        ".intr, or a 3×3 matrix.",
    ),
    "num_objects": (
        "scene.num_objects",
        int,
        "Distractors to drop in every heap.",
    ),
    "meshes": (
        "scene.meshes",
        list[Path],
        "Folder of meshes that replace the distractors; repeatable.",
    ),
    "scale": (
        "scene.mesh_scale",
        float,
        "Factor from the unit of --meshes to metres.",
    ),
    "seed": ("seed", int, "Of heap, policy and execution."),
    "horizon": ("horizon", int, "Actions at most."),
    "execution": ("gripper.execution", str, f"{one_of(EXECUTIONS)}."),
    "carrier": (
        "gripper.carrier",
        str,
        f"{one_of(CARRIERS)}: of the gripper by contact.",
    ),
    "grasps": (
        "gripper.grasps",
        str,
        f"{one_of(GRASPS)}: planned from the objects' models, or from the "
        "depth image alone.",
    ),
    "occupancy": ("perception.occupancy", str, f"{one_of(OCCUPANCIES)}."),
    "weights": (
        "perception.weights",
        str,
        "File of a network's weights, or a folder of them.",
    ),
    "dtype": ("perception.dtype", str, DTYPE_HELP),
    "detector": ("perception.detector", str, f"{one_of(DETECTORS)}."),
    "segmenter": ("perception.segmenter", str, f"{one_of(SEGMENTERS)}."),
}
"""Option to the field of the scenario that it replaces, its type and help."""

SEARCHED = (
    *("cell", "camera", "target", "target_scale", "target_mass"),
    *("target_color", "heap"),
    *("num_objects", "meshes", "scale", "horizon", "execution"),
    *("carrier", "weights", "dtype", "detector", "segmenter", "grasps"),
)
"""Options of whoever searches a heap."""


def replacing(*names: str, panel: str | None = None) -> Callable:
    """Gives a command options that replace fields of its scenario.

    Args:
        names: of the options.
        panel: of the help that they stand in.

    Returns:
        A decorator of a command that takes ``overrides``, see
        :func:`overrides`, in place of the options.
    """

    def decorate(command: Callable) -> Callable:
        @wraps(command)
        def with_options(**given: Any) -> Any:
            said = overrides(**{name: given.pop(name) for name in names})
            return command(overrides=said, **given)

        own = signature(command).parameters.values()
        parameters = [p for p in own if p.name != "overrides"]
        for name in names:
            _, kind, text = _REPLACING[name]
            option = typer.Option(help=text, rich_help_panel=panel)
            parameters.append(
                Parameter(
                    name,
                    Parameter.KEYWORD_ONLY,
                    default=None,
                    annotation=Annotated[kind | None, option],
                )
            )
        with_options.__signature__ = signature(command).replace(  # type: ignore[attr-defined]
            parameters=[
                p.replace(kind=Parameter.KEYWORD_ONLY) for p in parameters
            ]
        )
        with_options.__annotations__ = {
            p.name: p.annotation for p in parameters
        }
        return with_options

    return decorate


def overrides(**options: Any) -> dict[str, Any]:
    """Returns what options say of the scenario.

    Args:
        options: values by the names of the options; ``None``, and an empty
            list, leaves the field as the scenario has it.

    Returns:
        Path of a field ("scene.target") to its value.
    """
    said = {
        _REPLACING[name][0]: value
        for name, value in options.items()
        if value is not None and value != []
    }
    if "perception.occupancy" in said:
        said["perception.occupancy"] = current_occupancy(
            said["perception.occupancy"]
        )
    for path in ("scene.heap_file", "cell.overhead"):
        if path in said:
            said[path] = str(said[path].absolute())
    if "scene.meshes" in said:
        said["scene.meshes"] = [str(path) for path in said["scene.meshes"]]
    if "scene.num_objects" in said:
        # A number that was asked for is not random.
        said["scene.random_number.mean"] = 0.0
    return said
