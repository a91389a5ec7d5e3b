"""Options that several commands share, and the fields that they replace."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

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
)
from xray_drake.policy.registry import POLICIES
from xray_drake.splits import SPLITS
from xray_drake.threads import usable_cores


def one_of(names: Sequence[str]) -> str:
    """Returns names in words: "a, b or c"."""
    *others, last = names
    return f"{', '.join(others)} or {last}" if others else last


BOXES = f"{BOX_TARGETS[0]} … {BOX_TARGETS[-1]}"
"""The boxes in short; it takes the place of their names."""

FLAT_TARGETS = (BOXES, *(n for n in TARGET_NAMES if n not in BOX_TARGETS))

CORES = usable_cores()

ScenarioName = Annotated[
    str, typer.Option(help="Name of a scenario, or a YAML file.")
]
Policy = Annotated[str | None, typer.Option(help=f"{one_of([*POLICIES])}.")]
Policies = Annotated[
    str,
    typer.Option(help=f"{one_of([*POLICIES])}, or some with commas between."),
]
Target = Annotated[
    str | None, typer.Option(help=f"{one_of((*FLAT_TARGETS, *TALL_TARGETS))}.")
]
NumObjects = Annotated[
    int | None, typer.Option(help="Distractors to drop in every heap.")
]
Meshes = Annotated[
    list[Path] | None,
    typer.Option(
        help="Folder of meshes that replace the distractors; repeatable."
    ),
]
Scale = Annotated[
    float | None,
    typer.Option(help="Factor from the unit of --meshes to metres."),
]
Horizon = Annotated[int | None, typer.Option(help="Actions at most.")]
TargetFirst = Annotated[
    bool | None,
    typer.Option(
        "--target-first/--no-target-first",
        help="Grasp the target whenever a grasp on it exists.",
    ),
]
Execution = Annotated[str | None, typer.Option(help=f"{one_of(EXECUTIONS)}.")]
Carrier = Annotated[
    str | None,
    typer.Option(help=f"{one_of(CARRIERS)}: of the gripper by contact."),
]
Occupancy = Annotated[str | None, typer.Option(help=f"{one_of(OCCUPANCIES)}.")]
Occupancies = Annotated[
    str,
    typer.Option(
        help=f"{one_of(OCCUPANCIES)}, or some with commas between: policies "
        "that look at the distribution run with each. By default the "
        "scenario's."
    ),
]
Weights = Annotated[
    str | None,
    typer.Option(help="File of a network's weights, or a folder of them."),
]
Dtype = Annotated[
    str | None,
    typer.Option(
        help=f"{one_of(DTYPES)}: what a network computes in; the second is "
        "faster on some processors, and less exact."
    ),
]
Detector = Annotated[str | None, typer.Option(help=f"{one_of(DETECTORS)}.")]
Segmenter = Annotated[str | None, typer.Option(help=f"{one_of(SEGMENTERS)}.")]
Grasps = Annotated[
    str | None,
    typer.Option(
        help=f"{one_of(GRASPS)}: planned from the objects' models, or from the "
        "depth image alone."
    ),
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

OfSplit = Annotated[str | None, typer.Option(help=f"{one_of(SPLITS)}.")]
OfTargets = Annotated[
    list[str] | None, typer.Option(help="Of this target; repeatable.")
]
Dataset = Annotated[
    Path, typer.Argument(metavar="DATASET", help="Holds dataset.json.")
]
AsJson = Annotated[
    bool, typer.Option("--json", help="Print JSON and nothing else.")
]

_FIELDS = {
    "policy": "policy.name",
    "target_first": "policy.target_first",
    "target": "scene.target",
    "num_objects": "scene.num_objects",
    "meshes": "scene.meshes",
    "scale": "scene.mesh_scale",
    "seed": "seed",
    "horizon": "horizon",
    "execution": "gripper.execution",
    "carrier": "gripper.carrier",
    "grasps": "gripper.grasps",
    "occupancy": "perception.occupancy",
    "weights": "perception.weights",
    "dtype": "perception.dtype",
    "detector": "perception.detector",
    "segmenter": "perception.segmenter",
}
"""Option to the field of the scenario that it replaces."""


def overrides(**options: Any) -> dict[str, Any]:
    """Returns what options say of the scenario.

    Args:
        options: values by the names of the options; ``None``, and an empty
            list, leaves the field as the scenario has it.

    Returns:
        Path of a field ("scene.target") to its value.
    """
    said = {
        _FIELDS[name]: value
        for name, value in options.items()
        if value is not None and value != []
    }
    if "scene.meshes" in said:
        said["scene.meshes"] = [str(path) for path in said["scene.meshes"]]
    if "scene.num_objects" in said:
        # A number that was asked for is not random.
        said["scene.random_number.mean"] = 0.0
    return said
