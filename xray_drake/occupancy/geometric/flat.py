"""Exact inference of the occupancy distribution of a flat target, online."""

import numpy as np

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.floor_grid import Floor
from xray_drake.occupancy.geometric.config import ExactInferenceConfig
from xray_drake.occupancy.geometric.flat_target import FlatTarget
from xray_drake.occupancy.geometric.hidden import HiddenSearch
from xray_drake.occupancy.geometric.pose_counting import PoseCounting
from xray_drake.occupancy.geometric.pose_search import PoseSearch
from xray_drake.occupancy.geometric.seen import count_seen
from xray_drake.scene.object_model import ObjectModel

__all__ = ["ExactInference", "ExactInferenceConfig"]


class ExactInference(PoseCounting):
    """Finds where a flat target can be, from what the camera sees.

    Every translation on a lattice of about one pixel and every orientation is
    a candidate. A candidate lies flat on the floor with its body z axis up and
    keeps within image and bin. It is accepted if it would look as observed:
    if the target is not seen, its predicted modal mask is blank; if it is, its
    IoU with the observed mask is at least ``accept_iou`` times the best one.
    The distribution is the sum of the accepted amodal masks, divided by its
    maximum (paper section IV.A), and zero on pixels that show the floor.

    A pixel would show the target where the observed surface is lower than the
    target, where there is no reading, and where the target is observed.
    ``HiddenSearch`` and ``count_seen`` do the two cases.

    Mask pixels that lie outside the floor are ignored. If no flat candidate
    explains the mask (best IoU below ``trusted_iou``: the target is tilted) or
    the mask is a fragment (less than ``fragment_share`` of the silhouette, too
    few pixels to measure an IoU by), those candidates are accepted that cover
    nearly as much of the mask as the best one does and show hardly more beyond
    it than the one that shows least.
    """

    def __init__(
        self,
        target: ObjectModel,
        config: ExactInferenceConfig | None = None,
        *,
        rotations: int | None = None,
        floor: tuple[tuple[float, float], tuple[float, float]] | None = None,
    ) -> None:
        """Prepares the silhouettes.

        Args:
            target: what is searched for.
            config: the numbers.
            rotations: replaces ``config.rotations``.
            floor: bounds in x and in y, m; replaces ``config.floor``.

        Raises:
            ValueError: no rotation, or a cell or step that is not positive.
        """
        config = config or ExactInferenceConfig()
        rotations = config.rotations if rotations is None else rotations
        if rotations < 1 or config.cell <= 0 or config.seen_step <= 0:
            raise ValueError(
                f"need at least one rotation and a positive cell and step, not "
                f"{rotations}, {config.cell} and {config.seen_step}"
            )
        self._target = FlatTarget(target.visual)
        super().__init__(
            config,
            Floor.of(config.floor) if floor is None else Floor(*floor),
            lowest=self._target.thickness,
            tallest=self._target.thickness,
        )
        self._angles = self._target.distinct_angles(rotations)
        steps = 2 * np.pi * self._target.radius / config.seen_step
        self._seen_angles = self._target.distinct_angles(
            rotations * max(1, int(np.ceil(steps / rotations)))
        )
        self._hidden = HiddenSearch(
            self._target, self._angles, self._floor, config
        )

    @property
    def angles(self) -> np.ndarray:
        """The (k,) orientations of a hidden target, rad about world z."""
        return self._angles

    @property
    def seen_angles(self) -> np.ndarray:
        """The (k,) orientations of a target that is seen, rad."""
        return self._seen_angles

    def _count_seen(
        self, heights: np.ndarray, mask: np.ndarray, camera: PinholeCamera
    ) -> np.ndarray:
        return count_seen(self._search(heights, mask, camera), self.config)

    def _search(
        self, heights: np.ndarray, mask: np.ndarray, camera: PinholeCamera
    ) -> PoseSearch:
        """Compares all poses with a mask; see ``_count_seen``."""
        return PoseSearch(
            self._target,
            self._seen_angles,
            self._would_show(heights, mask),
            mask,
            camera,
            self._floor.half_planes(self.config.floor_tolerance),
        )

    def _would_show(self, heights: np.ndarray, mask: np.ndarray) -> np.ndarray:
        """Returns the (H, W) pixels in which a target would be seen.

        Args:
            heights: (H, W) of the observed surface, m; −inf: no reading.
            mask: (H, W) bool, where the target is seen.
        """
        return (heights < self._target.top) | mask

    def _count_hidden(
        self, heights: np.ndarray, camera: PinholeCamera
    ) -> np.ndarray:
        return self._hidden.count(heights, camera)

    def _possible(self, mask: np.ndarray, camera: PinholeCamera) -> np.ndarray:
        if not mask.any():
            return mask
        rows, columns = np.nonzero(mask)
        to_floor = np.linalg.inv(camera.plane_homography(0.0))
        ray = to_floor @ np.stack([columns, rows, np.ones(len(rows))])
        xy = (ray[:2] / ray[2]).T
        planes = self._floor.half_planes(self.config.floor_tolerance)
        keep = (xy @ planes[:, :2].T <= planes[:, 2]).all(axis=1)
        result = np.zeros_like(mask)
        result[rows[keep], columns[keep]] = True
        return result
