"""Inference on images that are smaller than the camera's."""

import cv2
import numpy as np

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.messages import OccupancyDistribution
from xray_drake.occupancy.observation import OccupancyModel, check_observation

_LARGE = 640
"""Images wider than this are reduced to it where nothing else is asked for,
pixels."""


def usual_scale(width: int) -> float:
    """Returns the scale at which images of a width (pixels) are looked at."""
    return min(1.0, _LARGE / width)


class ScaledInference:
    """Reduces images, asks an inference, and enlarges its answer.

    Of the pixels that become one, the one in the middle counts: depths and
    masks are not mixed.
    """

    def __init__(self, model: OccupancyModel, scale: float) -> None:
        """Takes an inference.

        Args:
            model: the inference.
            scale: of the sides of images, in (0, 1].
        """
        self.model = model
        self.scale = scale

    def infer(
        self,
        depth: np.ndarray,
        target_mask: np.ndarray,
        camera: PinholeCamera,
    ) -> OccupancyDistribution:
        """Infers where the target can be.

        Args:
            depth: (H, W) z-depth, m; 0, inf and NaN are no reading.
            target_mask: (H, W) bool, the target's modal mask as detected;
                blank where it is not seen.
            camera: of both.

        Returns:
            The distribution, at the camera's size.

        Raises:
            ValueError: as the inference itself.
        """
        width, height = (
            max(1, round(self.scale * side)) for side in camera.shape[::-1]
        )
        mask = np.asarray(target_mask, dtype=bool)
        depth = check_observation(depth, mask, camera)

        def sampled(image: np.ndarray, width: int, height: int) -> np.ndarray:
            return cv2.resize(
                image, (width, height), interpolation=cv2.INTER_NEAREST_EXACT
            )

        small = sampled(mask.astype(np.uint8), width, height) > 0
        if mask.any() and not small.any():
            # A target that is seen must not become one that is not.
            rows, columns = np.nonzero(mask)
            small[
                int(rows.mean() * height / camera.height),
                int(columns.mean() * width / camera.width),
            ] = True
        answer = self.model.infer(
            sampled(depth, width, height),
            small,
            camera.resized(width, height),
        )
        return OccupancyDistribution(
            data=sampled(answer.data, camera.width, camera.height),
            support_threshold=answer.support_threshold,
            method=answer.method,
        )
