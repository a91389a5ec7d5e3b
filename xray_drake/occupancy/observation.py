"""What an inference can be asked about."""

from typing import Protocol

import numpy as np

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.readings import (
    check_shapes,
    depth_readings,
    has_reading,
)
from xray_drake.messages import OccupancyDistribution


class OccupancyModel(Protocol):
    """Anything that infers where the target can be."""

    def infer(
        self,
        depth: np.ndarray,
        target_mask: np.ndarray,
        camera: PinholeCamera,
    ) -> OccupancyDistribution:
        """Infers the distribution from one augmented depth image.

        Args:
            depth: (H, W) float32 z-depth, m; 0, inf and NaN are no reading.
            target_mask: (H, W) bool modal mask, blank where it is not seen.
            camera: the camera of both.
        """
        ...


def check_observation(
    depth: np.ndarray, mask: np.ndarray, camera: PinholeCamera
) -> np.ndarray:
    """Refuses what nothing can be inferred from.

    Args:
        depth: (H, W) z-depth, m; 0, inf and NaN are no reading.
        mask: (H, W) bool.
        camera: of both.

    Returns:
        (H, W) float32: the depth image's readings, see
        :func:`~xray_drake.geometry.readings.depth_readings`.

    Raises:
        ValueError: images of another shape, or a depth image without any
            reading, of integers, or in another unit.
    """
    depth = np.asarray(depth)
    check_shapes({"depth image": depth, "target mask": mask}, camera)
    depth = depth_readings(depth, camera)
    if not has_reading(depth).any():
        raise ValueError(
            "the depth image has no reading at all (every pixel is 0, inf or "
            "NaN); check the sensor's range and that it has rendered"
        )
    return depth
