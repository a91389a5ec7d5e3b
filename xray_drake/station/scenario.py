"""The scenario: one YAML file says all that a search depends on."""

import dataclasses
import difflib
import typing
from dataclasses import dataclass, field
from pathlib import Path

import yaml
from pydrake.common.schema import Rotation, Transform
from pydrake.common.yaml import yaml_dump_typed, yaml_load_typed
from pydrake.geometry import Rgba
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
from pydrake.systems.analysis import SimulatorConfig
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraConfig
from pydrake.visualization import VisualizationConfig

from xray_drake.grasping.gripper_geometry import GripperParameters
from xray_drake.grasping.planner import GraspPlannerConfig
from xray_drake.gripper.quasi_static import QuasiStaticConfig
from xray_drake.occupancy.exact import ExactInferenceConfig
from xray_drake.resources import models_dir
from xray_drake.scene.heap import HeapConfig
from xray_drake.scene.plant import default_plant_config
from xray_drake.scene.targets import TARGET_NAMES

DETECTORS = ("ground_truth",)
SEGMENTERS = ("ground_truth",)
OCCUPANCIES = ("exact",)
POLICIES = ("xray", "largest", "random")
GRASPS = ("models",)
EXECUTIONS = ("quasi_static",)


class ScenarioError(ValueError):
    """A scenario that cannot be used; the message is one line."""


@dataclass
class SceneConfig:
    """What lies in the bin."""

    # Name of the target: one of xray_drake.scene.targets.TARGET_NAMES.
    target: str = "box_2to1"
    # How many distractors are dropped on it.
    num_objects: int = 14
    # Folders of meshes that replace the procedural distractors.
    meshes: list[str] = field(default_factory=list)
    # How they are dropped.
    heap: HeapConfig = field(default_factory=HeapConfig)


@dataclass
class PerceptionConfig:
    """Which perception systems look at the images."""

    # Finds the target's modal mask: "ground_truth".
    detector: str = "ground_truth"
    # Finds the modal masks of all objects: "ground_truth".
    segmenter: str = "ground_truth"
    # Infers the occupancy distribution: "exact".
    occupancy: str = "exact"
    # Settings of "exact".
    exact: ExactInferenceConfig = field(default_factory=ExactInferenceConfig)


@dataclass
class PolicyConfig:
    """Which object is grasped next."""

    # The ranking: "xray", "largest" or "random".
    name: str = "xray"
    # Grasp the target as soon as a grasp on it exists.
    target_first: bool = True
    # Objects with fewer visible pixels are not candidates.
    min_visible_pixels: int = 50
    # A weaker grasp counts only where no candidate has one as good as this.
    min_grasp_quality: float = 0.2


@dataclass
class GripperConfig:
    """How grasps are planned and executed."""

    # How grasps are planned: "models".
    grasps: str = "models"
    # How grasps are executed: "quasi_static".
    execution: str = "quasi_static"
    # What the gripper can do.
    parameters: GripperParameters = field(default_factory=GripperParameters)
    # How grasps are searched for.
    planner: GraspPlannerConfig = field(default_factory=GraspPlannerConfig)
    # How "quasi_static" perturbs, judges and moves.
    quasi_static: QuasiStaticConfig = field(default_factory=QuasiStaticConfig)


def nominal_camera() -> CameraConfig:
    """Returns the overhead camera of PROTOCOL.md.

    Nominal Photoneo PhoXi S intrinsics scaled to 512×384, 0.8 m above the
    floor, straight down, image x along world x.
    """
    return CameraConfig(
        name="overhead",
        width=512,
        height=384,
        focal=CameraConfig.FocalLength(x=552.5, y=552.5),
        center_x=255.5,
        center_y=191.5,
        X_PB=Transform(
            base_frame="world",
            translation=[0.0, 0.0, 0.8],
            rotation=Rotation(value=Rotation.Rpy(deg=[180.0, 0.0, 0.0])),
        ),
        z_near=0.1,
        z_far=3.0,
        clipping_near=0.05,
        clipping_far=5.0,
        renderer_class="RenderEngineVtk",
        label=True,
        background=Rgba(0.25, 0.27, 0.30),
    )


@dataclass
class Scenario:
    """All that a search depends on; the same scenario gives the same search."""

    # Name, for the record.
    name: str = "demo"
    # Of the heap, the Random policy and the execution's perturbations.
    seed: int = 0
    # Actions at most (the paper's H).
    horizon: int = 10
    scene: SceneConfig = field(default_factory=SceneConfig)
    # The overhead camera.
    camera: CameraConfig = field(default_factory=nominal_camera)
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
    # Meshcat's publishing; used where a Meshcat is given.
    visualization: VisualizationConfig = field(
        default_factory=lambda: VisualizationConfig(
            publish_period=1 / 32, publish_proximity=False
        )
    )


def scenario_names() -> tuple[str, ...]:
    """Returns the names of the scenarios that come with the package."""
    folder = models_dir() / "scenarios"
    return tuple(sorted(path.stem for path in folder.glob("*.yaml")))


