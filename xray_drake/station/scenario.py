"""The scenario: one YAML file says all that a search depends on."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.multibody.parsing import LoadModelDirectives
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
from pydrake.systems.analysis import SimulatorConfig
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraConfig
from pydrake.visualization import VisualizationConfig

from xray_drake.cell.cameras import LENS, CameraSampling, nominal_camera
from xray_drake.cell.cell import (
    Cell,
    cell_differences,
    cell_tree,
    load_cell,
)
from xray_drake.cell.drake_rules import (
    CONTACT_APPROXIMATIONS,
    CONTACT_MODELS,
    DRAKE_RULES,
)
from xray_drake.cell.names import SUFFIXES, cell_path
from xray_drake.choices import (
    WITHOUT_NETWORK,
    current_occupancy,
)
from xray_drake.configuration import (
    SEEDS,
    build,
    check,
    configured,
    count,
    differences,
    fields_of,
    tree_of,
    with_paths,
)
from xray_drake.faults import BREAKDOWNS
from xray_drake.grasping.gripper_geometry import gripper_geometry
from xray_drake.occupancy.geometric.config import (
    check_label,
)
from xray_drake.occupancy.learned.inference import default_weights
from xray_drake.occupancy.learned.weights import WeightsError, read_card
from xray_drake.policy.registry import POLICIES, PolicyError
from xray_drake.resources import models_dir
from xray_drake.scene.meshes.textures import is_red
from xray_drake.scene.plant import default_plant_config
from xray_drake.scene.targets import is_mesh
from xray_drake.station.config import (
    GripperConfig,
    PerceptionConfig,
    PolicyConfig,
    SceneConfig,
)
from xray_drake.trees import (
    ConfigurationError,
    read_text,
    read_tree,
    write_tree,
)

ScenarioError = ConfigurationError
"""A scenario that cannot be used; the message is one line."""


@dataclass(slots=True, eq=False)
class Scenario:
    """All that a search depends on; the same scenario gives the same search."""

    # Name, for the record.
    name: str = "demo"
    # Of the heap, the Random policy and the execution's perturbations.
    seed: int = count(0, SEEDS)
    # Actions at most (the paper's H).
    horizon: int = count(10, "[1, 10000]")
    scene: SceneConfig = field(default_factory=SceneConfig)
    # Bin, tote, cameras, gripper: their fields, or in YAML the name of a cell
    # that comes with the package, or a file.
    cell: Cell = field(default_factory=Cell)
    # How cameras are drawn around it, for datasets.
    camera_sampling: CameraSampling = field(default_factory=CameraSampling)
    perception: PerceptionConfig = field(default_factory=PerceptionConfig)
    policy: PolicyConfig = field(default_factory=PolicyConfig)
    gripper: GripperConfig = field(default_factory=GripperConfig)
    # Physics.
    plant_config: MultibodyPlantConfig = field(
        default_factory=default_plant_config
    )
    simulator_config: SimulatorConfig = field(
        default_factory=lambda: SimulatorConfig(target_realtime_rate=0.0)
    )
    # Where a Meshcat is given: its publish_period, the rest is fixed.
    visualization: VisualizationConfig = field(
        default_factory=lambda: VisualizationConfig(
            publish_period=1 / 32, publish_proximity=False
        )
    )

    def __eq__(self, other: object) -> bool:
        """Compares all values: Drake's structs have no equality."""
        if not isinstance(other, Scenario):
            return NotImplemented
        return tree_of(self) == tree_of(other)

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        """Pickles it as keys and values: Drake's structs cannot be."""
        return build, (Scenario, tree_of(self), self.name)

    @property
    def camera(self) -> CameraConfig:
        """The cell's overhead camera."""
        return self.cell.overhead

    def complaints(self) -> Iterator[str]:
        """Yields what is wrong between its fields."""
        perception = self.perception
        for owner, said in _unused(self):
            yield f"{owner}.{said}, which nothing here looks at: leave it out"
        if perception.occupancy == "geometric_label":
            try:
                check_label(perception.geometric)
            except ValueError as error:
                yield f"perception.{error}"
            if perception.geometric.poses == "resting":
                yield (
                    f"perception.geometric.poses is "
                    f"{perception.geometric.poses}, but perception.occupancy: "
                    "geometric_label takes the target to lie flat; choose "
                    "poses: flat, or occupancy: geometric"
                )
        if perception.segmenter == "depth" and self.gripper.grasps == "models":
            yield (
                "perception.segmenter is depth, but gripper.grasps is models: "
                "of what is found in depth no model is known; choose "
                "gripper.grasps: depth"
            )
        color = self.scene.target_color
        if (
            perception.detector == "hsv"
            and color
            and not is_red(np.array(color))
        ):
            yield (
                f"scene.target_color is {color}, and perception.detector: hsv "
                "finds what is red: choose ground_truth, or a red"
            )
        if self.gripper.execution == "contact":
            # First: Drake's own message does not say what to choose.
            yield from _contact_complaints(self)
        try:
            AddMultibodyPlant(
                config=self.plant_config, builder=DiagramBuilder()
            )
        except BREAKDOWNS as error:
            yield f"plant_config: {' '.join(str(error).split())}"


