"""Builds the whole search as one Diagram."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from pydrake.geometry import Meshcat
from pydrake.systems.framework import Diagram, DiagramBuilder, System

from xray_drake.grasping.depth_planner import DepthGraspPlanner
from xray_drake.grasping.planner import ModelGraspPlanner
from xray_drake.occupancy.geometric.expected import ExpectedLabel
from xray_drake.occupancy.geometric.inference import exact_model
from xray_drake.occupancy.learned.inference import load_inference
from xray_drake.occupancy.system import OccupancyInference, OccupancyModel
from xray_drake.policy.beyond.memory import MemoryConfig, TargetMemory
from xray_drake.policy.beyond.memory_system import SearchMemory
from xray_drake.policy.choice_system import ChoicePolicy
from xray_drake.policy.ranking import largest
from xray_drake.policy.registry import POLICIES, Policy
from xray_drake.policy.system import DepthGrasps, Foresight, SearchPolicy
from xray_drake.policy.true_target import TrueTargetMask
from xray_drake.scene.heap import Heap
from xray_drake.scene.object_model import ObjectModel
from xray_drake.scene.targets import size_in_any_pose
from xray_drake.search.execution import add_execution
from xray_drake.search.grasped_body import GraspedBody
from xray_drake.search.perception import add_perception
from xray_drake.search.wiring import check_output, connect_inputs
from xray_drake.station.heap_station import StationParts, build_heap_station
from xray_drake.station.objects import make_heap
from xray_drake.station.scenario import (
    Scenario,
    check_scenario,
    weights_path,
)

AGENT = "agent"
"""What the record calls the policy where an agent chooses."""

REPLACEABLE = {
    "target_detector": "target_mask",
    "instance_segmenter": "instances",
    "occupancy_inference": "occupancy",
    "search_policy": "action",
}
"""The boxes that can be replaced, and the output that each must have."""


@dataclass(frozen=True, eq=False)
class SearchParts:
    """What a system that takes a box's place may be built from.

    Attributes:
        scenario: of the search.
        heap: what lies in the bin in the default context.
        station: plant, scene graph and objects.
        bodies: object name to its index in ``body_poses``.
        planner: plans grasps from the objects' models.
    """

    scenario: Scenario
    heap: Heap
    station: StationParts
    bodies: Mapping[str, int]
    planner: ModelGraspPlanner


Replacement = Callable[[SearchParts], System]


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
    replace: Mapping[str, Replacement] | None = None,
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
        replace: name of a box, of ``REPLACEABLE``, to a function that builds
            the system that takes its place. Its inputs are connected by their
            names, whichever it has: ``color_image``, ``depth_image``,
            ``label_image``, ``camera``; ``target_mask`` but for the detector;
            for inference and policy ``instances`` and ``body_poses`` (ground
            truth), and for the policy ``occupancy`` and ``status``.

    Raises:
        ValueError: a box that cannot be replaced, or a system that does not fit
            in its place.
        ScenarioError: a scenario that cannot be used.
        HeapError: heap after heap failed.
    """
    check_scenario(scenario)
    replace = replace or {}
    _check_replaced(replace, agent=agent)
    if heap is None:
        heap = make_heap(scenario, progress=progress)
    builder = DiagramBuilder()
    station, parts = build_heap_station(scenario, heap, meshcat=meshcat)
    builder.AddSystem(station)
    camera, target = scenario.camera, heap.target
    bodies = {
        name: int(item.body.index()) for name, item in parts.objects.items()
    }
    planner = ModelGraspPlanner(
        heap.models,
        parameters=scenario.gripper.parameters,
        config=scenario.gripper.planner,
        seed=scenario.seed,
    )
    inside = SearchParts(scenario, heap, parts, bodies, planner)
    replaced = {
        name: _replacement(name, build, inside)
        for name, build in replace.items()
    }
    # Whoever else decides needs nothing beside what all policies see.
    kind = POLICIES[scenario.policy.name]
    if agent or "search_policy" in replaced:
        kind = Policy(largest)

    perception = add_perception(
        builder,
        scenario,
        station,
        parts.labels,
        target.name,
        detector=replaced.get("target_detector"),
        segmenter=replaced.get("instance_segmenter"),
    )
    inference = _inference(scenario, target)
    occupancy = builder.AddSystem(
        replaced.get("occupancy_inference")
        or OccupancyInference(
            inference=inference, width=camera.width, height=camera.height
        )
    )
    from_depth = scenario.gripper.grasps == "depth"
    build_policy = ChoicePolicy if agent else SearchPolicy
    policy = builder.AddSystem(
        replaced.get("search_policy")
        or build_policy(
            ranking=kind.ranking,
            planner=_depth_grasps(scenario) if from_depth else planner,
            bodies=bodies,
            target_first=scenario.policy.target_first,
            min_visible_pixels=scenario.policy.min_visible_pixels,
            min_grasp_quality=scenario.policy.min_grasp_quality,
            foresight=Foresight(
                inference,
                size_in_any_pose(target),
                camera.width,
                camera.height,
            )
            if kind.outlook
            else None,
            truth=kind.truth,
            seed=scenario.seed,
        )
    )
    execution = add_execution(
        builder, scenario, station, parts, heap, planner, meshcat=meshcat
    )
    gripper = execution.controller
    boxes = [*perception.boxes, occupancy, policy, *execution.boxes]

    taken = {
        port: station.GetOutputPort(f"{camera.name}.{port}")
        for port in ("color_image", "depth_image", "label_image", "camera")
    }
    taken["body_poses"] = station.GetOutputPort("cheat.body_poses")
    system, port = perception.depth
    seen = taken | {
        "depth_image": system.GetOutputPort(port),
        "target_mask": perception.detector.GetOutputPort("target_mask"),
        "instances": perception.segmenter.GetOutputPort("instances"),
    }
    action = policy.GetOutputPort("action")
    status = gripper.GetOutputPort("status")
    known = dict(seen)
    if kind.memory:
        memory = builder.AddSystem(
            SearchMemory(
                memory=TargetMemory(
                    size_in_any_pose(target),
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
        connect_inputs(
            builder, memory, seen | {"action": action, "status": status}
        )
        known["depth_image"] = memory.GetOutputPort("depth_image")
    connect_inputs(builder, occupancy, known)
    known |= {
        "seen_depth_image": seen["depth_image"],
        "occupancy": occupancy.GetOutputPort("occupancy"),
        "status": status,
    }
    if kind.truth:
        truth = builder.AddSystem(
            TrueTargetMask(target=target, body=bodies[target.name])
        )
        boxes.append(truth)
        connect_inputs(builder, truth, taken)
        known["true_target"] = truth.GetOutputPort("target_mask")
    connect_inputs(
        builder, policy, known, open_ports=("choice",) if agent else ()
    )
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
        connect_inputs(builder, body, taken | {"action": action})
        action = body.GetOutputPort("action")
    builder.Connect(action, gripper.GetInputPort("action"))
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


def _check_replaced(replace: Mapping[str, Replacement], *, agent: bool) -> None:
    for name in replace:
        if name not in REPLACEABLE:
            raise ValueError(
                f"{name} cannot be replaced: choose of {', '.join(REPLACEABLE)}"
            )
    if agent and "search_policy" in replace:
        raise ValueError(
            "search_policy is replaced, and an agent cannot choose as well"
        )


def _replacement(name: str, build: Replacement, inside: SearchParts) -> System:
    system = build(inside) if callable(build) else build
    if not callable(build) or not isinstance(system, System):
        raise ValueError(
            f"replace[{name!r}] must be a function that takes SearchParts and "
            f"returns a new System, as in lambda parts: MySystem(); it "
            f"{'returns' if callable(build) else 'is'} {system!r}"
        )
    system.set_name(name)
    check_output(system, REPLACEABLE[name])
    return system


def _inference(scenario: Scenario, target: ObjectModel) -> OccupancyModel:
    perception = scenario.perception
    if perception.occupancy == "exact":
        return exact_model(target, perception.exact)
    if perception.occupancy == "expected":
        return ExpectedLabel(target, perception.exact)
    return load_inference(
        weights_path(perception),
        target_size=target.extents,
        output="posterior"
        if perception.occupancy == "posterior"
        else "occupancy",
        dtype=perception.dtype,
        floor=perception.exact.floor,
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
