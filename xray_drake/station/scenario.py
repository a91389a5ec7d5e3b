"""The scenario: one YAML file says all that a search depends on."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import Any

from pydrake.common.yaml import yaml_dump, yaml_load_typed
from pydrake.multibody.plant import MultibodyPlantConfig
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
    MESH_TIME_LIMIT,
    OCCUPANCIES,
    SEGMENTERS,
    TALL_TARGETS,
    TARGET_NAMES,
    WITHOUT_NETWORK,
    current_occupancy,
)
from xray_drake.configuration import (
    SEEDS,
    ConfigurationError,
    check,
    check_tree,
    choice,
    count,
    differences,
    fields_of,
    number,
    path_field,
    path_list,
    read_text,
    read_tree,
    tree_of,
    with_paths,
    write_tree,
)
from xray_drake.faults import BREAKDOWNS
from xray_drake.grasping.evidence.depth import DepthPlannerConfig
from xray_drake.grasping.evidence.model import ModelPlannerConfig
from xray_drake.grasping.gripper_geometry import GripperParameters
from xray_drake.gripper.actuation.contact import ExecutionConfig
from xray_drake.gripper.actuation.ideal import QuasiStaticConfig
from xray_drake.gripper.suction import SuctionConfig
from xray_drake.occupancy.geometric.config import (
    GeometricConfig,
    check_label,
)
from xray_drake.occupancy.learned.fcn_resnet50 import SIZE_STEP
from xray_drake.occupancy.learned.inference import default_weights
from xray_drake.occupancy.learned.weights import WeightsError, read_card
from xray_drake.perception.depth_noise import DepthNoise
from xray_drake.perception.depth_segmenter import DepthSegmenterConfig
from xray_drake.perception.hsv_target import HsvTargetConfig
from xray_drake.policy.registry import POLICIES, PolicyError
from xray_drake.resources import models_dir
from xray_drake.scene.cameras import (
    CameraSampling,
    check_renderer,
    check_view,
    nominal_camera,
)
from xray_drake.scene.contact import ContactConfig
from xray_drake.scene.heap import HeapConfig
from xray_drake.scene.plant import add_plant, default_plant_config
from xray_drake.splits import SPLITS
from xray_drake.station.drake_rules import (
    CONTACT_APPROXIMATIONS,
    CONTACT_MODELS,
    DRAKE_RULES,
    IN_ORDER,
)

MOST_OBJECTS = 100
"""Distractors that a scenario may ask for."""

_OBJECTS = f"[1, {MOST_OBJECTS}]"


ScenarioError = ConfigurationError
"""A scenario that cannot be used; the message is one line."""


@dataclass(slots=True)
class RandomNumber:
    """How many distractors: Poisson, truncated (paper section IV.A)."""

    # Mean before truncation; at 0 the number is not random.
    mean: float = number(0.0, f"[0, {MOST_OBJECTS}]")
    # Least and most.
    least: int = count(10, _OBJECTS)
    most: int = count(15, _OBJECTS)


@dataclass(slots=True)
class SceneConfig:
    """What lies in the bin."""

    # Name of the target: one of TARGET_NAMES or TALL_TARGETS in
    # xray_drake.choices.
    target: str = choice("box_2to1", (*TARGET_NAMES, *TALL_TARGETS))
    # How many distractors are dropped on it.
    num_objects: int = count(14, _OBJECTS)
    # Or their number is drawn anew for each heap.
    random_number: RandomNumber = field(default_factory=RandomNumber)
    # Which of the procedural distractors: "train", "validation" or "test".
    split: str = choice("train", SPLITS)
    # Those that come on a backing card as well are drawn from, too.
    packaged: bool = False
    # Share of packaged objects among those drawn; at 0 as many as there are.
    packaged_share: float = number(0.0, "[0, 1]")
    # Folders of meshes that replace the procedural distractors.
    meshes: list[str] = path_list()
    # Factor from the meshes' unit to metres.
    mesh_scale: float = number(1.0, "(0, 1000000]")
    # s that preparing one of the meshes may take; it is left out if it takes
    # longer.
    mesh_time_limit: float = number(MESH_TIME_LIMIT, "(0, 1000000]")
    # A heap whose target starts more visible than this is drawn again; at 1
    # all heaps count.
    most_visible: float = number(1.0, "[0, 1]")
    # How they are dropped.
    heap: HeapConfig = field(default_factory=HeapConfig)
    # Their material.
    contact: ContactConfig = field(default_factory=ContactConfig)


@dataclass(slots=True)
class PerceptionConfig:
    """Which perception systems look at the images."""

    # Finds the target's modal mask: "ground_truth", or "hsv" by its colour.
    detector: str = choice("ground_truth", DETECTORS)
    # Finds the modal masks of all objects: "ground_truth", or "depth" by the
    # shape of what is seen.
    segmenter: str = choice("ground_truth", SEGMENTERS)
    # The depth image is as a real sensor gives it.
    noise: bool = False
    # Infers the occupancy distribution: "learned" by a network; "posterior",
    # by a network too, but as probable as heaps have taught it; "geometric", by
    # counting all poses that explain the image; or "geometric_label", by what
    # those poses say of the paper's label.
    occupancy: str = choice("learned", OCCUPANCIES)
    # File of a network's weights, or a folder of networks of one box each; by
    # default the one that travels with the package.
    weights: str = path_field()
    # What the network computes in: "float32", or "bfloat16", which is faster
    # where the processor has instructions for it, but not the same search.
    dtype: str = choice(DTYPES[0], DTYPES)
    # Settings of "geometric" and "geometric_label".
    geometric: GeometricConfig = field(default_factory=GeometricConfig)
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

    # One of POLICIES in xray_drake.policy.registry, or module:object.
    name: str = "xray"
    # Grasp the target as soon as a grasp on it exists.
    target_first: bool = True
    # Objects with fewer visible pixels are not candidates.
    min_visible_pixels: int = count(50, "[0, 100000000]")
    # A weaker grasp counts only where no candidate that hides anything has one
    # as good as this.
    min_grasp_quality: float = number(0.2, "[0, 1]")


@dataclass(slots=True)
class GripperConfig:
    """How grasps are planned and executed."""

    # How grasps are planned: "models", from the objects' models and poses, or
    # "depth", from the depth image alone.
    grasps: str = choice("models", GRASPS)
    # How grasps are executed: "quasi_static", where an ideal gripper lifts what
    # the analysis says would hold; or "contact", with fingers and suction cup.
    execution: str = choice("quasi_static", EXECUTIONS)
    # What carries the gripper of "contact": "wrist", three slides and three
    # turns; or "arm", seven turning joints that do not reach everywhere.
    carrier: str = choice("wrist", CARRIERS)
    # What the gripper can do.
    parameters: GripperParameters = field(default_factory=GripperParameters)
    # How "models" searches for grasps.
    planner: ModelPlannerConfig = field(default_factory=ModelPlannerConfig)
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
    # The overhead camera. Its images are rendered when they are looked at:
    # fps, rgb, depth and label say nothing here.
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

    def __reduce__(self) -> tuple[Any, tuple[str]]:
        """Pickles it as YAML: Drake's structs cannot be pickled."""
        return _from_yaml, (yaml_dump(tree_of(self)),)


