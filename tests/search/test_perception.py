"""The perception that a scenario chooses, wired to a station."""

import numpy as np
import pytest
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from xray_drake.messages import InstanceMasks
from xray_drake.perception.segmentation_metrics import score_segmentation
from xray_drake.scene.heap import Heap
from xray_drake.search.diagram import SearchDiagram, build_search_diagram
from xray_drake.search.perception import Perception, add_perception
from xray_drake.station.heap_station import build_heap_station
from xray_drake.station.scenario import Scenario


def build(
    scenario: Scenario, heap: Heap
) -> tuple[Diagram, Perception, dict[str, int]]:
    """Returns station and perception alone, and the labels of the objects."""
    builder = DiagramBuilder()
    station, parts = build_heap_station(scenario, heap)
    builder.AddSystem(station)
    position = station.GetInputPort("gripper.position")
    # Any will do; it starts with a quaternion.
    gripper = builder.AddSystem(
        ConstantVectorSource(np.eye(position.size())[0])
    )
    builder.Connect(gripper.get_output_port(), position)
    perception = add_perception(
        builder, scenario, station, parts.labels, heap.target.name
    )
    for output in ("label_image", "depth_image"):
        builder.ExportOutput(
            station.GetOutputPort(f"overhead.{output}"), output
        )
    return builder.Build(), perception, parts.labels


def names(perception: Perception) -> list[str]:
    return [box.get_name() for box in perception.boxes]


def test_ground_truth(tiny_scenario: Scenario, tiny_heap: Heap) -> None:
    _, perception, _ = build(tiny_scenario, tiny_heap)
    assert names(perception) == ["target_detector", "instance_segmenter"]
    source, output = perception.depth
    assert (source.get_name(), output) == (
        "heap_station",
        "overhead.depth_image",
    )


def test_without_ground_truth(tiny_scenario: Scenario, tiny_heap: Heap) -> None:
    tiny_scenario.perception.detector = "hsv"
    tiny_scenario.perception.segmenter = "depth"
    tiny_scenario.perception.noise = True
    diagram, perception, labels = build(tiny_scenario, tiny_heap)
    assert set(names(perception)) == {
        "target_detector",
        "depth_sensor",
        "instance_segmenter",
    }
    context = diagram.CreateDefaultContext()

    def look(port: str) -> np.ndarray:
        return diagram.GetOutputPort(port).Eval(context).data[:, :, 0]

    source, output = perception.depth
    assert source.get_name() == "depth_sensor"
    depth = source.GetOutputPort(output).Eval(
        source.GetMyContextFromRoot(context)
    )
    noisy, clean = depth.data[:, :, 0], look("depth_image")
    read = noisy > 0
    assert 0.5 < read.mean() < 1
    assert np.any(noisy[read] != clean[read])
    np.testing.assert_allclose(noisy[read], clean[read], atol=0.003)

    instances: InstanceMasks = perception.segmenter.GetOutputPort(
        "instances"
    ).Eval(perception.segmenter.GetMyContextFromRoot(context))
    truth = look("label_image").astype(int)
    truth[~np.isin(truth, list(labels.values()))] = -1
    score = score_segmentation(truth, instances.labels)
    assert (score.objects, score.recall) == (4, 1)
    # The target's mask comes from the colour and is an instance of its own.
    target = perception.detector.GetOutputPort("target_mask").Eval(
        perception.detector.GetMyContextFromRoot(context)
    )
    assert target.data.any()
    assert any(
        np.array_equal(instances.mask(name), target.data)
        for name in instances.names
    )


def test_settings_reach_the_systems(
    tiny_scenario: Scenario, tiny_heap: Heap
) -> None:
    config = tiny_scenario.perception
    config.detector, config.segmenter = "hsv", "depth"
    config.hsv.hue = 216.0
    config.depth_segmenter.min_area = 10_000
    diagram, perception, _ = build(tiny_scenario, tiny_heap)
    context = diagram.CreateDefaultContext()
    instances = perception.segmenter.GetOutputPort("instances").Eval(
        perception.segmenter.GetMyContextFromRoot(context)
    )
    # Nothing is as large but what is detected: the book is blue.
    mask = perception.detector.GetOutputPort("target_mask").Eval(
        perception.detector.GetMyContextFromRoot(context)
    )
    assert mask.data.any()
    assert len(instances.names) == 1


@pytest.fixture
def noisy_diagram(tiny_scenario: Scenario, tiny_heap: Heap) -> SearchDiagram:
    tiny_scenario.perception.detector = "hsv"
    tiny_scenario.perception.noise = True
    return build_search_diagram(tiny_scenario, heap=tiny_heap)


def test_the_search_sees_the_noise(noisy_diagram: SearchDiagram) -> None:
    sensor = noisy_diagram.GetSubsystemByName("depth_sensor")
    inference = noisy_diagram.GetSubsystemByName("occupancy_inference")
    assert noisy_diagram.AreConnected(
        sensor.GetOutputPort("depth_image"),
        inference.GetInputPort("depth_image"),
    )
    context = noisy_diagram.CreateDefaultContext()
    noisy_diagram.GetOutputPort("depth_sensor.depth_image").Eval(context)
    mask = noisy_diagram.GetOutputPort("target_detector.target_mask")
    occupancy = noisy_diagram.GetOutputPort("occupancy_inference.occupancy")
    seen = mask.Eval(context).data
    assert seen.sum() >= 50
    rho = occupancy.Eval(context)
    assert rho.support()[seen].mean() > 0.8
