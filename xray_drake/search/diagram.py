"""Builds the whole search as one Diagram."""

from collections.abc import Callable

from pydrake.geometry import Meshcat
from pydrake.systems.framework import Diagram, DiagramBuilder, System

from xray_drake.grasping.depth_planner import DepthGraspPlanner
from xray_drake.grasping.planner import ModelGraspPlanner
from xray_drake.occupancy.exact import ExactInference
from xray_drake.occupancy.learned import load_inference
from xray_drake.occupancy.system import OccupancyInference, OccupancyModel
from xray_drake.policy.choice_system import ChoicePolicy
from xray_drake.policy.memory import MemoryConfig, TargetMemory
from xray_drake.policy.memory_system import SearchMemory
from xray_drake.policy.policies import POLICIES, Policy
from xray_drake.policy.ranking import RANKINGS
from xray_drake.policy.system import DepthGrasps, Foresight, SearchPolicy
from xray_drake.policy.true_target import TrueTargetMask
from xray_drake.scene.heap import Heap
from xray_drake.scene.object_model import ObjectModel
from xray_drake.search.execution import add_execution
from xray_drake.search.grasped_body import GraspedBody
from xray_drake.search.perception import add_perception
from xray_drake.station.heap_station import StationParts, build_heap_station
from xray_drake.station.objects import make_heap
from xray_drake.station.scenario import (
    Scenario,
    check_scenario,
    weights_path,
)

AGENT = "agent"
"""What the record calls the policy where an agent chooses."""

_Output = tuple[System, str]
_Wire = tuple[System, str, System, str]


class SearchDiagram(Diagram):
    """A search as a Diagram that remembers what it was built from.

    Made by :func:`build_search_diagram`.

    Attributes:
        scenario: as given.
        heap: what lies in the bin in the default context.
        station: plant, scene graph and objects.
        meshcat: as given.
        agent: as given.
    """

    scenario: Scenario
    heap: Heap
    station: StationParts
    meshcat: Meshcat | None
    agent: bool


