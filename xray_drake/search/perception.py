"""Adds the perception systems that a scenario chooses to a search."""

from collections.abc import Mapping
from dataclasses import dataclass

from pydrake.systems.framework import DiagramBuilder, System

from xray_drake.perception.sensor_systems import (
    DepthInstanceSegmenter,
    HsvTargetDetector,
    NoisyDepthSensor,
)
from xray_drake.perception.systems import (
    GroundTruthInstanceSegmenter,
    GroundTruthTargetDetector,
)
from xray_drake.station.scenario import Scenario


@dataclass(frozen=True, eq=False)
class Perception:
    """What looks at the images, wired to the station.

    Attributes:
        detector: has the output ``target_mask``.
        segmenter: has the output ``instances``.
        depth: the system and the output that all who need depth should read.
        boxes: all systems that were added.
    """

    detector: System
    segmenter: System
    depth: tuple[System, str]
    boxes: list[System]


def add_perception(
    builder: DiagramBuilder,
    scenario: Scenario,
    station: System,
    labels: Mapping[str, int],
    target: str,
) -> Perception:
    """Adds ``target_detector``, ``instance_segmenter``, and ``depth_sensor``.

    The last is there only where the scenario wants noise.

    Args:
        builder: holds the station already.
        scenario: says which.
        station: with the overhead camera's images.
        labels: object name to its value in the label image.
        target: the target's name.
    """
    config, camera = scenario.perception, scenario.camera
    size = {"width": camera.width, "height": camera.height}
    label_image = station.GetOutputPort(f"{camera.name}.label_image")
    camera_port = station.GetOutputPort(f"{camera.name}.camera")
    depth: tuple[System, str] = station, f"{camera.name}.depth_image"
    boxes: list[System] = []

    def add(system: System) -> System:
        boxes.append(builder.AddSystem(system))
        return system

    if config.detector == "hsv":
        detector = add(HsvTargetDetector(config=config.hsv, **size))
        builder.Connect(
            station.GetOutputPort(f"{camera.name}.color_image"),
            detector.GetInputPort("color_image"),
        )
    else:
        detector = add(GroundTruthTargetDetector(target_label=labels[target]))
        builder.Connect(label_image, detector.GetInputPort("label_image"))

    if config.noise:
        sensor = add(
            NoisyDepthSensor(
                noise=config.depth_noise, seed=scenario.seed, **size
            )
        )
        builder.Connect(
            depth[0].GetOutputPort(depth[1]), sensor.GetInputPort("depth_image")
        )
        builder.Connect(camera_port, sensor.GetInputPort("camera"))
        depth = sensor, "depth_image"

    if config.segmenter == "depth":
        segmenter = add(
            DepthInstanceSegmenter(config=config.depth_segmenter, **size)
        )
        for output, port in (
            (depth[0].GetOutputPort(depth[1]), "depth_image"),
            (camera_port, "camera"),
            (detector.GetOutputPort("target_mask"), "target_mask"),
        ):
            builder.Connect(output, segmenter.GetInputPort(port))
    else:
        segmenter = add(GroundTruthInstanceSegmenter(labels=labels))
        builder.Connect(label_image, segmenter.GetInputPort("label_image"))
    return Perception(detector, segmenter, depth, boxes)
