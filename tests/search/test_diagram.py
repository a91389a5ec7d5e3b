from typing import Any

import numpy as np
import pytest

from tests.ports import outputs_of
from xray_drake.messages import (
    GripperMode,
    GripperStatus,
    InstanceMasks,
    OccupancyDistribution,
    SearchAction,
    TargetMask,
)
from xray_drake.occupancy.geometric.flat import FlatPoses
from xray_drake.occupancy.geometric.inference import GeometricInference
from xray_drake.occupancy.geometric.resting import RestingPoses
from xray_drake.scene.heap import Heap
from xray_drake.scene.targets import target_model
from xray_drake.search import boxes
from xray_drake.search import diagram as module
from xray_drake.search.diagram import SearchDiagram, build_search_diagram
from xray_drake.station.scenario import (
    Scenario,
    ScenarioError,
    check_scenario,
)

BOXES = (
    "heap_station",
    "target_detector",
    "instance_segmenter",
    "occupancy_inference",
    "search_policy",
    "gripper_controller",
)

OUTPUTS = {
    "overhead.color_image",
    "overhead.depth_image",
    "overhead.label_image",
    "overhead.camera",
    "query_object",
    "contact_results",
    "cheat.body_poses",
    "cheat.body_spatial_velocities",
    "target_detector.target_mask",
    "instance_segmenter.instances",
    "occupancy_inference.occupancy",
    "search_policy.action",
    "gripper_controller.status",
    "gripper_controller.applied_spatial_force",
    "gripper_controller.position",
}


def test_ports(tiny_diagram: SearchDiagram) -> None:
    assert tiny_diagram.num_input_ports() == 0
    names = outputs_of(tiny_diagram)
    assert len(names) == len(set(names))
    assert set(names) >= OUTPUTS


def test_every_box_is_a_named_system(tiny_diagram: SearchDiagram) -> None:
    assert {s.get_name() for s in tiny_diagram.GetSystems()} >= set(BOXES)
    for name in BOXES:
        box = tiny_diagram.GetSubsystemByName(name)
        for i in range(box.num_input_ports()):
            port = box.get_input_port(i)
            assert tiny_diagram.AreConnected(*source_of(tiny_diagram, port)), (
                f"{name}.{port.get_name()} is not connected"
            )


def source_of(diagram: SearchDiagram, port: Any) -> tuple[Any, Any]:
    """Returns the output that feeds an input, and the input."""
    for system in diagram.GetSystems():
        for i in range(system.num_output_ports()):
            output = system.get_output_port(i)
            if diagram.AreConnected(output, port):
                return output, port
    raise AssertionError(f"nothing feeds {port.GetFullDescription()}")


@pytest.mark.parametrize(
    ("source", "target"),
    [
        ("heap_station:overhead.label_image", "target_detector:label_image"),
        ("heap_station:overhead.label_image", "instance_segmenter:label_image"),
        (
            "heap_station:overhead.depth_image",
            "occupancy_inference:depth_image",
        ),
        ("heap_station:overhead.camera", "occupancy_inference:camera"),
        ("target_detector:target_mask", "occupancy_inference:target_mask"),
        ("target_detector:target_mask", "search_policy:target_mask"),
        ("instance_segmenter:instances", "search_policy:instances"),
        ("occupancy_inference:occupancy", "search_policy:occupancy"),
        ("gripper_controller:status", "search_policy:status"),
        ("search_policy:action", "gripper_controller:action"),
        (
            "gripper_controller:applied_spatial_force",
            "heap_station:applied_spatial_force",
        ),
    ],
)
def test_the_loop_is_wired_as_it_is_drawn(
    tiny_diagram: SearchDiagram, source: str, target: str
) -> None:
    (box, output), (other, given) = source.split(":"), target.split(":")
    assert tiny_diagram.AreConnected(
        tiny_diagram.GetSubsystemByName(box).GetOutputPort(output),
        tiny_diagram.GetSubsystemByName(other).GetInputPort(given),
    )


def test_it_remembers_what_it_was_built_from(
    tiny_diagram: SearchDiagram, tiny_heap: Heap
) -> None:
    assert tiny_diagram.get_name() == "search"
    assert tiny_diagram.heap is tiny_heap
    assert tiny_diagram.scenario.name == "tiny"
    assert tiny_diagram.meshcat is None
    assert list(tiny_diagram.station.objects) == [
        model.name for model in tiny_heap.models
    ]