def load_scenario(name_or_path: str | Path) -> Scenario:
    """Reads a scenario that comes with the package, or a file.

    Args:
        name_or_path: a name of :func:`scenario_names`, or a YAML file.

    Raises:
        ScenarioError: no such scenario or file; not YAML; a key that does not
            exist, named with its path; a value of the wrong kind.
    """
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml") and not path.is_file():
        path = models_dir() / "scenarios" / f"{name_or_path}.yaml"
        if not path.is_file():
            raise ScenarioError(
                f"no scenario {str(name_or_path)!r}: choose one of "
                f"{', '.join(scenario_names())}, or give a YAML file"
            )
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError(f"cannot read scenario {path}: {error}") from error
    return parse_scenario(text, str(path))


def parse_scenario(text: str, source: str) -> Scenario:
    """Reads a scenario from YAML text; see :func:`load_scenario`.

    Args:
        text: YAML.
        source: where it came from, for messages.

    Raises:
        ScenarioError: as :func:`load_scenario`.
    """
    try:
        tree = yaml.load(text, Loader=_StrictLoader)
    except yaml.YAMLError as error:
        where = " ".join(str(error).split())
        raise ScenarioError(f"{source} is not YAML: {where}") from error
    if tree is None:
        tree = {}
    if not isinstance(tree, dict):
        raise ScenarioError(
            f"{source} is not a scenario: its top level must be keys and "
            f"values, not {type(tree).__name__}"
        )
    _check_keys(tree, Scenario, source, "")
    try:
        scenario = yaml_load_typed(
            schema=Scenario,
            data=yaml.dump(tree),
            defaults=Scenario(),
        )
    except Exception as error:
        message = " ".join(str(error).split())
        raise ScenarioError(f"{source}: {message}") from error
    check_scenario(scenario, source)
    return scenario


def dump_scenario(scenario: Scenario) -> str:
    """Returns YAML that holds what differs from the defaults.

    Defaults are left out, since Drake's own configs gain and lose fields from
    version to version.
    """
    return yaml_dump_typed(scenario, schema=Scenario, defaults=Scenario())


def check_scenario(scenario: Scenario, source: str = "scenario") -> None:
    """Checks what the types cannot.

    Raises:
        ScenarioError: a choice that does not exist or a number out of range.
    """
    for key, value, choices in (
        ("scene.target", scenario.scene.target, TARGET_NAMES),
        ("perception.detector", scenario.perception.detector, DETECTORS),
        ("perception.segmenter", scenario.perception.segmenter, SEGMENTERS),
        ("perception.occupancy", scenario.perception.occupancy, OCCUPANCIES),
        ("policy.name", scenario.policy.name, POLICIES),
        ("gripper.grasps", scenario.gripper.grasps, GRASPS),
        ("gripper.execution", scenario.gripper.execution, EXECUTIONS),
    ):
        if value not in choices:
            raise ScenarioError(
                f"{source}: {key} is {value!r}: choose one of "
                f"{', '.join(choices)}"
            )
    for key, number in (
        ("scene.num_objects", scenario.scene.num_objects),
        ("horizon", scenario.horizon),
    ):
        if number < 1:
            raise ScenarioError(
                f"{source}: {key} is {number}: it must be at least 1"
            )
    _check_plant(scenario.plant_config, source)
    if scenario.seed < 0:
        raise ScenarioError(
            f"{source}: seed is {scenario.seed}: it must not be negative"
        )


_SCALARS: dict[type, tuple[type, ...]] = {
    int: (int,),
    float: (int, float),
    bool: (bool,),
    str: (str,),
}


class _StrictLoader(yaml.SafeLoader):
    """Rejects duplicate keys, which YAML readers accept silently."""

    def construct_mapping(
        self, node: yaml.MappingNode, deep: bool = False
    ) -> dict:
        keys = [self.construct_object(key, deep=deep) for key, _ in node.value]
        for key in keys:
            if keys.count(key) > 1:
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key {key!r} stands twice", node.start_mark
                )
        return super().construct_mapping(node, deep=deep)


def _check_plant(config: MultibodyPlantConfig, source: str) -> None:
    try:
        AddMultibodyPlant(config=config, builder=DiagramBuilder())
    except RuntimeError as error:
        message = " ".join(str(error).split())
        raise ScenarioError(f"{source}: plant_config: {message}") from error


def _check_keys(tree: dict, schema: type, source: str, prefix: str) -> None:
    """Names an unknown key with its path; Drake's reader names it alone."""
    hints = typing.get_type_hints(schema)
    fields = {f.name: hints[f.name] for f in dataclasses.fields(schema)}
    for key, value in tree.items():
        if key not in fields:
            near = difflib.get_close_matches(str(key), fields, 1)
            hint = f"; did you mean {prefix}{near[0]}?" if near else ""
            raise ScenarioError(f"{source}: unknown key {prefix}{key}{hint}")
        kinds = _SCALARS.get(fields[key])
        if kinds and not isinstance(value, kinds):
            raise ScenarioError(
                f"{source}: {prefix}{key} is {value!r}: it must be of type "
                f"{fields[key].__name__}"
            )
        if dataclasses.is_dataclass(fields[key]) and isinstance(value, dict):
            _check_keys(value, fields[key], source, f"{prefix}{key}.")
