"""What exact inferences have in common: they count poses of the target."""

from abc import ABC, abstractmethod

import numpy as np

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.floor_grid import Floor, observed_heights
from xray_drake.messages import OccupancyDistribution
from xray_drake.occupancy.geometric.config import ExactInferenceConfig
from xray_drake.occupancy.observation import check_observation


class PoseCounting(ABC):
    """Infers the distribution by counting the poses that explain an image.

    It is the sum of the amodal masks of all accepted poses, divided by its
    maximum (paper section IV.A), and zero on pixels that show the floor. A
    subclass says which poses are tried and accepted.

    Attributes:
        config: the numbers.
        method: what distributions are said to be made by.
    """

    method = "geometric"

    def __init__(
        self,
        config: ExactInferenceConfig,
        floor: Floor,
        *,
        lowest: float,
        tallest: float,
    ) -> None:
        """Keeps what all images are asked about.

        Args:
            config: the numbers.
            floor: inside of the bin.
            lowest: least height of the target over its poses, m.
            tallest: greatest, m.
        """
        self.config = config
        self._floor = floor
        self._lowest = lowest
        self._tallest = tallest

    def infer(
        self,
        depth: np.ndarray,
        target_mask: np.ndarray,
        camera: PinholeCamera,
    ) -> OccupancyDistribution:
        """Infers where the target can be.

        Args:
            depth: (H, W) float32 z-depth of the scene, m; 0, inf and NaN are
                no reading and hide nothing.
            target_mask: (H, W) bool, the target's modal mask as detected;
                blank where it is not seen.
            camera: the camera of both.

        Returns:
            The distribution; all zero if the target cannot be anywhere.

        Raises:
            ValueError: an array of another shape, a depth image without any
                reading, or a camera that is not above the target.
        """
        mask = np.asarray(target_mask, dtype=bool)
        depth = check_observation(depth, mask, camera)
        if camera.X_WC[2, 3] <= self._tallest:
            raise ValueError(
                f"the camera must be above the target, not at z = "
                f"{camera.X_WC[2, 3]:.3f} m"
            )
        heights = observed_heights(depth, camera, self.config.depth_tolerance)
        mask = self._possible(mask, camera)
        if mask.any():
            total = self._count_seen(heights, mask, camera)
        else:
            total = self._count_hidden(heights, camera)
        low = min(self.config.floor_height, self._lowest / 2)
        total[(heights < low) & (heights > -np.inf) & ~mask] = 0
        return self._scaled(total, mask)

    def _scaled(
        self, total: np.ndarray, mask: np.ndarray
    ) -> OccupancyDistribution:
        """Divides a sum by its maximum.

        Args:
            total: (H, W) float32; changed.
            mask: (H, W) bool, where the target is seen.
        """
        largest = total.max()
        if largest > 0:
            total /= largest
        return self._distribution(total)

    def _distribution(self, data: np.ndarray) -> OccupancyDistribution:
        return OccupancyDistribution(
            data=data, support_threshold=0.0, method=self.method
        )

    @abstractmethod
    def _possible(self, mask: np.ndarray, camera: PinholeCamera) -> np.ndarray:
        """Returns the (H, W) pixels of a mask where a target can be seen."""

    @abstractmethod
    def _count_seen(
        self, heights: np.ndarray, mask: np.ndarray, camera: PinholeCamera
    ) -> np.ndarray:
        """Sums the accepted masks of a target that is seen.

        Args:
            heights: (H, W) float32 of the observed surface, m; −inf where
                there is no reading.
            mask: (H, W) bool, where the target is seen; not blank.
            camera: of both.

        Returns:
            (H, W) float32, changed by the caller.
        """

    @abstractmethod
    def _count_hidden(
        self, heights: np.ndarray, camera: PinholeCamera
    ) -> np.ndarray:
        """Sums those of a target that is not seen; see ``_count_seen``."""
