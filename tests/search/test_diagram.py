from typing import Any

import numpy as np
import pytest

from tests.perception.segmentation_metrics import score_segmentation
from tests.ports import outputs_of
from xray_drake.messages import GripperMode
from xray_drake.scene.heap import Heap
from xray_drake.search import diagram as module
from xray_drake.search.diagram import SearchDiagram, build_search_diagram
from xray_drake.station.scenario import Scenario, ScenarioError


def test_the_outputs_of_every_box_are_exported(
    tiny_diagram: SearchDiagram,
) -> None:
    """The station's by their names alone."""
    outputs = {
        ("" if box == "heap_station" else f"{box}.") + port
        for box in (
            "heap_station",
            "target_detector",
            "instance_segmenter",
            "occupancy_inference",
            "search_policy",
            "gripper_controller",
        )
        for port in outputs_of(tiny_diagram.GetSubsystemByName(box))
    }
    assert set(outputs_of(tiny_diagram)) == outputs
    assert len(outputs) == tiny_diagram.num_output_ports()


WIRES = """
heap_station:overhead.label_image target_detector:label_image
heap_station:overhead.label_image instance_segmenter:label_image
heap_station:overhead.depth_image occupancy_inference:depth_image
heap_station:overhead.camera occupancy_inference:camera
target_detector:target_mask occupancy_inference:target_mask
target_detector:target_mask search_policy:target_mask
instance_segmenter:instances search_policy:instances
occupancy_inference:occupancy search_policy:occupancy
gripper_controller:status search_policy:status
search_policy:action gripper_controller:action
gripper_controller:applied_spatial_force heap_station:applied_spatial_force
"""


@pytest.mark.parametrize("wire", WIRES.strip().splitlines())
def test_the_loop_is_wired_as_it_is_drawn(
    tiny_diagram: SearchDiagram, wire: str
) -> None:
    (box, output), (other, given) = (end.split(":") for end in wire.split())
    assert tiny_diagram.AreConnected(
        tiny_diagram.GetSubsystemByName(box).GetOutputPort(output),
        tiny_diagram.GetSubsystemByName(other).GetInputPort(given),
    )


def test_what_the_boxes_say_before_anything_is_decided(
    tiny_diagram: SearchDiagram, recorded_observation: Any
) -> None:
    context = tiny_diagram.CreateDefaultContext()

    def output(name: str) -> Any:
        return tiny_diagram.GetOutputPort(name).Eval(context)

    assert output("search_policy.action").number == 0
    assert output("gripper_controller.status").mode is GripperMode.IDLE
    seen = recorded_observation
    target = output("target_detector.target_mask")
    np.testing.assert_array_equal(
        target.data, seen.labels == seen.label_of["box_2to1"]
    )
    instances = output("instance_segmenter.instances")
    assert set(instances.names) == {"box_2to1", "book", "block", "plank"}
    occupancy = output("occupancy_inference.occupancy")
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
    camera = tiny_scenario.camera
    camera.width, camera.height, camera.name = 256, 192, "above"
    camera.center_x, camera.center_y = 127.5, 95.5
    tiny_scenario.plant_config.time_step = 0.004
    perception = tiny_scenario.perception
    perception.occupancy = "geometric_label"
    perception.geometric.poses = "flat"
    diagram = build_search_diagram(tiny_scenario, heap=tiny_heap)
    context = diagram.CreateDefaultContext()
    port = diagram.GetOutputPort("occupancy_inference.occupancy")
    occupancy = port.Eval(context)
    assert occupancy.data.shape == (192, 256)
    assert occupancy.method == "geometric_label"
    assert diagram.GetOutputPort("above.camera").Eval(context).width == 256
    assert diagram.station.plant.time_step() == 0.004


def test_a_bad_scenario_is_found_out_before_the_drop(
    tiny_scenario: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    def drop(*args: Any, **kwargs: Any) -> None:
        raise AssertionError("dropped")

    monkeypatch.setattr(module, "make_heap", drop)
    tiny_scenario.policy.name = "greedy"
    with pytest.raises(ScenarioError, match="greedy"):
        build_search_diagram(tiny_scenario)


def look(diagram: SearchDiagram, *ports: str) -> list[Any]:
    """Returns what outputs say at the start; images as (H, W) arrays."""
    context = diagram.CreateDefaultContext()
    values = [diagram.GetOutputPort(p).Eval(context) for p in ports]
    return [
        np.array(v.data[:, :, 0]) if "image" in p else v
        for p, v in zip(ports, values, strict=True)
    ]


def test_without_ground_truth(
    blind_scenario: Scenario, tiny_heap: Heap
) -> None:
    diagram = build_search_diagram(blind_scenario, heap=tiny_heap)
    noisy, clean, truth, instances, target, rho = look(
        diagram,
        "depth_sensor.depth_image",
        "overhead.depth_image",
        "overhead.label_image",
        "instance_segmenter.instances",
        "target_detector.target_mask",
        "occupancy_inference.occupancy",
    )
    read = noisy > 0
    assert 0.5 < read.mean() < 1
    assert np.any(noisy[read] != clean[read])
    np.testing.assert_allclose(noisy[read], clean[read], atol=0.003)

    labels = list(diagram.station.labels.values())
    score = score_segmentation(
        np.where(np.isin(truth, labels), truth, -1), instances.labels
    )
    assert (score.objects, score.recall) == (4, 1)
    # The target's mask comes from the colour and is an instance of its own.
    assert target.data.sum() >= 50
    assert any(
        np.array_equal(instances.mask(name), target.data)
        for name in instances.names
    )
    # The inference sees the noise, the truth stays behind it.
    assert rho.support()[target.data].mean() > 0.8
    assert diagram.AreConnected(
        diagram.GetSubsystemByName("depth_sensor").GetOutputPort("depth_image"),
        diagram.GetSubsystemByName("occupancy_inference").GetInputPort(
            "depth_image"
        ),
    )


def test_settings_reach_the_systems(
    blind_scenario: Scenario, tiny_heap: Heap
) -> None:
    config = blind_scenario.perception
    config.noise = False
    config.hsv.hue = 216.0
    config.depth_segmenter.min_area = 10_000
    mask, instances = look(
        build_search_diagram(blind_scenario, heap=tiny_heap),
        "target_detector.target_mask",
        "instance_segmenter.instances",
    )
    # Nothing is as large but what is detected: the book is blue.
    assert mask.data.any()
    assert len(instances.names) == 1