def build_search_diagram(
    scenario: Scenario,
    *,
    heap: Heap | None = None,
    meshcat: Meshcat | None = None,
    progress: Callable[[float], None] | None = None,
    agent: bool = False,
) -> SearchDiagram:
    """Builds station, perception, inference, policy and gripper.

    Every box is a named system: ``heap_station``, ``target_detector``,
    ``instance_segmenter``, ``occupancy_inference``, ``search_policy``,
    ``gripper_controller``. With noise, ``depth_sensor`` stands between the
    camera and all who read depth. With execution by contact, ``suction_cup``
    and ``rest_sensor`` stand between the station and the gripper. Policies that
    need them add ``search_memory`` between camera and inference, or
    ``true_target``. Where grasps are planned from depth, ``grasped_body``
    stands between policy and gripper. The outputs of all are exported as
    ``box.port``, and so are the station's images and its ground truth
    (``cheat.…``). In the default context the heap is at rest and nothing has
    been decided.

    Args:
        scenario: what to build.
        heap: what lies in the bin; by default it is dropped here, which takes
            some seconds.
        meshcat: shows the station, if given.
        progress: told the share of the drop that is done.
        agent: an agent chooses each object in place of the scenario's ranking:
            the policy is a
            :class:`~xray_drake.policy.choice_system.ChoicePolicy`, whose input
            is exported as ``search_policy.choice``. All else is the same.

    Raises:
        ScenarioError: a scenario that cannot be used.
        HeapError: heap after heap failed.
    """
    check_scenario(scenario)
    if heap is None:
        heap = make_heap(scenario, progress=progress)
    builder = DiagramBuilder()
    station, parts = build_heap_station(scenario, heap, meshcat=meshcat)
    builder.AddSystem(station)
    camera = scenario.camera
    kind = (
        Policy(RANKINGS["largest"]) if agent else POLICIES[scenario.policy.name]
    )
    target = heap.target
    bodies = {
        name: int(item.body.index()) for name, item in parts.objects.items()
    }

    perception = add_perception(
        builder, scenario, station, parts.labels, target.name
    )
    detector, segmenter = perception.detector, perception.segmenter
    inference = _inference(scenario, target)
    occupancy = builder.AddSystem(
        OccupancyInference(
            inference=inference,
            width=camera.width,
            height=camera.height,
        )
    )
    planner = ModelGraspPlanner(
        heap.models,
        parameters=scenario.gripper.parameters,
        config=scenario.gripper.planner,
        seed=scenario.seed,
    )
    from_depth = scenario.gripper.grasps == "depth"
    build_policy = ChoicePolicy if agent else SearchPolicy
    policy = builder.AddSystem(
        build_policy(
            ranking=kind.ranking,
            planner=_depth_grasps(scenario) if from_depth else planner,
            bodies=bodies,
            target_first=scenario.policy.target_first,
            min_visible_pixels=scenario.policy.min_visible_pixels,
            min_grasp_quality=scenario.policy.min_grasp_quality,
            foresight=Foresight(
                inference, target.extents, camera.width, camera.height
            )
            if kind.outlook
            else None,
            truth=kind.truth,
            seed=scenario.seed,
        )
    )
    execution = add_execution(builder, scenario, station, parts, heap, planner)
    gripper = execution.controller

    name = camera.name
    depth: _Output = perception.depth
    boxes = [*perception.boxes, occupancy, policy, *execution.boxes]
    wires: list[_Wire] = []
    if kind.memory:
        memory = builder.AddSystem(
            SearchMemory(
                memory=TargetMemory(
                    target.extents,
                    MemoryConfig(
                        floor=scenario.perception.exact.floor,
                        names_last=scenario.perception.segmenter != "depth",
                    ),
                ),
                width=camera.width,
                height=camera.height,
            )
        )
        boxes.append(memory)
        wires += [
            (*depth, memory, "depth_image"),
            (detector, "target_mask", memory, "target_mask"),
            (segmenter, "instances", memory, "instances"),
            (station, f"{name}.camera", memory, "camera"),
            (policy, "action", memory, "action"),
            (gripper, "status", memory, "status"),
        ]
        depth = memory, "depth_image"
    if kind.outlook:
        wires.append((*depth, policy, "depth_image"))
    if kind.truth:
        truth = builder.AddSystem(
            TrueTargetMask(target=target, body=bodies[target.name])
        )
        boxes.append(truth)
        wires += [
            (station, "cheat.body_poses", truth, "body_poses"),
            (station, f"{name}.camera", truth, "camera"),
            (truth, "target_mask", policy, "true_target"),
        ]
    decided: _Output = policy, "action"
    if from_depth:
        body = builder.AddSystem(
            GraspedBody(
                labels=parts.labels,
                bodies=bodies,
                parameters=scenario.gripper.parameters,
                width=camera.width,
                height=camera.height,
            )
        )
        boxes.append(body)
        wires += [
            (*perception.depth, policy, "seen_depth_image"),
            (*decided, body, "action"),
            (station, "cheat.body_poses", body, "body_poses"),
            *(
                (station, f"{name}.{port}", body, port)
                for port in ("label_image", "depth_image", "camera")
            ),
        ]
        decided = body, "action"
    else:
        wires.append((station, "cheat.body_poses", policy, "body_poses"))
    if from_depth or kind.outlook:
        wires.append((station, f"{name}.camera", policy, "camera"))
    wires += [
        (*depth, occupancy, "depth_image"),
        (station, f"{name}.camera", occupancy, "camera"),
        (detector, "target_mask", occupancy, "target_mask"),
        (detector, "target_mask", policy, "target_mask"),
        (segmenter, "instances", policy, "instances"),
        (occupancy, "occupancy", policy, "occupancy"),
        (gripper, "status", policy, "status"),
        (*decided, gripper, "action"),
    ]
    for source, output, drain, port in wires:
        builder.Connect(source.GetOutputPort(output), drain.GetInputPort(port))
    if agent:
        builder.ExportInput(
            policy.GetInputPort("choice"), "search_policy.choice"
        )
    for box in boxes:
        _export_outputs(builder, box, f"{box.get_name()}.")
    _export_outputs(builder, station, "")

    diagram = SearchDiagram()
    builder.BuildInto(diagram)
    diagram.set_name("search")
    diagram.scenario = scenario
    diagram.heap = heap
    diagram.station = parts
    diagram.meshcat = meshcat
    diagram.agent = agent
    return diagram


def _inference(scenario: Scenario, target: ObjectModel) -> OccupancyModel:
    perception = scenario.perception
    if perception.occupancy == "exact":
        return ExactInference(target, perception.exact)
    return load_inference(
        weights_path(perception),
        target_size=target.extents,
        output="posterior"
        if perception.occupancy == "posterior"
        else "occupancy",
    )


def _depth_grasps(scenario: Scenario) -> DepthGrasps:
    gripper, camera = scenario.gripper, scenario.camera
    return DepthGrasps(
        DepthGraspPlanner(
            parameters=gripper.parameters,
            config=gripper.depth_planner,
            seed=scenario.seed,
        ),
        camera.width,
        camera.height,
    )


def _export_outputs(
    builder: DiagramBuilder, system: System, prefix: str
) -> None:
    for index in range(system.num_output_ports()):
        output = system.get_output_port(index)
        builder.ExportOutput(output, f"{prefix}{output.get_name()}")
