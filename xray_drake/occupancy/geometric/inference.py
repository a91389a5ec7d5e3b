"""▲ Geometric inference: the poses of a target that explain an image."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from xray_drake.cell.bin import Bin
from xray_drake.configuration import check
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.floor_grid import Floor, observed_heights
from xray_drake.messages import OccupancyDistribution
from xray_drake.occupancy.geometric.config import (
    POSES,
    GeometricConfig,
    check_label,
)
from xray_drake.occupancy.geometric.flat import FlatPoses
from xray_drake.occupancy.geometric.label_answer import answer_label
from xray_drake.occupancy.geometric.resting import RestingPoses
from xray_drake.occupancy.observation import check_observation
from xray_drake.scene.object_model import ObjectModel


class Poses(Protocol):
    """The poses that a target is searched in, and how they are compared.

    Attributes:
        lowest: least height of the target over its poses, m.
        tallest: greatest, m.
        seen_at: heights between which a pixel of the target is above the
            floor that it can stand on, m.
    """

    lowest: float
    tallest: float
    seen_at: tuple[float, ...]

    def count_seen(
        self, heights: np.ndarray, mask: np.ndarray, camera: PinholeCamera
    ) -> np.ndarray:
        """Sums the masks of the poses that look as a target that is seen.

        Args:
            heights: (H, W) float32 of the observed surface, m; −inf where
                there is no reading.
            mask: (H, W) bool, where the target is seen; not blank.
            camera: of both.

        Returns:
            (H, W) float32, changed by the caller.
        """
        ...

    def count_hidden(
        self, heights: np.ndarray, camera: PinholeCamera
    ) -> np.ndarray:
        """Sums those in which nothing is seen; see :meth:`count_seen`."""
        ...


@dataclass(frozen=True)
class Summing:
    """How the poses that explain an image are summed up to an answer.

    Attributes:
        seen: poses, heights, mask, camera and config to the (H, W) float32 of
            a target that is seen; see :meth:`Poses.count_seen`.
        poses: those of ``POSES`` that it takes.
        blank_tolerance: replaces the config's, if given.
        peak: of the config, to the maximum that a hidden target's sum is
            scaled to.
        scaled: the sum of a target that is seen is scaled, too: to 1.
        check: raises ValueError for a config that it cannot work with.
    """

    seen: Callable[..., np.ndarray]
    poses: tuple[str, ...] = POSES
    blank_tolerance: float | None = None
    peak: Callable[[GeometricConfig], float] = lambda config: 1.0
    scaled: bool = True
    check: Callable[[GeometricConfig], None] = lambda config: None


def _count(
    poses: Poses,
    heights: np.ndarray,
    mask: np.ndarray,
    camera: PinholeCamera,
    config: GeometricConfig,
) -> np.ndarray:
    return poses.count_seen(heights, mask, camera)


SUMS: Mapping[str, Summing] = {
    "geometric": Summing(_count),
    # The label's candidates of a hidden target show no pixel.
    "geometric_label": Summing(
        answer_label,
        poses=("flat",),
        blank_tolerance=0.0,
        peak=lambda config: config.label.peak,
        scaled=False,
        check=check_label,
    ),
}
"""Ways to sum poses, by the inference's name (``choices.OCCUPANCIES``)."""


class GeometricInference:
    """Finds where a target can be, from what the camera sees and its mesh.

    The candidates (:class:`~.flat.FlatPoses` or
    :class:`~.resting.RestingPoses`) are tried at about every pixel and in
    every orientation. One is accepted if it would look as observed: if the
    target is not seen, hardly any of it shows; if it is, its IoU with the
    observed mask is nearly that of the best one
    (:class:`~.acceptance.AcceptanceRule`). A pixel would show the target where
    the observed surface is lower than the target, where there is no reading,
    and where the target is observed.

    What the accepted ones say is summed up in one of two ways. "geometric"
    adds their amodal masks and divides by the maximum (paper section IV.A).
    "geometric_label" answers with the paper's label as far as the image lets
    it be known (:func:`~.label_answer.answer_label`); of a hidden target so
    many labels are possible that the sum over all poses, with a lower peak,
    stands for each. Both are zero on pixels that show the floor. Mask pixels
    outside the floor are ignored.

    Attributes:
        config: the numbers.
        method: what distributions are said to be made by.
        poses: the candidates.
    """

    def __init__(
        self,
        target: ObjectModel,
        config: GeometricConfig | None = None,
        method: str = "geometric",
        *,
        floor: Floor | None = None,
    ) -> None:
        """Prepares the silhouettes.

        Args:
            target: what is searched for.
            config: the numbers; ``config.poses`` chooses the candidates.
            method: one of :data:`SUMS`.
            floor: inside of the bin's; by default the nominal bin's.

        Raises:
            ValueError: no such poses, or none that ``method`` takes; a number
                that is out of range; a target without a resting pose.
        """
        config = config or GeometricConfig()
        check(config, "geometric")
        if config.poses == "auto":
            kind = "flat" if target.is_flat else "resting"
            config = replace(config, poses=kind)
        self.method, self._sum = method, SUMS[method]
        if config.poses not in self._sum.poses:
            raise ValueError(
                f"{method} takes {' or '.join(self._sum.poses)} poses, and "
                f"those of {target.name} are {config.poses}"
            )
        self._sum.check(config)
        if self._sum.blank_tolerance is not None:
            config = replace(config, blank_tolerance=self._sum.blank_tolerance)
        self.config = config
        self._floor = floor or Bin().floor
        self.poses: Poses = (
            FlatPoses if config.poses == "flat" else RestingPoses
        )(target, config, self._floor)

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
        if camera.X_WC[2, 3] <= self.poses.tallest:
            raise ValueError(
                f"the camera must be above the target, not at z = "
                f"{camera.X_WC[2, 3]:.3f} m"
            )
        config = self.config
        heights = observed_heights(depth, camera, config.depth_tolerance)
        mask = self._possible(mask, camera)
        seen = bool(mask.any())
        if seen:
            total = self._sum.seen(self.poses, heights, mask, camera, config)
        else:
            total = self.poses.count_hidden(heights, camera)
        low = min(config.floor_height, self.poses.lowest / 2)
        total[(heights < low) & (heights > -np.inf) & ~mask] = 0
        if self._sum.scaled or not seen:
            if (largest := total.max()) > 0:
                total /= largest
            if not seen:
                total = self._sum.peak(config) * total
        return OccupancyDistribution(
            data=total, support_threshold=0.0, method=self.method
        )

    def _possible(self, mask: np.ndarray, camera: PinholeCamera) -> np.ndarray:
        """Returns the (H, W) pixels of a mask where a target can be seen."""
        if not mask.any():
            return mask
        planes = self._floor.half_planes(self.config.floor_tolerance)
        result = np.zeros(camera.shape, dtype=bool)
        for height in self.poses.seen_at:
            xy = camera.unproject(camera.plane_depth(height))[..., :2]
            result |= (xy @ planes[:, :2].T <= planes[:, 2]).all(axis=-1)
        return result & mask
