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
from xray_drake.search.wiring import check_output, connect_inputs
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
    *,
    detector: System | None = None,
    segmenter: System | None = None,
) -> Perception:
    """Adds ``target_detector``, ``instance_segmenter``, and ``depth_sensor``.

    The last is there only where the scenario wants noise.

    Args:
        builder: holds the station already.
        scenario: says which.
        station: with the overhead camera's images.
        labels: object name to its value in the label image.
        target: the target's name.
        detector: takes the place of the scenario's.
        segmenter: takes the place of the scenario's.

    Raises:
        ValueError: one of these has an input that nothing is for, or not the
            output that it should have.
    """
    config, camera = scenario.perception, scenario.camera
    size = {"width": camera.width, "height": camera.height}
    sources = {
        port: station.GetOutputPort(f"{camera.name}.{port}")
        for port in ("color_image", "depth_image", "label_image", "camera")
    }
    depth: tuple[System, str] = station, f"{camera.name}.depth_image"
    boxes: list[System] = []

    def add(system: System) -> System:
        boxes.append(builder.AddSystem(system))
        connect_inputs(builder, system, sources)
        return system

    if config.noise:
        depth = (
            add(
                NoisyDepthSensor(
                    noise=config.depth_noise, seed=scenario.seed, **size
                )
            ),
            "depth_image",
        )
        sources["depth_image"] = depth[0].GetOutputPort("depth_image")

    if detector is None and config.detector == "hsv":
        detector = HsvTargetDetector(config=config.hsv, **size)
    elif detector is None:
        detector = GroundTruthTargetDetector(target_label=labels[target])
    check_output(add(detector), "target_mask")
    sources["target_mask"] = detector.GetOutputPort("target_mask")

    if segmenter is None and config.segmenter == "depth":
        segmenter = DepthInstanceSegmenter(
            config=config.depth_segmenter, **size
        )
    elif segmenter is None:
        segmenter = GroundTruthInstanceSegmenter(labels=labels)
    check_output(add(segmenter), "instances")
    return Perception(detector, segmenter, depth, boxes)