def scenario_names() -> tuple[str, ...]:
    """Returns the names of the scenarios that come with the package."""
    folder = models_dir() / "scenarios"
    return tuple(sorted(path.stem for path in folder.glob("*.yaml")))


def _scenario_path(name_or_path: str | Path) -> Path:
    path = Path(name_or_path)
    if path.suffix not in SUFFIXES and not path.is_file():
        path = models_dir() / "scenarios" / f"{name_or_path}.yaml"
        if not path.is_file():
            raise ScenarioError(
                f"no scenario {str(name_or_path)!r}: choose one of "
                f"{', '.join(scenario_names())}, or give a YAML file"
            )
    return path


def load_scenario(
    name_or_path: str | Path, *, searched: bool = True
) -> Scenario:
    """Reads a scenario that comes with the package, or a file.

    Args:
        name_or_path: a name of :func:`scenario_names`, or a YAML file.
        searched: see :func:`check_scenario`.

    Raises:
        ScenarioError: no such scenario or file; not YAML; a key that does not
            exist, named with its path; a value of the wrong kind.
    """
    path = _scenario_path(name_or_path)
    return parse_scenario(
        read_text(path), str(path), searched=searched, folder=path.parent
    )


def says_occupancy(name_or_path: str | Path) -> bool:
    """Says whether a scenario names its inference; see :func:`load_scenario`.

    Raises:
        ScenarioError: it cannot be read.
    """
    path = _scenario_path(name_or_path)
    perception = read_tree(read_text(path), str(path)).get("perception")
    return isinstance(perception, dict) and "occupancy" in perception


def parse_scenario(
    text: str,
    source: str,
    *,
    searched: bool = True,
    folder: Path | None = None,
) -> Scenario:
    """Reads a scenario from YAML text; see :func:`load_scenario`.

    Args:
        text: YAML.
        source: where it came from, for messages.
        searched: see :func:`check_scenario`.
        folder: what the paths in it are relative to; by default the current
            one, and they are left as they are.

    Raises:
        ScenarioError: as :func:`load_scenario`.
    """
    tree = _renamed(read_tree(text, source), source)
    named = tree.pop("cell") if isinstance(tree.get("cell"), str) else ""
    if isinstance(tree.get("cell"), dict):
        tree["cell"] = cell_tree(tree["cell"])
    scenario = configured(
        Scenario, tree, source, folder=folder, foreign=DRAKE_RULES
    )
    if named:
        scenario.cell = load_cell(cell_path(named, folder or Path()))
    if "occupancy" not in tree.get("perception", {}):
        scenario.perception.occupancy = usual_occupancy(scenario)
    check_scenario(scenario, source, searched=searched)
    return scenario


def _renamed(tree: dict[str, Any], source: str) -> dict[str, Any]:
    """Gives what version 0.1 called otherwise its name of today, in place.

    Raises:
        ScenarioError: it says where the bin's floor is; the cell does now.
    """
    perception = tree.get("perception")
    if isinstance(perception, dict):
        name = perception.get("occupancy")
        if isinstance(name, str):
            perception["occupancy"] = current_occupancy(name)
        if "exact" in perception and "geometric" not in perception:
            perception["geometric"] = perception.pop("exact")
        for name in ("geometric", "depth_segmenter"):
            part = perception.get(name)
            if isinstance(part, dict) and "floor" in part:
                raise ScenarioError(
                    f"{source}: perception.{name}.floor is now the cell's bin: "
                    "cell: {bin: {length: …, width: …}}"
                )
    if "camera" in tree and isinstance(tree.setdefault("cell", {}), dict):
        camera = tree.pop("camera")
        if isinstance(camera, dict):
            # Its lens did not follow its size.
            nominal = tree_of(nominal_camera())
            camera = {key: nominal[key] for key in LENS} | camera
        if not isinstance(perception, dict):
            perception = tree.setdefault("perception", {})
        if isinstance(perception, dict):
            # Nor did the inference follow it.
            perception.setdefault("occupancy", "learned")
        tree["cell"].setdefault("overhead", camera)
    gripper, cell = tree.get("gripper"), tree.get("cell", {})
    if isinstance(gripper, dict) and isinstance(cell, dict):
        owner = cell.get("gripper", {})
        if "parameters" in gripper and isinstance(owner, dict):
            owner = {"parameters": gripper.pop("parameters")} | owner
            tree["cell"] = cell | {"gripper": owner}
    return tree