def _from_yaml(text: str) -> Scenario:
    return yaml_load_typed(schema=Scenario, data=text)


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
    return parse_scenario(
        read_text(path), str(path), searched=searched, folder=path.parent
    )


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
    tree = _renamed(read_tree(text, source))
    check_tree(tree, Scenario, source, DRAKE_RULES)
    try:
        scenario = _from_yaml(yaml_dump(tree))
    except Exception as error:
        why = " ".join(str(error).split())
        raise ScenarioError(f"{source}: {why}") from error
    if folder is not None:
        scenario = with_paths(scenario, folder)
    check_scenario(scenario, source, searched=searched)
    return scenario


def _renamed(tree: dict[str, Any]) -> dict[str, Any]:
    """Gives what version 0.1 called otherwise its name of today, in place."""
    perception = tree.get("perception")
    if isinstance(perception, dict):
        name = perception.get("occupancy")
        if isinstance(name, str):
            perception["occupancy"] = current_occupancy(name)
        if "exact" in perception and "geometric" not in perception:
            perception["geometric"] = perception.pop("exact")
    return tree


def dump_scenario(scenario: Scenario) -> str:
    """Returns YAML that holds what differs from the defaults.

    Defaults are left out, since Drake's own configs gain and lose fields from
    version to version.
    """
    return write_tree(differences(tree_of(scenario), tree_of(Scenario())))


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
            network's weights be there and fit the camera. What was recorded
            elsewhere can be read, and heaps be dropped, without.

    Raises:
        ScenarioError: a choice that does not exist or a number out of range.
    """
    check(scenario, source, DRAKE_RULES)
    for said in _conflicts(scenario, searched=searched):
        raise ScenarioError(f"{source}: {said}")


_UNUSED = {
    "camera": ("capture_offset", "output_delay"),
    "visualization": tuple(
        name
        for name in fields_of(VisualizationConfig)
        if name != "publish_period"
    ),
}
"""Of Drake's structs, what would change a search or its pictures elsewhere."""


