"""The scenario: one YAML file says all that a search depends on."""

import dataclasses
import difflib
import operator
import re
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

from xray_drake.choices import (
    CARRIERS,
    DETECTORS,
    DTYPES,
    EXECUTIONS,
    GRASPS,
    OCCUPANCIES,
    POLICIES,
    SEGMENTERS,
    TALL_TARGETS,
    TARGET_NAMES,
    WITHOUT_NETWORK,
)
from xray_drake.grasping.depth_planner import DepthPlannerConfig
from xray_drake.grasping.gripper_geometry import GripperParameters
from xray_drake.grasping.planner import GraspPlannerConfig
from xray_drake.gripper.execution import ExecutionConfig
from xray_drake.gripper.quasi_static import QuasiStaticConfig
from xray_drake.gripper.suction import SuctionConfig
from xray_drake.occupancy.exact import ExactInferenceConfig
from xray_drake.occupancy.exact_config import POSES
from xray_drake.occupancy.learned import default_weights
from xray_drake.occupancy.networks.fcn_resnet50 import SIZE_STEP
from xray_drake.occupancy.networks.weights import WeightsError, read_card
from xray_drake.perception.depth_noise import DepthNoise
from xray_drake.perception.depth_segmenter import DepthSegmenterConfig
from xray_drake.perception.hsv_target import HsvTargetConfig
from xray_drake.resources import models_dir
from xray_drake.scene.cameras import (
    CameraSampling,
    check_renderer,
    pinhole_camera,
)
from xray_drake.scene.contact import ContactConfig
from xray_drake.scene.heap import ARRANGEMENTS, HeapConfig
from xray_drake.scene.plant import default_plant_config
from xray_drake.splits import SPLITS

MOST_OBJECTS = 100
"""Distractors that a scenario may ask for."""


class ScenarioError(ValueError):
    """A scenario that cannot be used; the message is one line."""


@dataclass(slots=True)
class RandomNumber:
    """How many distractors: Poisson, truncated (paper section IV.A)."""

    # Mean before truncation; at 0 the number is not random.
    mean: float = 0.0
    # Least and most.
    least: int = 10
    most: int = 15


@dataclass(slots=True)
class SceneConfig:
    """What lies in the bin."""

    # Name of the target: one of TARGET_NAMES or TALL_TARGETS in
    # xray_drake.choices.
    target: str = "box_2to1"
    # How many distractors are dropped on it.
    num_objects: int = 14
    # Or their number is drawn anew for each heap.
    random_number: RandomNumber = field(default_factory=RandomNumber)
    # Which of the procedural distractors: "train", "validation" or "test".
    split: str = "train"
    # Those that come on a backing card as well are drawn from, too.
    packaged: bool = False
    # Share of packaged objects among those drawn; at 0 as many as there are.
    packaged_share: float = 0.0
    # Folders of meshes that replace the procedural distractors.
    meshes: list[str] = field(default_factory=list)
    # Factor from the meshes' unit to metres.
    mesh_scale: float = 1.0
    # A heap whose target starts more visible than this is drawn again; at 1
    # all heaps count.
    most_visible: float = 1.0
    # How they are dropped.
    heap: HeapConfig = field(default_factory=HeapConfig)
    # Their material.
    contact: ContactConfig = field(default_factory=ContactConfig)


@dataclass(slots=True)
class PerceptionConfig:
    """Which perception systems look at the images."""

    # Finds the target's modal mask: "ground_truth", or "hsv" by its colour.
    detector: str = "ground_truth"
    # Finds the modal masks of all objects: "ground_truth", or "depth" by the
    # shape of what is seen.
    segmenter: str = "ground_truth"
    # The depth image is as a real sensor gives it.
    noise: bool = False
    # Infers the occupancy distribution: "learned" by a network; "posterior",
    # by a network too, but as probable as heaps have taught it; "exact", by all
    # poses that explain the image; or "expected", by a guess of the label.
    occupancy: str = "learned"
    # File of a network's weights, or a folder of networks of one box each; by
    # default the one that travels with the package.
    weights: str = ""
    # What the network computes in: "float32", or "bfloat16", which is faster
    # where the processor has instructions for it, but not the same search.
    dtype: str = DTYPES[0]
    # Settings of "exact" and "expected".
    exact: ExactInferenceConfig = field(default_factory=ExactInferenceConfig)
    # Settings of "hsv".
    hsv: HsvTargetConfig = field(default_factory=HsvTargetConfig)
    # Settings of "depth".
    depth_segmenter: DepthSegmenterConfig = field(
        default_factory=DepthSegmenterConfig
    )
    # Settings of the noise.
    depth_noise: DepthNoise = field(default_factory=DepthNoise)


