"""Builds the whole search as one Diagram."""

from collections.abc import Callable

from pydrake.geometry import Meshcat
from pydrake.systems.framework import Diagram, DiagramBuilder, System

from xray_drake.grasping.gripper_geometry import load_gripper_geometry
from xray_drake.grasping.planner import ModelGraspPlanner
from xray_drake.gripper.quasi_static import DrawnGripper, QuasiStaticGripper
from xray_drake.occupancy.exact_model import exact_model
from xray_drake.occupancy.learned import load_inference
from xray_drake.occupancy.system import OccupancyInference, OccupancyModel
from xray_drake.perception.systems import (
    GroundTruthInstanceSegmenter,
    GroundTruthTargetDetector,
)
from xray_drake.policy.memory import MemoryConfig, TargetMemory
from xray_drake.policy.memory_system import SearchMemory
from xray_drake.policy.policies import POLICIES
from xray_drake.policy.system import Foresight, SearchPolicy
from xray_drake.policy.true_target import TrueTargetMask
from xray_drake.scene.heap import Heap
from xray_drake.scene.object_model import ObjectModel
from xray_drake.scene.targets import size_in_any_pose
from xray_drake.station.heap_station import StationParts, build_heap_station
from xray_drake.station.objects import make_heap
from xray_drake.station.scenario import (
    Scenario,
    check_scenario,
    weights_path,
)

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
    """

    scenario: Scenario
    heap: Heap
    station: StationParts
    meshcat: Meshcat | None


def build_search_diagram(
    scenario: Scenario,
    *,
    heap: Heap | None = None,
    meshcat: Meshcat | None = None,
    progress: Callable[[float], None] | None = None,
) -> SearchDiagram:
    """Builds station, perception, inference, policy and gripper.

    Every box is a named system: ``heap_station``, ``target_detector``,
    ``instance_segmenter``, ``occupancy_inference``, ``search_policy``,
    ``gripper_controller``. Policies that need them add ``search_memory``
    between the camera and the inference, or ``true_target``. The outputs of
    all are exported as ``box.port``, and so are the station's images and its
    ground truth (``cheat.…``). In the default context the heap is at rest and
    nothing has been decided.

    Args:
        scenario: what to build.
        heap: what lies in the bin; by default it is dropped here, which takes
            some seconds.
        meshcat: shows the station, if given.
        progress: told the share of the drop that is done.

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
    kind = POLICIES[scenario.policy.name]
    target = heap.target
    bodies = {
        name: int(item.body.index()) for name, item in parts.objects.items()
    }

    detector = builder.AddSystem(
        GroundTruthTargetDetector(target_label=parts.labels[target.name])
    )
    segmenter = builder.AddSystem(
        GroundTruthInstanceSegmenter(labels=parts.labels)
    )
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
    policy = builder.AddSystem(
        SearchPolicy(
            ranking=kind.ranking,
            planner=planner,
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
    geometry = load_gripper_geometry()
    gripper = builder.AddSystem(
        QuasiStaticGripper(
            judge=planner,
            objects=heap.models,
            bodies=bodies,
            drawn=DrawnGripper(
                X_BJ=geometry.X_BJ,
                X_BC=geometry.X_BC,
                opening=scenario.gripper.parameters.opening,
            ),
            config=scenario.gripper.quasi_static,
            seed=scenario.seed,
            time_step=scenario.plant_config.time_step,
        )
    )

    name = camera.name
    depth: _Output = station, f"{name}.depth_image"
    boxes = [detector, segmenter, occupancy, policy, gripper]
    wires: list[_Wire] = []
    if kind.memory:
        memory = builder.AddSystem(
            SearchMemory(
                memory=TargetMemory(
                    size_in_any_pose(target),
                    MemoryConfig(floor=scenario.perception.exact.floor),
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
        wires += [
            (*depth, policy, "depth_image"),
            (station, f"{name}.camera", policy, "camera"),
        ]
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
    wires += [
        (station, f"{name}.label_image", detector, "label_image"),
        (station, f"{name}.label_image", segmenter, "label_image"),
        (*depth, occupancy, "depth_image"),
        (station, f"{name}.camera", occupancy, "camera"),
        (detector, "target_mask", occupancy, "target_mask"),
        (detector, "target_mask", policy, "target_mask"),
        (segmenter, "instances", policy, "instances"),
        (occupancy, "occupancy", policy, "occupancy"),
        (gripper, "status", policy, "status"),
        (station, "cheat.body_poses", policy, "body_poses"),
        (policy, "action", gripper, "action"),
        (station, "cheat.body_poses", gripper, "body_poses"),
        (
            station,
            "cheat.body_spatial_velocities",
            gripper,
            "body_spatial_velocities",
        ),
        (gripper, "applied_spatial_force", station, "applied_spatial_force"),
        (gripper, "position", station, "gripper.position"),
    ]
    for source, output, drain, port in wires:
        builder.Connect(source.GetOutputPort(output), drain.GetInputPort(port))
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
    return diagram


def _inference(scenario: Scenario, target: ObjectModel) -> OccupancyModel:
    perception = scenario.perception
    if perception.occupancy == "exact":
        return exact_model(target, perception.exact)
    return load_inference(
        weights_path(perception),
        target_size=target.extents,
        output="posterior"
        if perception.occupancy == "posterior"
        else "occupancy",
    )


def _export_outputs(
    builder: DiagramBuilder, system: System, prefix: str
) -> None:
    for index in range(system.num_output_ports()):
        output = system.get_output_port(index)
        builder.ExportOutput(output, f"{prefix}{output.get_name()}")