def test_at_first_nothing_is_decided(tiny_diagram: SearchDiagram) -> None:
    context = tiny_diagram.CreateDefaultContext()
    action = tiny_diagram.GetOutputPort("search_policy.action").Eval(context)
    status = tiny_diagram.GetOutputPort("gripper_controller.status").Eval(
        context
    )
    assert isinstance(action, SearchAction)
    assert action.number == 0
    assert isinstance(status, GripperStatus)
    assert status.mode is GripperMode.IDLE


def test_what_the_boxes_see(
    tiny_diagram: SearchDiagram, recorded_observation: Any
) -> None:
    context = tiny_diagram.CreateDefaultContext()

    def output(name: str) -> Any:
        return tiny_diagram.GetOutputPort(name).Eval(context)

    seen = recorded_observation
    target = output("target_detector.target_mask")
    assert isinstance(target, TargetMask)
    np.testing.assert_array_equal(
        target.data, seen.labels == seen.label_of["box_2to1"]
    )
    instances = output("instance_segmenter.instances")
    assert isinstance(instances, InstanceMasks)
    assert set(instances.names) == {"box_2to1", "book", "block", "plank"}
    occupancy = output("occupancy_inference.occupancy")
    assert isinstance(occupancy, OccupancyDistribution)
    assert occupancy.method == "geometric"
    assert occupancy.data.max() == 1.0
    # What is seen of the target is where it can be, and more of it is not
    # far: the target is 34 px long.
    assert occupancy.support()[target.data].mean() > 0.9
    rows, columns = np.nonzero(occupancy.support())
    v, u = np.argwhere(target.data).mean(axis=0)
    assert np.hypot(columns - u, rows - v).max() < 40


def test_settings_of_the_scenario_arrive(
    tiny_scenario: Scenario, tiny_heap: Heap
) -> None:
    tiny_scenario.camera.width, tiny_scenario.camera.height = 256, 192
    tiny_scenario.camera.center_x = 127.5
    tiny_scenario.camera.center_y = 95.5
    tiny_scenario.camera.name = "above"
    tiny_scenario.plant_config.time_step = 0.004
    diagram = build_search_diagram(tiny_scenario, heap=tiny_heap)
    context = diagram.CreateDefaultContext()
    occupancy = diagram.GetOutputPort("occupancy_inference.occupancy")
    assert occupancy.Eval(context).data.shape == (192, 256)
    assert diagram.GetOutputPort("above.camera").Eval(context).width == 256
    assert diagram.station.plant.time_step() == 0.004


def test_without_a_heap_it_drops_one() -> None:
    scenario = Scenario(seed=10_000)
    scenario.scene.num_objects = 1
    scenario.scene.target = "domino"
    shares: list[float] = []
    diagram = build_search_diagram(scenario, progress=shares.append)
    assert diagram.heap.target.name == "domino"
    assert diagram.heap.seed == 10_000
    assert len(diagram.heap.objects) == 1
    assert shares[-1] == 1.0


def test_a_bad_scenario_is_found_out_before_the_drop(
    tiny_scenario: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    def drop(*args: Any, **kwargs: Any) -> None:
        raise AssertionError("dropped")

    monkeypatch.setattr(module, "make_heap", drop)
    tiny_scenario.policy.name = "greedy"
    with pytest.raises(ScenarioError, match="greedy"):
        build_search_diagram(tiny_scenario)


@pytest.mark.parametrize(
    ("target", "occupancy", "poses", "kind"),
    [
        ("cube", "geometric", "resting", RestingPoses),
        ("cube", "geometric", "flat", FlatPoses),
        ("box_2to1", "geometric_label", "flat", FlatPoses),
    ],
)
def test_the_inference_is_the_scenarios(
    target: str, occupancy: str, poses: str, kind: type
) -> None:
    scenario = Scenario()
    scenario.perception.occupancy = occupancy
    scenario.perception.geometric.poses = poses
    scenario.perception.weights = "nowhere.safetensors"
    check_scenario(scenario)
    inference = boxes._inference(scenario, target_model(target))
    assert isinstance(inference, GeometricInference)
    assert inference.method == occupancy
    assert isinstance(inference.poses, kind)