def _conflicts(scenario: Scenario, *, searched: bool) -> Iterator[str]:
    """Yields what does not go together, each in one line."""
    usual, perception = Scenario(), scenario.perception
    for owner, names in _UNUSED.items():
        for name in names:
            path = f"{owner}.{name}"
            given, default = (attrgetter(path)(s) for s in (scenario, usual))
            if given != default:
                yield (
                    f"{path} is {given}, which nothing here looks at: leave "
                    "it out"
                )
    for low, high in IN_ORDER:
        least, most = (attrgetter(path)(scenario) for path in (low, high))
        if least > most:
            yield f"{low} is {least}: it must be at most {most}, {high}"
    if perception.occupancy == "geometric_label":
        label = perception.geometric
        yield from _refused("perception.", ValueError, check_label, label)
        if label.poses != "flat":
            yield (
                f"perception.geometric.poses is {label.poses}, but "
                "perception.occupancy: geometric_label takes the target to lie "
                "flat; choose poses: flat, or occupancy: geometric"
            )
    if scenario.scene.packaged_share > 0 and not scenario.scene.packaged:
        yield "scene.packaged_share needs scene.packaged: true"
    if perception.segmenter == "depth" and scenario.gripper.grasps == "models":
        yield (
            "perception.segmenter is depth, but gripper.grasps is models: of "
            "what is found in depth no model is known; choose gripper.grasps: "
            "depth"
        )
    if not scenario.camera.name:
        yield "camera.name is empty"
    if searched:
        name = scenario.policy.name
        yield from _refused(
            "policy.name: ", PolicyError, POLICIES.__getitem__, name
        )
        yield from _unfit_weights(perception, scenario.camera)
    for checked in (check_renderer, check_view):
        yield from _refused(
            "camera: ", (*BREAKDOWNS, ValueError), checked, scenario.camera
        )
    if scenario.gripper.execution == "contact":
        # First: Drake's own message does not say what to choose.
        yield from _unfit_for_contact(scenario, usual)
    plant = DiagramBuilder(), scenario.plant_config
    yield from _refused("plant_config: ", BREAKDOWNS, add_plant, *plant)


def _refused(
    prefix: str,
    kinds: type[Exception] | tuple[type[Exception], ...],
    function: Callable[..., object],
    *arguments: object,
) -> Iterator[str]:
    """Yields, in one line, what a function says that refuses its arguments."""
    try:
        function(*arguments)
    except kinds as error:
        yield prefix + " ".join(str(error).split())


def _unfit_weights(
    perception: PerceptionConfig, camera: CameraConfig
) -> Iterator[str]:
    if perception.occupancy in WITHOUT_NETWORK:
        return
    if camera.width % SIZE_STEP or camera.height % SIZE_STEP:
        yield (
            f"camera: images of {camera.width} x {camera.height}, "
            f"but a network takes multiples of {SIZE_STEP}: choose such a "
            "size, or perception.occupancy: geometric"
        )
    path = weights_path(perception)
    if not path.is_dir():
        yield from _refused(
            "perception.weights: ", WeightsError, read_card, path
        )


def weights_path(perception: PerceptionConfig) -> Path:
    """Returns where the network's weights are."""
    given = perception.weights
    return Path(given) if given else default_weights()


def _unfit_for_contact(scenario: Scenario, usual: Scenario) -> Iterator[str]:
    """Yields what does not suit the gripper in the plant."""
    for name in ("pad_width", "pad_height"):
        path = f"gripper.parameters.{name}"
        given, built = (attrgetter(path)(s) for s in (scenario, usual))
        if given != built:
            yield (
                f"gripper.execution is contact, but {path} is "
                f"{given}: the gripper in the plant has {built}"
            )
    for key, wanted in (
        ("contact_model", CONTACT_MODELS[1:]),
        ("discrete_contact_approximation", CONTACT_APPROXIMATIONS[1:]),
    ):
        value = getattr(scenario.plant_config, key)
        if value not in wanted:
            yield (
                f"gripper.execution is contact, but plant_config."
                f"{key} is {value!r}: choose one of {', '.join(wanted)}"
            )
