"""The perception LeafSystems: on ground truth, and on what a sensor gives."""

import zlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import Context
from pydrake.systems.sensors import ImageDepth32F, ImageLabel16I, ImageRgba8U

from xray_drake.cell.bin import Bin
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.lifetimes import CollectableLeafSystem
from xray_drake.messages import InstanceMasks, TargetMask
from xray_drake.perception.depth_noise import DepthNoise
from xray_drake.perception.depth_segmenter import (
    DepthSegmenterConfig,
    segment_depth,
)
from xray_drake.perception.ground_truth import instances_from_labels
from xray_drake.perception.hsv_target import HsvTargetConfig, detect_target
from xray_drake.seeding import stream


class _Perception(CollectableLeafSystem):
    """One output, computed from all inputs by ``_compute``."""

    def __init__(
        self,
        name: str,
        inputs: Mapping[str, Any],
        output: str,
        alloc: Callable[[], Any],
    ) -> None:
        """Declares the ports.

        Args:
            name: of the system.
            inputs: port to a value of the type that it takes.
            output: name of the port.
            alloc: makes a value of the type that it gives.
        """
        super().__init__()
        self.set_name(name)
        ports = [self.declare_input(*item) for item in inputs.items()]
        self.DeclareAbstractOutputPort(
            output,
            alloc=lambda: Value(alloc()),
            calc=self._calc,
            prerequisites_of_calc={port.ticket() for port in ports},
        )

    def _calc(self, context: Context, output: AbstractValue) -> None:
        values = [
            port.Eval(context) if port.HasValue(context) else None
            for port in map(self.get_input_port, range(self.num_input_ports()))
        ]
        output.set_value(self._compute(*values))

    def _compute(self, *inputs: Any) -> Any:
        """Returns the output; an input that is not connected is None."""
        raise NotImplementedError


def _camera(width: int, height: int) -> PinholeCamera:
    return PinholeCamera(width, height, np.eye(3), np.eye(4))


class GroundTruthTargetDetector(_Perception):
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
        super().__init__(
            "target_detector",
            {"label_image": ImageLabel16I()},
            "target_mask",
            TargetMask,
        )
        self._label = target_label

    def _compute(self, image: ImageLabel16I) -> TargetMask:
        return TargetMask(image.data[:, :, 0] == self._label)


class GroundTruthInstanceSegmenter(_Perception):
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
        super().__init__(
            "instance_segmenter",
            {"label_image": ImageLabel16I()},
            "instances",
            InstanceMasks,
        )
        self._names = dict(labels)

    def _compute(self, image: ImageLabel16I) -> InstanceMasks:
        return instances_from_labels(image.data[:, :, 0], self._names)


class HsvTargetDetector(_Perception):
    """Finds the target by its colour.

    .. pydrake_system::

        name: TargetDetector
        input_ports:
        - color_image
        output_ports:
        - target_mask

    ``color_image`` is an ImageRgba8U, ``target_mask`` a
    :class:`~xray_drake.messages.TargetMask`, blank where nothing has the
    target's colour.
    """

    def __init__(
        self,
        *,
        config: HsvTargetConfig | None = None,
        width: int = 512,
        height: int = 384,
    ) -> None:
        """Builds the detector.

        Args:
            config: which colours are the target's; by default red.
            width: of the images, pixels.
            height: of the images, pixels.
        """
        super().__init__(
            "target_detector",
            {"color_image": ImageRgba8U(width, height)},
            "target_mask",
            TargetMask,
        )
        self._config = config

    def _compute(self, image: ImageRgba8U) -> TargetMask:
        return detect_target(image.data[:, :, :3], self._config)


class DepthInstanceSegmenter(_Perception):
    """Finds all objects by the shape of the surface.

    .. pydrake_system::

        name: InstanceSegmenter
        input_ports:
        - depth_image
        - camera
        - target_mask (optional)
        output_ports:
        - instances

    ``depth_image`` is an ImageDepth32F, ``camera`` a PinholeCamera,
    ``target_mask`` a TargetMask, and ``instances`` an
    :class:`~xray_drake.messages.InstanceMasks`. Where a target mask comes in
    and is not blank, it is an instance of its own.
    """

    def __init__(
        self,
        *,
        bin_: Bin | None = None,
        config: DepthSegmenterConfig | None = None,
        width: int = 512,
        height: int = 384,
    ) -> None:
        """Builds the segmenter.

        Args:
            bin_: in which the objects lie; by default the nominal bin.
            config: its numbers.
            width: of the images, pixels.
            height: of the images, pixels.
        """
        super().__init__(
            "instance_segmenter",
            {
                "depth_image": ImageDepth32F(width, height),
                "camera": _camera(width, height),
                "target_mask": TargetMask(),
            },
            "instances",
            InstanceMasks,
        )
        self._bin, self._config = bin_, config

    def _compute(
        self,
        image: ImageDepth32F,
        camera: PinholeCamera,
        target: TargetMask | None,
    ) -> InstanceMasks:
        mask = None if target is None else target.data
        depth = image.data[:, :, 0]
        return segment_depth(
            depth, camera, self._config, bin_=self._bin, target=mask
        )


class NoisyDepthSensor(_Perception):
    """Makes of a rendered depth image what a real sensor would see.

    .. pydrake_system::

        name: DepthSensor
        input_ports:
        - depth_image
        - camera
        output_ports:
        - depth_image

    Both images are an ImageDepth32F, ``camera`` is a PinholeCamera. Where there
    is no reading, the output is 0. The noise is the seed's and the image's: who
    looks again at a heap at rest sees the same, and so do all who look; when
    anything has moved, all of it is drawn anew.
    """

    def __init__(
        self,
        *,
        noise: DepthNoise | None = None,
        seed: int = 0,
        width: int = 512,
        height: int = 384,
    ) -> None:
        """Builds the sensor.

        Args:
            noise: its figures.
            seed: of the noise; with the image it decides.
            width: of the images, pixels.
            height: of the images, pixels.
        """
        super().__init__(
            "depth_sensor",
            {
                "depth_image": ImageDepth32F(width, height),
                "camera": _camera(width, height),
            },
            "depth_image",
            lambda: ImageDepth32F(width, height),
        )
        self._noise = noise or DepthNoise()
        self._seed = seed

    def _compute(
        self, image: ImageDepth32F, camera: PinholeCamera
    ) -> ImageDepth32F:
        depth = np.array(image.data[:, :, 0])
        random = stream(self._seed, "depth_noise", zlib.crc32(depth.tobytes()))
        focal_length = float(camera.intrinsics[0, 0])
        seen = ImageDepth32F(image.width(), image.height())
        noisy = self._noise.noisy(depth, focal_length, random)
        seen.mutable_data[:, :, 0] = noisy
        return seen
