"""The perception that a scenario chooses, in its search."""

from typing import Any

import numpy as np

from tests.perception.segmentation_metrics import score_segmentation
from xray_drake.scene.heap import Heap
from xray_drake.search.diagram import SearchDiagram, build_search_diagram
from xray_drake.station.scenario import Scenario


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
