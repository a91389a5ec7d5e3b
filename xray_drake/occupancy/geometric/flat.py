"""The poses of a flat target, lying with its body z axis up."""

import numpy as np

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.floor_grid import Floor
from xray_drake.occupancy.geometric.config import GeometricConfig
from xray_drake.occupancy.geometric.flat_target import FlatTarget
from xray_drake.occupancy.geometric.hidden import HiddenSearch
from xray_drake.occupancy.geometric.pose_search import PoseSearch
from xray_drake.occupancy.geometric.seen import count_seen
from xray_drake.scene.object_model import ObjectModel


class FlatPoses:
    """Every translation on a lattice of about one pixel, every orientation.

    A candidate keeps within image and bin. Those of a hidden target are on a
    lattice of the floor (:class:`~.hidden.HiddenSearch`), those of one that is
    seen on the image's pixels (:class:`~.pose_search.PoseSearch`): as the
    target is flat, its silhouette is moved without being changed, and all
    candidates of one orientation are compared by one correlation.

    Attributes:
        target: as it lies.
        lowest: its thickness, m.
        tallest: the same.
        seen_at: on the floor, as it is flat.
        angles: the (k,) orientations of a hidden target, rad about world z.
        seen_angles: the (k,) orientations of a target that is seen, rad.
    """

    seen_at: tuple[float, ...] = (0.0,)

    def __init__(
        self, target: ObjectModel, config: GeometricConfig, floor: Floor
    ) -> None:
        """Draws the silhouettes.

        Args:
            target: what is searched for.
            config: the numbers.
            floor: inside of the bin.
        """
        self.target = FlatTarget(target.visual)
        self.lowest = self.tallest = self.target.thickness
        self._config, self._floor = config, floor
        rotations = config.rotations
        self.angles = self.target.distinct_angles(rotations)
        steps = 2 * np.pi * self.target.radius / config.seen_step
        self.seen_angles = self.target.distinct_angles(
            rotations * max(1, int(np.ceil(steps / rotations)))
        )
        self._hidden = HiddenSearch(self.target, self.angles, floor, config)

    def count_hidden(
        self, heights: np.ndarray, camera: PinholeCamera
    ) -> np.ndarray:
        """Counts poses that show nothing; see ``inference.Poses``."""
        return self._hidden.count(heights, camera)

    def count_seen(
        self, heights: np.ndarray, mask: np.ndarray, camera: PinholeCamera
    ) -> np.ndarray:
        """Counts poses that look as observed; see ``inference.Poses``."""
        would_show = (heights < self.target.top) | mask
        return count_seen(self.search(would_show, mask, camera), self._config)

    def search(
        self, would_show: np.ndarray, mask: np.ndarray, camera: PinholeCamera
    ) -> PoseSearch:
        """Compares all poses with the mask of a target that is seen.

        Args:
            would_show: (H, W) bool, where a target would be seen; true within
                the mask.
            mask: (H, W) bool, where it is seen; not blank.
            camera: of both.
        """
        return PoseSearch(
            self.target,
            self.seen_angles,
            would_show,
            mask,
            camera,
            self._floor.half_planes(self._config.floor_tolerance),
        )
