"""The perception LeafSystems that read what a real sensor gives."""

import zlib

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import Context
from pydrake.systems.sensors import ImageDepth32F, ImageRgba8U

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.lifetimes import CollectableLeafSystem
from xray_drake.messages import InstanceMasks, TargetMask
from xray_drake.perception.depth_noise import DepthNoise
from xray_drake.perception.depth_segmenter import (
    DepthSegmenterConfig,
    segment_depth,
)
from xray_drake.perception.hsv_target import HsvTargetConfig, detect_target
from xray_drake.seeding import stream


def _some_camera(width: int, height: int) -> Value:
    return Value(PinholeCamera(width, height, np.eye(3), np.eye(4)))


class HsvTargetDetector(CollectableLeafSystem):
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
        super().__init__()
        self.set_name("target_detector")
        self._config = config
        self._image = self.DeclareAbstractInputPort(
            "color_image", Value(ImageRgba8U(width, height))
        )
        self.DeclareAbstractOutputPort(
            "target_mask",
            alloc=lambda: Value(TargetMask()),
            calc=self._calc_mask,
            prerequisites_of_calc={self._image.ticket()},
        )

    def _calc_mask(self, context: Context, output: AbstractValue) -> None:
        image: ImageRgba8U = self._image.Eval(context)
        output.set_value(detect_target(image.data[:, :, :3], self._config))


class DepthInstanceSegmenter(CollectableLeafSystem):
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
        config: DepthSegmenterConfig | None = None,
        width: int = 512,
        height: int = 384,
    ) -> None:
        """Builds the segmenter.

        Args:
            config: its numbers.
            width: of the images, pixels.
            height: of the images, pixels.
        """
        super().__init__()
        self.set_name("instance_segmenter")
        self._config = config
        self._depth_image = self.DeclareAbstractInputPort(
            "depth_image", Value(ImageDepth32F(width, height))
        )
        self._camera = self.DeclareAbstractInputPort(
            "camera", _some_camera(width, height)
        )
        self._target_mask = self.DeclareAbstractInputPort(
            "target_mask", Value(TargetMask())
        )
        self.DeclareAbstractOutputPort(
            "instances",
            alloc=lambda: Value(InstanceMasks()),
            calc=self._calc_instances,
            prerequisites_of_calc={
                self._depth_image.ticket(),
                self._camera.ticket(),
                self._target_mask.ticket(),
            },
        )

    def _calc_instances(self, context: Context, output: AbstractValue) -> None:
        image: ImageDepth32F = self._depth_image.Eval(context)
        target = None
        if self._target_mask.HasValue(context):
            target = self._target_mask.Eval(context).data
        output.set_value(
            segment_depth(
                image.data[:, :, 0],
                self._camera.Eval(context),
                self._config,
                target=target,
            )
        )


class NoisyDepthSensor(CollectableLeafSystem):
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
        super().__init__()
        self.set_name("depth_sensor")
        self._noise = noise or DepthNoise()
        self._seed = seed
        self._image = self.DeclareAbstractInputPort(
            "depth_image", Value(ImageDepth32F(width, height))
        )
        self._camera = self.DeclareAbstractInputPort(
            "camera", _some_camera(width, height)
        )
        self.DeclareAbstractOutputPort(
            "depth_image",
            alloc=lambda: Value(ImageDepth32F(width, height)),
            calc=self._calc_depth,
            prerequisites_of_calc={
                self._image.ticket(),
                self._camera.ticket(),
            },
        )

    def _calc_depth(self, context: Context, output: AbstractValue) -> None:
        depth = np.array(self._image.Eval(context).data[:, :, 0])
        camera: PinholeCamera = self._camera.Eval(context)
        noisy = self._noise.noisy(
            depth,
            float(camera.intrinsics[0, 0]),
            stream(self._seed, "depth_noise", zlib.crc32(depth.tobytes())),
        )
        image: ImageDepth32F = output.get_mutable_value()
        image.mutable_data[:, :, 0] = noisy
