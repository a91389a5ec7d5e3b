"""The perception systems alone: fix an image, read the masks."""

from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, LeafSystem
from pydrake.systems.sensors import ImageLabel16I

from tests.ports import ports
from xray_drake.messages import InstanceMasks, TargetMask
from xray_drake.perception.systems import (
    GroundTruthInstanceSegmenter,
    GroundTruthTargetDetector,
)

LABELS = np.array([[0, 7, 7, 9], [0, 7, 3, 9], [32767, 3, 3, 9]], np.int16)


def fix(system: LeafSystem, context: Context, labels: np.ndarray) -> None:
    image = ImageLabel16I(labels.shape[1], labels.shape[0])
    image.mutable_data[:, :, 0] = labels
    system.GetInputPort("label_image").FixValue(
        context, AbstractValue.Make(image)
    )


def test_detector() -> None:
    system = GroundTruthTargetDetector(target_label=3)
    assert ports(system) == (["label_image"], ["target_mask"])
    context = system.CreateDefaultContext()
    fix(system, context, LABELS)
    mask = system.GetOutputPort("target_mask").Eval(context)
    assert isinstance(mask, TargetMask)
    np.testing.assert_array_equal(mask.data, LABELS == 3)


def test_segmenter() -> None:
    system = GroundTruthInstanceSegmenter(labels={"box": 3, "gone": 4, "c": 7})
    assert ports(system) == (["label_image"], ["instances"])
    context = system.CreateDefaultContext()
    fix(system, context, LABELS)
    instances = system.GetOutputPort("instances").Eval(context)
    assert isinstance(instances, InstanceMasks)
    assert instances.names == ("box", "c")
    np.testing.assert_array_equal(instances.mask("c"), LABELS == 7)
    assert instances.areas().tolist() == [3, 3]


def test_outputs_follow_the_image_and_nothing_else() -> None:
    for system, port in (
        (GroundTruthTargetDetector(target_label=3), "target_mask"),
        (GroundTruthInstanceSegmenter(labels={"box": 3}), "instances"),
    ):
        output = system.GetOutputPort(port)
        context = system.CreateDefaultContext()
        fix(system, context, LABELS)
        first = output.Eval(context)
        context.SetTime(5.0)
        assert output.Eval(context) is first
        fix(system, context, np.zeros_like(LABELS))
        assert output.Eval(context) is not first


def test_systems_know_their_labels_only_as_they_were_built() -> None:
    labels = {"box": 3}
    system = GroundTruthInstanceSegmenter(labels=labels)
    labels["cup"] = 7
    context = system.CreateDefaultContext()
    fix(system, context, LABELS)
    assert system.GetOutputPort("instances").Eval(context).names == ("box",)


def test_names_are_those_of_the_diagram() -> None:
    detector = GroundTruthTargetDetector(target_label=3)
    segmenter = GroundTruthInstanceSegmenter(labels={})
    assert detector.get_name() == "target_detector"
    assert segmenter.get_name() == "instance_segmenter"


def test_on_a_rendered_heap(recorded_observation: Any) -> None:
    seen = recorded_observation
    target = seen.heap.target.name
    system = GroundTruthInstanceSegmenter(labels=seen.label_of)
    context = system.CreateDefaultContext()
    fix(system, context, seen.labels)
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