@dataclass(slots=True)
class PolicyConfig:
    """Which object is grasped next."""

    # One of POLICIES; see ``xray_drake.policy.policies``.
    name: str = "xray"
    # Grasp the target as soon as a grasp on it exists.
    target_first: bool = True
    # Objects with fewer visible pixels are not candidates.
    min_visible_pixels: int = 50
    # A weaker grasp counts only where no candidate that hides anything has one
    # as good as this.
    min_grasp_quality: float = 0.2


@dataclass(slots=True)
class GripperConfig:
    """How grasps are planned and executed."""

    # How grasps are planned: "models", from the objects' models and poses, or
    # "depth", from the depth image alone.
    grasps: str = "models"
    # How grasps are executed: "quasi_static", where an ideal gripper lifts what
    # the analysis says would hold; or "contact", with fingers and suction cup.
    execution: str = "quasi_static"
    # What carries the gripper of "contact": "wrist", three slides and three
    # turns; or "arm", seven turning joints that do not reach everywhere.
    carrier: str = "wrist"
    # What the gripper can do.
    parameters: GripperParameters = field(default_factory=GripperParameters)
    # How "models" searches for grasps.
    planner: GraspPlannerConfig = field(default_factory=GraspPlannerConfig)
    # How "depth" does.
    depth_planner: DepthPlannerConfig = field(
        default_factory=DepthPlannerConfig
    )
    # How "quasi_static" perturbs, judges and moves.
    quasi_static: QuasiStaticConfig = field(default_factory=QuasiStaticConfig)
    # How "contact" moves, and when it gives up.
    contact: ExecutionConfig = field(default_factory=ExecutionConfig)
    # The suction cup of "contact".
    suction: SuctionConfig = field(default_factory=SuctionConfig)


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


@dataclass(slots=True)
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
    return parse_scenario(text, str(path), searched=searched)


