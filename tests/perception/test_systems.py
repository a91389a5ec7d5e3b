"""The perception systems alone: fix what the sensor gives, read the output."""

from typing import Any

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, LeafSystem
from pydrake.systems.sensors import (
    ImageDepth32F,
    ImageLabel16I,
    ImageRgba8U,
)

from tests.perception.segmentation_metrics import score_segmentation
from tests.ports import ports
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

WIDTH, HEIGHT = 128, 96
CAMERA = PinholeCamera(
    WIDTH,
    HEIGHT,
    np.array([[138.0, 0, 63.5], [0, 138.0, 47.5], [0, 0, 1]]),
    np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.8], [0, 0, 0, 1]]),
)


def blocks() -> np.ndarray:
    depth = np.full((HEIGHT, WIDTH), 0.8, np.float32)
    depth[30:60, 40:60] = 0.75
    depth[30:40, 80:90] = 0.78
    return depth


LABELS = np.array([[0, 7, 7, 9], [0, 7, 3, 9], [32767, 3, 3, 9]], np.int16)

IMAGES = {
    "color_image": ImageRgba8U,
    "depth_image": ImageDepth32F,
    "label_image": ImageLabel16I,
}


def fix(system: LeafSystem, context: Context, **inputs: Any) -> None:
    for name, value in inputs.items():
        if isinstance(value, np.ndarray):
            image = IMAGES[name](value.shape[1], value.shape[0])
            image.mutable_data[:] = value.reshape(*value.shape[:2], -1)
            value = image
        system.GetInputPort(name).FixValue(context, AbstractValue.Make(value))


def test_ground_truth() -> None:
    labels = {"box": 3, "gone": 4, "c": 7}
    detector = GroundTruthTargetDetector(target_label=3)
    segmenter = GroundTruthInstanceSegmenter(labels=labels)
    labels["late"] = 9  # systems know their labels as they were built
    assert detector.get_name() == "target_detector"
    assert segmenter.get_name() == "instance_segmenter"
    assert ports(detector) == (["label_image"], ["target_mask"])
    assert ports(segmenter) == (["label_image"], ["instances"])
    context = detector.CreateDefaultContext()
    fix(detector, context, label_image=LABELS)
    mask = detector.GetOutputPort("target_mask").Eval(context)
    assert isinstance(mask, TargetMask)
    np.testing.assert_array_equal(mask.data, LABELS == 3)
    context = segmenter.CreateDefaultContext()
    fix(segmenter, context, label_image=LABELS)
    instances = segmenter.GetOutputPort("instances").Eval(context)
    assert isinstance(instances, InstanceMasks)
    assert instances.names == ("box", "c")
    np.testing.assert_array_equal(instances.mask("c"), LABELS == 7)


def test_detector() -> None:
    system = HsvTargetDetector(width=WIDTH, height=HEIGHT)
    assert system.get_name() == "target_detector"
    assert ports(system) == (["color_image"], ["target_mask"])
    context = system.CreateDefaultContext()
    color = np.full((HEIGHT, WIDTH, 4), 255, np.uint8)
    fix(system, context, color_image=color)
    output = system.GetOutputPort("target_mask")
    blank = output.Eval(context)
    assert isinstance(blank, TargetMask)
    assert blank.data.shape == (HEIGHT, WIDTH)
    assert not blank.data.any()
    color[10:20, 30:35, :3] = 200, 10, 10
    fix(system, context, color_image=color)
    mask = output.Eval(context).data
    assert mask.sum() == 50
    assert mask[10:20, 30:35].all()


def test_detector_of_another_colour() -> None:
    system = HsvTargetDetector(
        config=HsvTargetConfig(hue=240), width=WIDTH, height=HEIGHT
    )
    context = system.CreateDefaultContext()
    color = np.zeros((HEIGHT, WIDTH, 4), np.uint8)
    color[:, :, 2] = 200
    fix(system, context, color_image=color)
    assert system.GetOutputPort("target_mask").Eval(context).data.all()


def test_segmenter() -> None:
    system = DepthInstanceSegmenter(width=WIDTH, height=HEIGHT)
    assert system.get_name() == "instance_segmenter"
    inputs = ["depth_image", "camera", "target_mask"]
    assert ports(system) == (inputs, ["instances"])
    context = system.CreateDefaultContext()
    fix(system, context, depth_image=blocks(), camera=CAMERA)
    output = system.GetOutputPort("instances")
    instances = output.Eval(context)
    assert isinstance(instances, InstanceMasks)
    assert instances.names == ("segment_0", "segment_1")
    np.testing.assert_array_equal(
        instances.labels, segment_depth(blocks(), CAMERA).labels
    )
    target = np.zeros((HEIGHT, WIDTH), bool)
    target[30:36, 42:52] = True
    fix(system, context, target_mask=TargetMask(target))
    instances = output.Eval(context)
    assert instances.names == ("segment_0", "segment_1", "segment_2")
    np.testing.assert_array_equal(instances.mask("segment_2"), target)


def test_segmenter_with_other_numbers() -> None:
    system = DepthInstanceSegmenter(
        config=DepthSegmenterConfig(min_area=200), width=WIDTH, height=HEIGHT
    )
    context = system.CreateDefaultContext()
    fix(system, context, depth_image=blocks(), camera=CAMERA)
    assert len(system.GetOutputPort("instances").Eval(context).names) == 1


