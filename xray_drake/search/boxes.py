"""What a scenario chooses to see and to decide with, as boxes of a diagram."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydrake.systems.framework import OutputPort

from xray_drake.grasping.evidence.depth import DepthEvidence
from xray_drake.grasping.planner import GraspPlanner
from xray_drake.occupancy.inference import make_inference
from xray_drake.occupancy.observation import OccupancyModel
from xray_drake.occupancy.scaled import usual_scale
from xray_drake.occupancy.system import OccupancyInference
from xray_drake.perception.systems import (
    DepthInstanceSegmenter,
    GroundTruthInstanceSegmenter,
    GroundTruthTargetDetector,
    HsvTargetDetector,
    NoisyDepthSensor,
)
from xray_drake.policy.beyond.memory import TargetMemory
from xray_drake.policy.beyond.memory_system import SearchMemory
from xray_drake.policy.choice_system import ChoicePolicy
from xray_drake.policy.planning import Poses
from xray_drake.policy.ranking import largest
from xray_drake.policy.registry import POLICIES, Policy
from xray_drake.policy.system import Foresight, SearchPolicy
from xray_drake.policy.true_target import TrueTargetMask
from xray_drake.scene.heap import Heap
from xray_drake.scene.object_model import ObjectModel
from xray_drake.scene.targets import size_in_any_pose
from xray_drake.search.grasped_body import GraspedBody
from xray_drake.search.wiring import Boxes
from xray_drake.station.heap_station import StationParts
from xray_drake.station.scenario import Scenario, weights_path


@dataclass(frozen=True, eq=False)
class SearchParts:
    """What a system that takes a box's place may be built from.

    Attributes:
        scenario: of the search.
        heap: what lies in the bin in the default context.
        station: plant, scene graph and objects.
        planner: plans grasps from the objects' models.
    """

    scenario: Scenario
    heap: Heap
    station: StationParts
    planner: GraspPlanner[Poses]

    @property
    def bodies(self) -> Mapping[str, int]:
        """Object name to its index in ``body_poses``."""
        return self.station.labels

    @property
    def image_size(self) -> dict[str, int]:
        """Width and height of the camera's images, pixels."""
        camera = self.scenario.camera
        return {"width": camera.width, "height": camera.height}


def add_perception(boxes: Boxes, inside: SearchParts) -> None:
    """Adds ``target_detector`` and ``instance_segmenter``.

    Before them ``depth_sensor``, where the scenario wants noise.

    Args:
        boxes: given the camera's images.
        inside: of the search.

    Raises:
        ValueError: a box that takes another's place does not fit.
    """
    scenario, labels = inside.scenario, inside.station.labels
    config, size = scenario.perception, inside.image_size
    if config.noise:
        boxes.add(
            lambda: NoisyDepthSensor(
                noise=config.depth_noise, seed=scenario.seed, **size
            ),
            "depth_image",
        )
    boxes.add(
        lambda: (
            HsvTargetDetector(config=config.hsv, **size)
            if config.detector == "hsv"
            else GroundTruthTargetDetector(
                target_label=labels[inside.heap.target.name]
            )
        ),
        "target_mask",
        name="target_detector",
    )
    boxes.add(
        lambda: (
            DepthInstanceSegmenter(
                bin_=scenario.cell.bin,
                config=config.depth_segmenter,
                **size,
            )
            if config.segmenter == "depth"
            else GroundTruthInstanceSegmenter(labels=labels)
        ),
        "instances",
        name="instance_segmenter",
    )