def parse_scenario(
    text: str, source: str, *, searched: bool = True
) -> Scenario:
    """Reads a scenario from YAML text; see :func:`load_scenario`.

    Args:
        text: YAML.
        source: where it came from, for messages.
        searched: see :func:`check_scenario`.

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
            data=text if tree else "{}",
            defaults=Scenario(),
        )
    except Exception as error:
        message = " ".join(str(error).split())
        raise ScenarioError(f"{source}: {message}") from error
    check_scenario(scenario, source, searched=searched)
    return scenario


def dump_scenario(scenario: Scenario) -> str:
    """Returns YAML that holds what differs from the defaults.

    Defaults are left out, since Drake's own configs gain and lose fields from
    version to version.
    """
    defaults = Scenario()
    rotation = scenario.camera.X_PB.rotation
    nominal = defaults.camera.X_PB.rotation
    if yaml_dump_typed(rotation) != yaml_dump_typed(nominal):
        # Beside a default with the same tag, the writer drops the tag.
        defaults.camera.X_PB.rotation = Rotation(
            value=Rotation.AngleAxis()
            if not isinstance(rotation.value, Rotation.AngleAxis)
            else Rotation.Identity()
        )
    return yaml_dump_typed(scenario, schema=Scenario, defaults=defaults)


def check_scenario(
    scenario: Scenario, source: str = "scenario", *, searched: bool = True
) -> None:
    """Checks what the types cannot.

    Args:
        scenario: to be checked.
        source: where it came from, for messages.
        searched: a search is to be run: the network's weights must be there,
            and fit the camera. What was recorded elsewhere can be read, and
            heaps be dropped, without.

    Raises:
        ScenarioError: a choice that does not exist or a number out of range.
    """
    for key, value, choices in (
        (
            "scene.target",
            scenario.scene.target,
            (*TARGET_NAMES, *TALL_TARGETS),
        ),
        ("scene.split", scenario.scene.split, SPLITS),
        (
            "scene.heap.arrangement",
            scenario.scene.heap.arrangement,
            ARRANGEMENTS,
        ),
        ("perception.detector", scenario.perception.detector, DETECTORS),
        ("perception.segmenter", scenario.perception.segmenter, SEGMENTERS),
        ("perception.occupancy", scenario.perception.occupancy, OCCUPANCIES),
        ("perception.dtype", scenario.perception.dtype, DTYPES),
        ("perception.exact.poses", scenario.perception.exact.poses, POSES),
        ("policy.name", scenario.policy.name, POLICIES),
        ("gripper.grasps", scenario.gripper.grasps, GRASPS),
        ("gripper.execution", scenario.gripper.execution, EXECUTIONS),
        ("gripper.carrier", scenario.gripper.carrier, CARRIERS),
    ):
        if value not in choices:
            raise ScenarioError(
                f"{source}: {key} is {value!r}: choose one of "
                f"{', '.join(choices)}"
            )
    for key, number, most in (
        ("scene.num_objects", scenario.scene.num_objects, MOST_OBJECTS),
        (
            "scene.random_number.least",
            scenario.scene.random_number.least,
            scenario.scene.random_number.most,
        ),
        (
            "scene.random_number.most",
            scenario.scene.random_number.most,
            MOST_OBJECTS,
        ),
        ("horizon", scenario.horizon, None),
    ):
        if number < 1:
            raise ScenarioError(
                f"{source}: {key} is {number}: it must be at least 1"
            )
        if most is not None and number > most:
            raise ScenarioError(
                f"{source}: {key} is {number}: it must be at most {most}"
            )
    for path in _MUST_BE_POSITIVE:
        value = operator.attrgetter(path)(scenario)
        if not value > 0:
            raise ScenarioError(
                f"{source}: {path} is {value}: it must be above 0"
            )
    if not 0 <= scenario.scene.random_number.mean <= MOST_OBJECTS:
        raise ScenarioError(
            f"{source}: scene.random_number.mean is "
            f"{scenario.scene.random_number.mean}: it must be from 0 to "
            f"{MOST_OBJECTS}"
        )
    for key, share in (
        ("scene.packaged_share", scenario.scene.packaged_share),
        ("scene.most_visible", scenario.scene.most_visible),
    ):
        if not 0 <= share <= 1:
            raise ScenarioError(
                f"{source}: {key} is {share}: it must be from 0 to 1"
            )
    if scenario.scene.packaged_share > 0 and not scenario.scene.packaged:
        raise ScenarioError(
            f"{source}: scene.packaged_share needs scene.packaged: true"
        )
    if (
        scenario.perception.segmenter == "depth"
        and scenario.gripper.grasps == "models"
    ):
        raise ScenarioError(
            f"{source}: perception.segmenter is depth, but gripper.grasps is "
            "models: of what is found in depth no model is known; choose "
            "gripper.grasps: depth"
        )
    if (
        scenario.perception.occupancy == "expected"
        and scenario.perception.exact.poses != "flat"
    ):
        raise ScenarioError(
            f"{source}: perception.exact.poses is "
            f"{scenario.perception.exact.poses}, but perception.occupancy: "
            "expected takes the target to lie flat; choose poses: flat, or "
            "occupancy: exact"
        )
    if searched:
        _check_weights(scenario.perception, scenario.camera, source)
    _check_camera(scenario.camera, source)
    if scenario.gripper.execution == "contact":
        # First: Drake's own message does not say what to choose.
        _check_contact(scenario, source)
    _check_plant(scenario.plant_config, source)
    if scenario.seed < 0:
        raise ScenarioError(
            f"{source}: seed is {scenario.seed}: it must not be negative"
        )


_MUST_BE_POSITIVE = (
    "camera.width",
    "camera.height",
    "scene.mesh_scale",
    "scene.contact.pressure_gradient",
    "scene.contact.dissipation",
    "scene.contact.tumble_time",
    "scene.heap.drop_period",
    "scene.heap.tray_length",
    "scene.heap.tray_width",
    "camera_sampling.least_radius",
    "camera_sampling.least_focal",
    "scene.heap.max_attempts",
    "scene.heap.rest_round",
    "perception.depth_segmenter.arm",
    "gripper.quasi_static.approach_time",
    "gripper.quasi_static.speed",
    "gripper.contact.speed",
    "gripper.contact.acceleration",
    "gripper.contact.lift_speed",
    "gripper.contact.approach_speed",
    "gripper.contact.touch_speed",
    "gripper.contact.give_up",
    "gripper.suction.evacuation_time",
    "plant_config.time_step",
    "gripper.parameters.opening",
    "visualization.publish_period",
)

_SCALARS: dict[type, tuple[type, ...]] = {
    int: (int,),
    float: (int, float),
    bool: (bool,),
    str: (str,),
}


class _StrictLoader(yaml.SafeLoader):
    """Rejects duplicate keys, which YAML readers accept silently."""

    # YAML 1.2's numbers: to PyYAML, 1e-3 is a string.
    yaml_implicit_resolvers: typing.ClassVar = {
        **yaml.SafeLoader.yaml_implicit_resolvers,
        **{
            first: [
                *yaml.SafeLoader.yaml_implicit_resolvers.get(first, []),
                (
                    "tag:yaml.org,2002:float",
                    re.compile(r"[-+]?(\d+(\.\d*)?|\.\d+)[eE][-+]?\d+$"),
                ),
            ]
            for first in "-+.0123456789"
        },
    }

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


def _construct_tagged(loader: _StrictLoader, tag: str, node: yaml.Node) -> dict:
    """Reads ``!Rpy {…}`` as what stands in the braces: tags are Drake's."""
    if not isinstance(node, yaml.MappingNode):
        raise yaml.constructor.ConstructorError(
            None, None, f"!{tag} must tag keys and values", node.start_mark
        )
    return loader.construct_mapping(node, deep=True)


