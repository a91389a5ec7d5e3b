"""Builds the whole search as one Diagram."""

from collections.abc import Callable, Iterable, Mapping

from pydrake.geometry import Meshcat
from pydrake.systems.framework import (
    Diagram,
    DiagramBuilder,
    OutputPort,
    System,
)

from xray_drake.grasping.evidence.model import ModelEvidence
from xray_drake.grasping.planner import GraspPlanner
from xray_drake.scene.heap import Heap
from xray_drake.search.boxes import SearchParts, add_decision, add_perception
from xray_drake.search.execution import add_execution
from xray_drake.search.wiring import Boxes, check_output
from xray_drake.station.heap_station import StationParts, build_heap_station
from xray_drake.station.objects import make_heap
from xray_drake.station.scenario import Scenario, check_scenario

AGENT = "agent"
"""What the record calls the policy where an agent chooses."""

REPLACEABLE = {
    "target_detector": "target_mask",
    "instance_segmenter": "instances",
    "occupancy_inference": "occupancy",
    "search_policy": "action",
}
"""The boxes that can be replaced, and the output that each must have."""


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
    heap = heap or make_heap(scenario, progress=progress)
    builder = DiagramBuilder()
    station, parts = build_heap_station(scenario, heap, meshcat=meshcat)
    builder.AddSystem(station)
    planner = GraspPlanner(
        ModelEvidence(
            heap.models,
            bin_=scenario.cell.bin,
            gripper=scenario.cell.gripper.spec,
            config=scenario.gripper.planner,
            seed=scenario.seed,
        )
    )
    inside = SearchParts(scenario, heap, parts, planner)
    replaced = {n: _replacement(n, b, inside) for n, b in replace.items()}
    controller, *sensors = add_execution(
        builder, scenario, station, parts, heap, planner, meshcat=meshcat
    )
    truth = _images(station, scenario.camera.name)
    add_perception(boxes := Boxes(builder, replaced, truth), inside)
    truth["body_poses"] = station.GetOutputPort("cheat.body_poses")
    status = controller.GetOutputPort("status")
    action = add_decision(boxes, inside, truth, status, agent=agent)
    builder.Connect(action, controller.GetInputPort("action"))
    _export_outputs(builder, station, (*boxes.added, controller, *sensors))
    diagram = SearchDiagram()
    builder.BuildInto(diagram)
    diagram.set_name("search")
    diagram.scenario, diagram.heap, diagram.station = scenario, heap, parts
    diagram.meshcat, diagram.agent = meshcat, agent
    return diagram


def _images(station: System, camera: str) -> dict[str, OutputPort]:
    return {
        port: station.GetOutputPort(f"{camera}.{port}")
        for port in ("color_image", "depth_image", "label_image", "camera")
    }


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


def _export_outputs(
    builder: DiagramBuilder, station: System, boxes: Iterable[System]
) -> None:
    """Exports all as ``box.port``; the station's by their names alone."""
    for system in (*boxes, station):
        prefix = "" if system is station else f"{system.get_name()}."
        for index in range(system.num_output_ports()):
            output = system.get_output_port(index)
            builder.ExportOutput(output, f"{prefix}{output.get_name()}")
