"""The perception systems alone: fix what the sensor gives, read the output."""

from typing import Any

import numpy as np
import pytest
from pydrake.systems.framework import LeafSystem

from tests.masks import iou
from tests.ports import context_with, fix_inputs, ports
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.messages import InstanceMasks, TargetMask
from xray_drake.perception.depth_noise import DepthNoise
from xray_drake.perception.depth_segmenter import (
    DepthSegmenterConfig,
    segment_depth,
)
from xray_drake.perception.hsv_target import HsvTargetConfig
from xray_drake.perception.systems import (
    DepthInstanceSegmenter,
    GroundTruthInstanceSegmenter,
    GroundTruthTargetDetector,
    HsvTargetDetector,
    NoisyDepthSensor,
)
from xray_drake.search.diagram import SearchDiagram

SIZE = {"width": 128, "height": 96}
SHAPE = (96, 128)
CAMERA = PinholeCamera(
    **SIZE,
    intrinsics=np.array([[138.0, 0, 63.5], [0, 138.0, 47.5], [0, 0, 1]]),
    X_WC=np.array(
        [[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.8], [0, 0, 0, 1]]
    ),
)


def blocks() -> np.ndarray:
    depth = np.full(SHAPE, 0.8, np.float32)
    depth[30:60, 40:60] = 0.75
    depth[30:40, 80:90] = 0.78
    return depth


LABELS = np.array([[0, 7, 7, 9], [0, 7, 3, 9], [32767, 3, 3, 9]], np.int16)


def output_of(system: LeafSystem, **inputs: Any) -> Any:
    return system.get_output_port().Eval(context_with(system, **inputs))


@pytest.mark.parametrize(
    ("system", "name", "inputs", "output"),
    [
        (HsvTargetDetector(), "target_detector", "color_image", "target_mask"),
        (
            GroundTruthTargetDetector(target_label=3),
            "target_detector",
            "label_image",
            "target_mask",
        ),
        (
            GroundTruthInstanceSegmenter(labels={}),
            "instance_segmenter",
            "label_image",
            "instances",
        ),
        (
            DepthInstanceSegmenter(),
            "instance_segmenter",
            "depth_image camera target_mask",
            "instances",
        ),
        (
            NoisyDepthSensor(),
            "depth_sensor",
            "depth_image camera",
            "depth_image",
        ),
    ],
)
def test_names_and_ports(
    system: LeafSystem, name: str, inputs: str, output: str
) -> None:
    assert system.get_name() == name
    assert ports(system) == (inputs.split(), [output])


def test_ground_truth() -> None:
    labels = {"box": 3, "gone": 4, "c": 7}
    segmenter = GroundTruthInstanceSegmenter(labels=labels)
    labels["late"] = 9  # systems know their labels as they were built
    instances = output_of(segmenter, label_image=LABELS)
    assert isinstance(instances, InstanceMasks)
    assert instances.names == ("box", "c")
    np.testing.assert_array_equal(instances.mask("c"), LABELS == 7)
    detector = GroundTruthTargetDetector(target_label=3)
    mask = output_of(detector, label_image=LABELS)
    assert isinstance(mask, TargetMask)
    np.testing.assert_array_equal(mask.data, LABELS == 3)


def test_detector_of_a_colour() -> None:
    color = np.full((*SHAPE, 4), 255, np.uint8)
    color[10:20, 30:35, :3] = 200, 10, 10
    color[40:50, 30:50, :3] = 10, 10, 200
    for config, patch in (
        (None, np.s_[10:20, 30:35]),
        (HsvTargetConfig(hue=240), np.s_[40:50, 30:50]),
    ):
        expected = np.zeros(SHAPE, bool)
        expected[patch] = True
        system = HsvTargetDetector(config=config, **SIZE)
        mask = output_of(system, color_image=color)
        np.testing.assert_array_equal(mask.data, expected)


def test_segmenter() -> None:
    system = DepthInstanceSegmenter(**SIZE)
    inputs = {"depth_image": blocks(), "camera": CAMERA}
    instances = output_of(system, **inputs)
    assert instances.names == ("segment_0", "segment_1")
    np.testing.assert_array_equal(
        instances.labels, segment_depth(blocks(), CAMERA).labels
    )
    target = np.zeros(SHAPE, bool)
    target[30:36, 42:52] = True
    instances = output_of(system, **inputs, target_mask=TargetMask(target))
    np.testing.assert_array_equal(instances.mask("segment_2"), target)
    large = DepthSegmenterConfig(min_area=200)
    system = DepthInstanceSegmenter(config=large, **SIZE)
    assert len(output_of(system, **inputs).names) == 1


@pytest.mark.parametrize(
    ("system", "image"),
    [
        (DepthInstanceSegmenter(**SIZE), blocks()),
        (GroundTruthTargetDetector(target_label=3), LABELS),
        (GroundTruthInstanceSegmenter(labels={"box": 3}), LABELS),
    ],
    ids=lambda value: type(value).__name__,
)
def test_images_are_pulled_once(system: LeafSystem, image: np.ndarray) -> None:
    (name, *others), _ = ports(system)
    inputs = {name: image} | ({"camera": CAMERA} if others else {})
    context = context_with(system, **inputs)
    output = system.get_output_port()
    first = output.Eval(context)
    context.SetTime(5.0)
    assert output.Eval(context) is first
    fix_inputs(system, context, **{name: np.array(image)})
    assert output.Eval(context) is not first


def noisy(depth: np.ndarray, **arguments: Any) -> np.ndarray:
    system = NoisyDepthSensor(**SIZE, **arguments)
    image = output_of(system, depth_image=depth, camera=CAMERA)
    return np.array(image.data[:, :, 0])


def test_noise_is_that_of_the_seed_and_the_image() -> None:
    """So all who look at a heap at rest see the same."""
    seen = noisy(blocks(), seed=3)
    np.testing.assert_array_equal(seen, noisy(blocks(), seed=3))
    assert np.any(seen != noisy(blocks(), seed=4))
    moved = blocks()
    moved[30, 40] = 0.8
    # Far from what moved, too.
    assert np.any(seen[70:] != noisy(moved, seed=3)[70:])


def test_noise_is_as_large_as_asked_for() -> None:
    depth = blocks()
    depth[:5] = np.inf
    silent = DepthNoise(
        sigma=0,
        inverse_depth_step=0,
        baseline=0,
        max_incidence=1.57079,
        blobs=0,
        speckle=0,
    )
    np.testing.assert_array_equal(
        noisy(depth, noise=silent), np.where(np.isfinite(depth), depth, 0)
    )
    seen = noisy(depth)
    read = seen > 0
    assert not read[:5].any()
    assert 0.8 < read[5:].mean() < 1
    np.testing.assert_allclose(seen[read], depth[read], atol=0.002)


def test_the_colour_of_the_target_in_a_rendered_heap(
    tiny_diagram: SearchDiagram,
) -> None:
    context = tiny_diagram.CreateDefaultContext()
    color, labels = (
        tiny_diagram.GetOutputPort(f"overhead.{name}_image").Eval(context).data
        for name in ("color", "label")
    )
    label = tiny_diagram.station.labels[tiny_diagram.heap.target.name]
    target = labels[:, :, 0] == label
    assert np.count_nonzero(target) >= 50
    found = output_of(HsvTargetDetector(), color_image=np.array(color))
    assert iou(found.data, target) > 0.9
