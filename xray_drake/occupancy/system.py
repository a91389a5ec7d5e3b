"""The LeafSystem that infers the occupancy distribution from images."""

from dataclasses import dataclass, field

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context
from pydrake.systems.sensors import ImageDepth32F

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.lifetimes import CollectableLeafSystem
from xray_drake.messages import Message, OccupancyDistribution, TargetMask
from xray_drake.occupancy.observation import OccupancyModel


@dataclass(frozen=True, eq=False)
class _Answered(Message):
    """What the inference saw last, and said.

    Whoever looks after the next step of a heap at rest sees the same image,
    but the framework cannot know.
    """

    depth: np.ndarray = field(
        default_factory=lambda: np.zeros((0, 0), np.float32)
    )
    mask: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), bool))
    camera: PinholeCamera | None = None
    distribution: OccupancyDistribution = field(
        default_factory=OccupancyDistribution
    )

    def is_of(
        self, depth: np.ndarray, mask: np.ndarray, camera: PinholeCamera
    ) -> bool:
        return (
            self.camera is not None
            and self.camera.shape == camera.shape
            and np.array_equal(self.camera.intrinsics, camera.intrinsics)
            and np.array_equal(self.camera.X_WC, camera.X_WC)
            and np.array_equal(self.mask, mask)
            and np.array_equal(self.depth, depth, equal_nan=True)
        )


class OccupancyInference(CollectableLeafSystem):
    """Infers where a hidden target can be, given what the camera sees.

    .. pydrake_system::

        name: OccupancyInference
        input_ports:
        - depth_image
        - target_mask
        - camera
        output_ports:
        - occupancy

    ``depth_image`` is an ImageDepth32F, ``target_mask`` a TargetMask,
    ``camera`` a PinholeCamera and ``occupancy`` an OccupancyDistribution. The
    inference runs when ``occupancy`` is evaluated, once per new image: an image
    that is rendered again and shows the same is answered from memory.
    """

    def __init__(
        self,
        *,
        inference: OccupancyModel,
        width: int = 512,
        height: int = 384,
    ) -> None:
        """Declares the ports.

        Args:
            inference: the method.
            width: of the images, pixels.
            height: of the images, pixels.
        """
        super().__init__()
        self.set_name("occupancy_inference")
        self._inference = inference
        self._shape = height, width
        camera = PinholeCamera(width, height, np.eye(3), np.eye(4))
        self._inputs = (
            self.declare_input("depth_image", ImageDepth32F(width, height)),
            self.declare_input("target_mask", TargetMask()),
            self.declare_input("camera", camera),
        )
        self._answered = self.DeclareCacheEntry(
            description="last answer",
            allocate=lambda: AbstractValue.Make(_Answered()),
            calc=self._calc_answered,
            prerequisites_of_calc={port.ticket() for port in self._inputs},
        )
        self.DeclareAbstractOutputPort(
            name="occupancy",
            alloc=lambda: AbstractValue.Make(OccupancyDistribution()),
            calc=self._calc_occupancy,
            prerequisites_of_calc={self._answered.ticket()},
        )

    def _calc_occupancy(self, context: Context, output: AbstractValue) -> None:
        answered: _Answered = self._answered.Eval(context)
        output.set_value(answered.distribution)

    def _calc_answered(self, context: Context, output: AbstractValue) -> None:
        image, mask, camera = (port.Eval(context) for port in self._inputs)
        if camera.shape != self._shape:
            raise ValueError(
                f"{self.get_name()}: the camera's images are {camera.shape}, "
                f"the system was built for {self._shape}"
            )
        depth = image.data[:, :, 0]
        # What this context's entry held before its inputs changed.
        known: _Answered = output.get_value()
        if not known.is_of(depth, mask.data, camera):
            output.set_value(
                _Answered(
                    np.array(depth),
                    mask.data,
                    camera,
                    self._inference.infer(depth, mask.data, camera),
                )
            )
