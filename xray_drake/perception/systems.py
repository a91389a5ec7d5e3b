"""The perception LeafSystems that read ground truth."""

from collections.abc import Mapping

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import Context
from pydrake.systems.sensors import ImageLabel16I

from xray_drake.lifetimes import CollectableLeafSystem
from xray_drake.messages import InstanceMasks, TargetMask
from xray_drake.perception.ground_truth import (
    instances_from_labels,
    target_mask_from_labels,
)


def _labels(image: ImageLabel16I) -> np.ndarray:
    return image.data[:, :, 0]


class GroundTruthTargetDetector(CollectableLeafSystem):
    """Finds the target in the label image.

    .. pydrake_system::

        name: TargetDetector
        input_ports:
        - label_image
        output_ports:
        - target_mask

    ``label_image`` is an ImageLabel16I, ``target_mask`` a
    :class:`~xray_drake.messages.TargetMask`. A detector that reads the colour
    or the depth image takes its place by having the same output.
    """

    def __init__(self, *, target_label: int) -> None:
        """Builds the detector.

        Args:
            target_label: the target's value in the label image.
        """
        super().__init__()
        self.set_name("target_detector")
        self._label = target_label
        self._image = self.DeclareAbstractInputPort(
            "label_image", Value(ImageLabel16I())
        )
        self.DeclareAbstractOutputPort(
            "target_mask",
            alloc=lambda: Value(TargetMask()),
            calc=self._calc_mask,
            prerequisites_of_calc={self._image.ticket()},
        )

    def _calc_mask(self, context: Context, output: AbstractValue) -> None:
        labels = _labels(self._image.Eval(context))
        output.set_value(target_mask_from_labels(labels, self._label))


class GroundTruthInstanceSegmenter(CollectableLeafSystem):
    """Finds all objects in the label image.

    .. pydrake_system::

        name: InstanceSegmenter
        input_ports:
        - label_image
        output_ports:
        - instances

    ``label_image`` is an ImageLabel16I, ``instances`` an
    :class:`~xray_drake.messages.InstanceMasks`.
    """

    def __init__(self, *, labels: Mapping[str, int]) -> None:
        """Builds the segmenter.

        Args:
            labels: object name to its value in the label image.
        """
        super().__init__()
        self.set_name("instance_segmenter")
        self._names = dict(labels)
        self._image = self.DeclareAbstractInputPort(
            "label_image", Value(ImageLabel16I())
        )
        self.DeclareAbstractOutputPort(
            "instances",
            alloc=lambda: Value(InstanceMasks()),
            calc=self._calc_instances,
            prerequisites_of_calc={self._image.ticket()},
        )

    def _calc_instances(self, context: Context, output: AbstractValue) -> None:
        labels = _labels(self._image.Eval(context))
        output.set_value(instances_from_labels(labels, self._names))