def add_decision(
    boxes: Boxes,
    inside: SearchParts,
    truth: Mapping[str, OutputPort],
    status: OutputPort,
    *,
    agent: bool,
) -> OutputPort:
    """Adds ``occupancy_inference`` and ``search_policy``.

    Beside them what the policy needs: ``search_memory``, ``true_target``; and
    ``grasped_body`` where grasps are planned from depth.

    Args:
        boxes: given what perception sees.
        inside: of the search.
        truth: images without noise, and ``body_poses``.
        status: of the gripper.
        agent: an agent chooses.

    Returns:
        The action, for the gripper.

    Raises:
        ValueError: a box that takes another's place does not fit.
    """
    scenario, target = inside.scenario, inside.heap.target
    size = inside.image_size
    # Whoever else decides needs nothing beside what all policies see.
    others = agent or "search_policy" in boxes.replaced
    kind = Policy(largest) if others else POLICIES[scenario.policy.name]
    inference = _inference(scenario, target)
    seen = dict(boxes.known)
    boxes.known["body_poses"] = truth["body_poses"]
    if kind.memory:
        memory = boxes.add(
            lambda: SearchMemory(memory=_memory(inside), **size),
            "depth_image",
            sources=seen | {"status": status},
            later=["action"],
        )
    boxes.add(
        lambda: OccupancyInference(inference=inference, **size),
        "occupancy",
        name="occupancy_inference",
    )
    boxes.known |= {"seen_depth_image": seen["depth_image"], "status": status}
    if kind.truth:
        body = inside.bodies[target.name]
        boxes.add(
            lambda: TrueTargetMask(target=target, body=body),
            "target_mask",
            known_as="true_target",
            sources=truth,
        )
    policy = boxes.add(
        lambda: _policy(inside, kind, inference, agent=agent),
        "action",
        name="search_policy",
        later=["choice"] if agent else [],
    )
    action = policy.GetOutputPort("action")
    if kind.memory:
        boxes.builder.Connect(action, memory.GetInputPort("action"))
    if agent:
        boxes.builder.ExportInput(
            policy.GetInputPort("choice"), "search_policy.choice"
        )
    if scenario.gripper.grasps == "depth":
        action = _add_grasped_body(boxes, inside, {**truth, "action": action})
    return action


def _add_grasped_body(
    boxes: Boxes, inside: SearchParts, sources: Mapping[str, OutputPort]
) -> OutputPort:
    """Returns the action with the name of the body under its grasp."""
    body = boxes.add(
        lambda: GraspedBody(
            bodies=inside.bodies,
            gripper=inside.scenario.cell.gripper.spec,
            **inside.image_size,
        ),
        "action",
        sources=sources,
    )
    return body.GetOutputPort("action")


def _policy(
    inside: SearchParts, kind: Policy, inference: OccupancyModel, *, agent: bool
) -> SearchPolicy:
    scenario = inside.scenario
    gripper, config = scenario.gripper, scenario.policy
    planner: GraspPlanner[Any] = inside.planner
    from_depth = gripper.grasps == "depth"
    if from_depth:
        planner = GraspPlanner(
            DepthEvidence(
                bin_=scenario.cell.bin,
                gripper=scenario.cell.gripper.spec,
                config=gripper.depth_planner,
                seed=scenario.seed,
            )
        )
    foresight = Foresight(inference, size_in_any_pose(inside.heap.target))
    return (ChoicePolicy if agent else SearchPolicy)(
        ranking=kind.ranking,
        planner=planner,
        bodies=None if from_depth else inside.bodies,
        target_first=config.target_first,
        min_visible_pixels=config.min_visible_pixels,
        min_grasp_quality=config.min_grasp_quality,
        foresight=foresight if kind.outlook else None,
        truth=kind.truth,
        seed=scenario.seed,
        **inside.image_size,
    )


def _memory(inside: SearchParts) -> TargetMemory:
    perception = inside.scenario.perception
    return TargetMemory(
        size_in_any_pose(inside.heap.target),
        inside.scenario.cell.bin.floor,
        names_last=perception.segmenter != "depth",
    )


def _inference(scenario: Scenario, target: ObjectModel) -> OccupancyModel:
    perception = scenario.perception
    return make_inference(
        perception.occupancy,
        target,
        floor=scenario.cell.bin.floor,
        geometric=perception.geometric,
        weights=weights_path(perception),
        dtype=perception.dtype,
        scale=perception.scale or usual_scale(scenario.camera.width),
    )