def dump_scenario(scenario: Scenario) -> str:
    """Returns YAML that holds what differs from the defaults.

    Defaults are left out, since Drake's own configs gain and lose fields from
    version to version.
    """
    tree = differences(tree_of(scenario), tree_of(Scenario()))
    if "cell" in tree:
        tree["cell"] = cell_differences(scenario.cell)
        # Elsewhere than in the nominal cell the default is another.
        perception = tree.setdefault("perception", {})
        perception["occupancy"] = scenario.perception.occupancy
    return write_tree(tree)


def record_scenario(scenario: Scenario) -> str:
    """Returns a scenario as records hold it: its paths hold in any folder."""
    return dump_scenario(with_paths(scenario, Path()))


def check_scenario(
    scenario: Scenario, source: str = "scenario", *, searched: bool = True
) -> None:
    """Checks what the types cannot.

    Args:
        scenario: to be checked.
        source: where it came from, for messages.
        searched: a search is to be run: the policy must be known, and the
            network's weights be there. What was recorded elsewhere can be
            read, and heaps be dropped, without.

    Raises:
        ScenarioError: a choice that does not exist or a number out of range.
    """
    check(scenario, source, DRAKE_RULES)
    if not searched:
        return
    for said in _missing_files(scenario):
        raise ScenarioError(f"{source}: {said}")
    try:
        POLICIES[scenario.policy.name]
    except PolicyError as error:
        raise ScenarioError(f"{source}: policy.name: {error}") from error
    try:
        gripper_geometry(scenario.cell.gripper.spec)
    except ConfigurationError as error:
        raise ScenarioError(f"{source}: cell.gripper: {error}") from error
    perception = scenario.perception
    path = weights_path(perception)
    if perception.occupancy not in WITHOUT_NETWORK and not path.is_dir():
        try:
            read_card(path)
        except WeightsError as error:
            raise ScenarioError(
                f"{source}: perception.weights: {error}"
            ) from error


_UNUSED = {
    "cell.overhead": ("capture_offset", "output_delay"),
    "visualization": tuple(
        name
        for name in fields_of(VisualizationConfig)
        if name != "publish_period"
    ),
}
"""Of Drake's structs, what would change a search or its pictures elsewhere."""


def _unused(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yields what is set, but has no effect."""
    defaults = Scenario()
    for owner, names in _UNUSED.items():
        given, usual = (
            tree_of(attrgetter(owner)(chosen))
            for chosen in (scenario, defaults)
        )
        for name in names:
            if given[name] != usual[name]:
                yield owner, f"{name} is {given[name]}"


def _missing_files(scenario: Scenario) -> Iterator[str]:
    """Yields what a heap is made of and cannot be read."""
    scene, directives = scenario.scene, scenario.cell.directives
    for key, path in (
        ("scene.target", is_mesh(scene.target) and scene.target),
        ("scene.heap_file", scene.heap_file),
        ("cell.directives", directives),
    ):
        if path and not Path(path).is_file():
            yield f"{key} is {path!r}: there is no such file"
    if directives:
        try:
            LoadModelDirectives(directives)
        except BREAKDOWNS as error:
            yield f"cell.directives: {' '.join(str(error).split())}"


def usual_occupancy(scenario: Scenario) -> str:
    """Returns what infers the distribution where a scenario does not say.

    The shipped network has seen one bin and one kind of camera; elsewhere, and
    where no other weights are given, it is geometric inference.
    """
    perception = scenario.perception
    if perception.weights or scenario.cell.looks_nominal():
        return "learned"
    return "geometric"


def weights_path(perception: PerceptionConfig) -> Path:
    """Returns where the network's weights are."""
    given = perception.weights
    return Path(given) if given else default_weights()


def _contact_complaints(scenario: Scenario) -> Iterator[str]:
    """Yields what the gripper in the plant cannot do with."""
    for name in ("pad_width", "pad_height"):
        value = scenario.cell.gripper.parameters.get(name)
        if value is not None:
            yield (
                f"gripper.execution is contact, but cell.gripper.parameters."
                f"{name} is {value}: the gripper in the plant has the pads of "
                "its model; leave it out"
            )
    for key, wanted in (
        ("contact_model", CONTACT_MODELS[1:]),
        ("discrete_contact_approximation", CONTACT_APPROXIMATIONS[1:]),
    ):
        value = getattr(scenario.plant_config, key)
        if value not in wanted:
            yield (
                f"gripper.execution is contact, but plant_config.{key} is "
                f"{value!r}: choose one of {', '.join(wanted)}"
            )
