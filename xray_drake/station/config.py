"""The parts of a scenario: scene, perception, policy, gripper."""

from collections.abc import Iterator
from dataclasses import dataclass, field

from xray_drake.choices import (
    CARRIERS,
    DETECTORS,
    DTYPES,
    EXECUTIONS,
    GRASPS,
    MESH_TIME_LIMIT,
    OCCUPANCIES,
    SEGMENTERS,
)
from xray_drake.configuration import (
    choice,
    count,
    in_order,
    number,
    number_list,
    path_field,
    path_list,
    path_or_name,
)
from xray_drake.grasping.evidence.depth import DepthPlannerConfig
from xray_drake.grasping.evidence.model import ModelPlannerConfig
from xray_drake.gripper.actuation.contact import ExecutionConfig
from xray_drake.gripper.actuation.ideal import QuasiStaticConfig
from xray_drake.gripper.suction import SuctionConfig
from xray_drake.occupancy.geometric.config import (
    GeometricConfig,
)
from xray_drake.perception.depth_noise import DepthNoise
from xray_drake.perception.depth_segmenter import DepthSegmenterConfig
from xray_drake.perception.hsv_target import HsvTargetConfig
from xray_drake.scene.contact import ContactConfig
from xray_drake.scene.heap import HeapConfig
from xray_drake.scene.meshes.formats import FORMATS
from xray_drake.scene.targets import target_complaint
from xray_drake.splits import SPLITS

MOST_OBJECTS = 100
"""Distractors that a scenario may ask for."""

_OBJECTS = f"[1, {MOST_OBJECTS}]"


@dataclass(slots=True)
class RandomNumber:
    """How many distractors: Poisson, truncated (paper section IV.A)."""

    # Mean before truncation; at 0 the number is not random.
    mean: float = number(0.0, f"[0, {MOST_OBJECTS}]")
    # Least and most.
    least: int = count(10, _OBJECTS)
    most: int = count(15, _OBJECTS)

    def complaints(self) -> Iterator[str]:
        """Yields what is wrong between its fields."""
        yield from in_order(self, "least", "most")


@dataclass(slots=True)
class SceneConfig:
    """What lies in the bin."""

    # The target: one of TARGET_NAMES or TALL_TARGETS in xray_drake.choices, a
    # mesh file, or the size of a box, as in 70x40x12mm.
    target: str = path_or_name("box_2to1", FORMATS)
    # Of a target that is a file: factor from its unit to metres.
    target_scale: float = number(1.0, "(0, 1000000]")
    # The target's mass, kg; 0 stands for 600 kg/m³.
    target_mass: float = number(0.0, "[0, 100]")
    # Its colour, red, green, blue; none stands for red.
    target_color: list[float] = number_list((), "[0, 1]", (0, 3))
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
    # A heap file in place of all of these; its own target, too.
    heap_file: str = path_field()
    # A heap whose target starts more visible than this is drawn again; at 1
    # all heaps count.
    most_visible: float = number(1.0, "[0, 1]")
    # How they are dropped.
    heap: HeapConfig = field(default_factory=HeapConfig)
    # Their material.
    contact: ContactConfig = field(default_factory=ContactConfig)

    def complaints(self) -> Iterator[str]:
        """Yields what is wrong with single fields."""
        if said := target_complaint(self.target):
            yield f"target is {self.target!r}: {said}"
        if self.heap_file:
            usual = SceneConfig()
            for name in ("target", "target_mass", "target_color", "meshes"):
                if getattr(self, name) != getattr(usual, name):
                    yield (
                        f"{name} is given beside heap_file, which has its own: "
                        "leave one of them out"
                    )
        if self.packaged_share > 0 and not self.packaged:
            yield "packaged_share needs packaged: true"


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
    # Images are reduced to this share of their sides before the target is
    # looked for in them; 0 reduces those wider than 640 pixels to that.
    scale: float = number(0.0, "[0, 1]")
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