@pytest.mark.parametrize(
    ("system", "image"),
    [
        (DepthInstanceSegmenter(width=WIDTH, height=HEIGHT), blocks()),
        (GroundTruthTargetDetector(target_label=3), LABELS),
        (GroundTruthInstanceSegmenter(labels={"box": 3}), LABELS),
    ],
    ids=lambda value: type(value).__name__,
)
def test_images_are_pulled_once(system: LeafSystem, image: np.ndarray) -> None:
    (name, *others), (port,) = ports(system)
    context = system.CreateDefaultContext()
    fix(system, context, **{name: image})
    if "camera" in others:
        fix(system, context, camera=CAMERA)
    output = system.GetOutputPort(port)
    first = output.Eval(context)
    context.SetTime(5.0)
    assert output.Eval(context) is first
    fix(system, context, **{name: np.array(image)})
    assert output.Eval(context) is not first


def noisy(depth: np.ndarray, **arguments: Any) -> np.ndarray:
    system = NoisyDepthSensor(width=WIDTH, height=HEIGHT, **arguments)
    assert system.get_name() == "depth_sensor"
    assert ports(system) == (["depth_image", "camera"], ["depth_image"])
    context = system.CreateDefaultContext()
    fix(system, context, depth_image=depth, camera=CAMERA)
    output = system.GetOutputPort("depth_image")
    return np.array(output.Eval(context).data[:, :, 0])


def test_noise_is_that_of_the_seed_and_the_image() -> None:
    seen = noisy(blocks(), seed=3)
    np.testing.assert_array_equal(seen, noisy(blocks(), seed=3))
    assert np.any(seen != noisy(blocks(), seed=4))
    moved = blocks()
    moved[30, 40] = 0.8
    # Far from what moved, too.
    assert np.any(seen[70:] != noisy(moved, seed=3)[70:])


def test_all_who_look_at_a_heap_at_rest_see_the_same() -> None:
    system = NoisyDepthSensor(width=WIDTH, height=HEIGHT)
    context = system.CreateDefaultContext()
    fix(system, context, depth_image=blocks(), camera=CAMERA)
    output = system.GetOutputPort("depth_image")
    first = np.array(output.Eval(context).data)
    context.SetTime(1.0)
    fix(system, context, depth_image=blocks())
    np.testing.assert_array_equal(output.Eval(context).data, first)


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


@pytest.fixture(scope="module")
def picture(tiny_diagram: SearchDiagram) -> dict[str, Any]:
    context = tiny_diagram.CreateDefaultContext()
    return {
        name: tiny_diagram.GetOutputPort(f"overhead.{name}").Eval(context)
        for name in ("color_image", "depth_image", "label_image", "camera")
    }


def test_on_a_rendered_heap(
    picture: dict[str, Any], tiny_diagram: SearchDiagram
) -> None:
    truth = picture["label_image"].data[:, :, 0]
    label = tiny_diagram.station.labels
    detector = HsvTargetDetector()
    context = detector.CreateDefaultContext()
    detector.GetInputPort("color_image").FixValue(
        context, AbstractValue.Make(picture["color_image"])
    )
    found = detector.GetOutputPort("target_mask").Eval(context)
    target = truth == label[tiny_diagram.heap.target.name]
    assert np.count_nonzero(target) >= 50
    both = np.count_nonzero(found.data & target)
    assert both > 0.9 * np.count_nonzero(found.data | target)

    segmenter = DepthInstanceSegmenter()
    context = segmenter.CreateDefaultContext()
    for name, value in (
        ("depth_image", picture["depth_image"]),
        ("camera", picture["camera"]),
        ("target_mask", found),
    ):
        segmenter.GetInputPort(name).FixValue(
            context, AbstractValue.Make(value)
        )
    instances = segmenter.GetOutputPort("instances").Eval(context)
    # The target, the book on it, block and plank; not the bin.
    objects = np.where(np.isin(truth, list(label.values())), truth, -1)
    score = score_segmentation(objects.astype(int), instances.labels)
    assert (score.objects, score.segments, score.recall) == (4, 4, 1)
    assert score.mean_iou > 0.9


def test_ground_truth_on_a_rendered_heap(recorded_observation: Any) -> None:
    seen = recorded_observation
    target = seen.heap.target.name
    system = GroundTruthInstanceSegmenter(labels=seen.label_of)
    context = system.CreateDefaultContext()
    fix(system, context, label_image=seen.labels)
    instances = system.GetOutputPort("instances").Eval(context)
    areas = dict(zip(instances.names, instances.areas(), strict=True))
    # The pad is under the book, as is the target but for one end.
    assert set(areas) == {target, "book", "block", "plank"}
    assert 50 <= areas[target] < 120
    assert areas["book"] > 2000
    # The book is 2.5 cm up, the plank 1.5 cm.
    for name, top in (("book", 0.025), ("plank", 0.015)):
        depth = seen.depth[instances.mask(name)]
        np.testing.assert_allclose(np.median(depth), 0.8 - top, atol=1e-3)