_StrictLoader.add_multi_constructor("!", _construct_tagged)


def _check_weights(
    perception: PerceptionConfig, camera: CameraConfig, source: str
) -> None:
    if perception.occupancy in WITHOUT_NETWORK:
        return
    if camera.width % SIZE_STEP or camera.height % SIZE_STEP:
        raise ScenarioError(
            f"{source}: camera: images of {camera.width} x {camera.height}, "
            f"but a network takes multiples of {SIZE_STEP}: choose such a "
            "size, or perception.occupancy: exact"
        )
    path = weights_path(perception)
    try:
        if not path.is_dir():
            read_card(path)
    except WeightsError as error:
        raise ScenarioError(f"{source}: perception.weights: {error}") from error


def weights_path(perception: PerceptionConfig) -> Path:
    """Returns where the network's weights are."""
    given = perception.weights
    return Path(given) if given else default_weights()


def _check_camera(config: CameraConfig, source: str) -> None:
    if not config.name:
        raise ScenarioError(f"{source}: camera.name is empty")
    try:
        check_renderer(config)
        pinhole_camera(config)
    except (RuntimeError, ValueError) as error:
        message = " ".join(str(error).split())
        raise ScenarioError(f"{source}: camera: {message}") from error


def _check_plant(config: MultibodyPlantConfig, source: str) -> None:
    try:
        AddMultibodyPlant(config=config, builder=DiagramBuilder())
    except RuntimeError as error:
        message = " ".join(str(error).split())
        raise ScenarioError(f"{source}: plant_config: {message}") from error


def _check_contact(scenario: Scenario, source: str) -> None:
    """Checks what the gripper in the plant needs of it."""
    config = scenario.plant_config
    for key, value, wanted in (
        (
            "contact_model",
            config.contact_model,
            ("hydroelastic", "hydroelastic_with_fallback"),
        ),
        (
            "discrete_contact_approximation",
            config.discrete_contact_approximation,
            ("lagged", "similar", "sap"),
        ),
    ):
        if value not in wanted:
            raise ScenarioError(
                f"{source}: gripper.execution is contact, but plant_config."
                f"{key} is {value!r}: choose one of {', '.join(wanted)}"
            )


def _check_keys(tree: dict, schema: type, source: str, prefix: str) -> None:
    """Names an unknown key with its path; Drake's reader names it alone."""
    fields = _fields(schema)
    for key, value in tree.items():
        path = f"{prefix}{key}"
        if key not in fields:
            near = difflib.get_close_matches(str(key), fields, 1)
            hint = f"; did you mean {prefix}{near[0]}?" if near else ""
            raise ScenarioError(f"{source}: unknown key {path}{hint}")
        kind = fields[key]
        if dataclasses.is_dataclass(kind) or hasattr(kind, "__fields__"):
            if not isinstance(value, dict):
                raise ScenarioError(
                    f"{source}: {path} is {value!r}: it must be keys and values"
                )
            _check_keys(value, kind, source, f"{path}.")
        elif typing.get_origin(kind) is list:
            if not isinstance(value, list):
                raise ScenarioError(
                    f"{source}: {path} is {value!r}: it must be a list"
                )
        elif kind in _SCALARS:
            wrong = isinstance(value, bool) and kind is not bool
            if wrong or not isinstance(value, _SCALARS[kind]):
                raise ScenarioError(
                    f"{source}: {path} is {value!r}: it must be of type "
                    f"{kind.__name__}"
                )


def _fields(schema: type) -> dict[str, typing.Any]:
    """Returns the fields of a dataclass or of one of Drake's configs.

    The types of the latter are not all known to Python: None stands for them.
    """
    if dataclasses.is_dataclass(schema):
        hints = typing.get_type_hints(schema)
        return {f.name: hints[f.name] for f in dataclasses.fields(schema)}
    return {f.name: None for f in schema.__fields__}  # type: ignore[attr-defined]
