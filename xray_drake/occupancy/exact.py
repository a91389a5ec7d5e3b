"""Exact inference of the occupancy distribution of a flat target, online."""

from collections import OrderedDict

import numpy as np
import torch

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.messages import OccupancyDistribution
from xray_drake.occupancy.columns import FlatTarget
from xray_drake.occupancy.exact_config import ExactInferenceConfig
from xray_drake.occupancy.floor_grid import (
    Floor,
    Window,
    image_half_planes,
    inside,
    observed_heights,
    pose_bounds,
)
from xray_drake.occupancy.seen import count_seen
from xray_drake.occupancy.spectra import (
    inverse,
    kernel_spectrum,
    standard_size,
    transform,
)
from xray_drake.scene.object_model import ObjectModel

_MARGIN = 8
"""Cells around the hidden region that a nearly hidden target may touch."""

_CACHED_SIZES = 8
"""Window sizes whose transformed kernels are kept."""


class ExactInference:
    """Finds where a flat target can be, from what the camera sees.

    Every translation on a lattice of about one pixel and every orientation is
    a candidate. A candidate lies flat on the floor with its body z axis up and
    keeps within image and bin. It is accepted if it would look as observed:
    if the target is not seen, its predicted modal mask is blank; if it is, its
    IoU with the observed mask is at least ``accept_iou`` times the best one.
    The distribution is the sum of the accepted amodal masks, divided by its
    maximum (paper section IV.A), and zero on pixels that show the floor.

    A pixel would show the target where the observed surface is lower than the
    target, where there is no reading, and where the target is observed. On the
    floor plane, this is one binary image, and the visible area of all
    candidates of one orientation is its correlation with the silhouette; the
    sum of the accepted masks is one more.

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
        if floor is None:
            x_low, x_high, y_low, y_high = config.floor
            floor = (x_low, x_high), (y_low, y_high)
        rotations = config.rotations if rotations is None else rotations
        if rotations < 1 or config.cell <= 0 or config.seen_step <= 0:
            raise ValueError(
                f"need at least one rotation and a positive cell and step, not "
                f"{rotations}, {config.cell} and {config.seen_step}"
            )
        self.config = config
        self._floor = Floor(*floor)
        self._target = FlatTarget(target.visual)
        self._angles = self._target.distinct_angles(rotations)
        steps = 2 * np.pi * self._target.radius / config.seen_step
        self._seen_angles = self._target.distinct_angles(
            rotations * max(1, int(np.ceil(steps / rotations)))
        )
        self._reach = int(np.ceil(self._target.radius / config.cell)) + 1
        self._points = [self._target.rotated(angle) for angle in self._angles]
        self._rasters = [
            self._target.group_rasters(angle, config.cell, self._reach)
            for angle in self._angles
        ]
        self._areas = [
            sum(float(raster[0].sum()) for raster in rasters)
            for rasters in self._rasters
        ]
        self._spectra: OrderedDict[
            tuple[int, int], list[list[tuple[torch.Tensor, torch.Tensor]]]
        ] = OrderedDict()

    @property
    def angles(self) -> np.ndarray:
        """The (k,) orientations of a hidden target, rad about world z."""
        return self._angles

    @property
    def seen_angles(self) -> np.ndarray:
        """The (k,) orientations of a target that is seen, rad."""
        return self._seen_angles

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
        depth = np.asarray(depth, dtype=np.float32)
        mask = np.asarray(target_mask, dtype=bool)
        _check(depth, mask, camera, self._target.thickness)
        config = self.config
        heights = observed_heights(depth, camera, config.depth_tolerance)
        mask = self._within_floor(mask, camera)
        if mask.any():
            total = count_seen(
                self._target,
                self._seen_angles,
                heights < self._target.top,
                mask,
                camera,
                self._floor.half_planes(config.floor_tolerance),
                config,
            )
        else:
            total = self._infer_hidden(heights, camera)
        low = min(config.floor_height, self._target.thickness / 2)
        total[(heights < low) & (heights > -np.inf) & ~mask] = 0
        largest = total.max()
        if largest > 0:
            total /= largest
        return OccupancyDistribution(
            data=total, support_threshold=0.0, method="exact"
        )

    def _limits(self, camera: PinholeCamera) -> np.ndarray:
        floor = self._floor.half_planes(self.config.floor_tolerance)
        image = image_half_planes(camera)
        corners = self._floor.corners()
        beyond = image[:, :2] @ corners.T > image[:, 2:] - 0.005
        return np.concatenate([floor, image[beyond.any(axis=1)]])

    def _within_floor(
        self, mask: np.ndarray, camera: PinholeCamera
    ) -> np.ndarray:
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

    def _infer_hidden(
        self, heights: np.ndarray, camera: PinholeCamera
    ) -> np.ndarray:
        levels = [
            np.linspace(
                group.low,
                group.high,
                2 + int((group.high - group.low) / 0.008),
            )
            for group in self._target.groups
        ]
        whole = self._window(*self._floor_cells())
        visible = [
            self._visible_columns(heights, camera, whole, group)
            for group in levels
        ]
        hidden = np.minimum.reduce(visible) == 0
        floor = self._floor.half_planes(self.config.floor_tolerance)
        if (on_floor := inside(whole, floor)) is not None:
            hidden &= on_floor
        rows = np.flatnonzero(hidden.any(axis=1))
        columns = np.flatnonzero(hidden.any(axis=0))
        if not len(rows):
            return np.zeros(camera.shape, dtype=np.float32)
        window = self._window(
            whole.row0 + rows[0] - _MARGIN,
            whole.row0 + rows[-1] + _MARGIN,
            whole.column0 + columns[0] - _MARGIN,
            whole.column0 + columns[-1] + _MARGIN,
        )
        if window.rows * window.columns < whole.rows * whole.columns:
            visible = [
                self._visible_columns(heights, camera, window, group)
                for group in levels
            ]
        else:
            window = whole
        images = [transform(image) for image in visible]
        limits = np.concatenate([self._limits(camera), window.half_planes()])
        center = camera.X_WC[:3, 3]
        totals = [torch.zeros_like(image) for image in images]
        for k, kernels in enumerate(self._kernels(window.shape)):
            bounds = pose_bounds(self._points[k], center, limits)
            spectrum = images[0] * kernels[0][0]
            for image, kernel in zip(images[1:], kernels[1:], strict=True):
                spectrum += image * kernel[0]
            area = inverse(spectrum, window.shape)
            allowed = self.config.blank_tolerance * self._areas[k] + 0.01
            blank = area <= allowed
            if (counts := inside(window, bounds)) is not None:
                blank &= torch.from_numpy(counts)
            if not blank.any():
                continue
            accepted = torch.fft.rfft2(blank.to(torch.float32))
            for total, kernel in zip(totals, kernels, strict=True):
                total += accepted * kernel[1]
        result = np.zeros(camera.shape, dtype=np.float32)
        for total, group in zip(totals, levels, strict=True):
            counts = inverse(total, window.shape).round().numpy()
            result += np.maximum.reduce(
                [window.show(counts, camera, level) for level in group]
            )
        return result

    def _floor_cells(self) -> tuple[int, int, int, int]:
        cell, tolerance = self.config.cell, self.config.floor_tolerance
        (x_low, x_high), (y_low, y_high) = self._floor.x, self._floor.y
        return (
            int(np.floor((y_low - tolerance) / cell)),
            int(np.ceil((y_high + tolerance) / cell)),
            int(np.floor((x_low - tolerance) / cell)),
            int(np.ceil((x_high + tolerance) / cell)),
        )

    def _window(self, top: int, bottom: int, left: int, right: int) -> Window:
        """Returns a window of a standard size around lattice bounds."""
        rows, columns = bottom - top + 1, right - left + 1
        return Window(
            self.config.cell,
            int(top) - (standard_size(rows) - rows) // 2,
            int(left) - (standard_size(columns) - columns) // 2,
            standard_size(rows),
            standard_size(columns),
        )

    def _visible_columns(
        self,
        heights: np.ndarray,
        camera: PinholeCamera,
        window: Window,
        levels: np.ndarray,
    ) -> np.ndarray:
        """Returns 1 where a column of the target would be seen, else 0."""
        result = np.zeros(window.shape, dtype=np.uint8)
        for level in levels:
            reference = max(level, levels[-1] / 2)
            lower = (heights < reference).astype(np.uint8)
            result |= window.sample(lower, camera, level, outside=1)
        return result

    def _kernels(
        self, shape: tuple[int, int]
    ) -> list[list[tuple[torch.Tensor, torch.Tensor]]]:
        if shape not in self._spectra:
            while len(self._spectra) >= _CACHED_SIZES:
                self._spectra.popitem(last=False)
            self._spectra[shape] = [
                [
                    (
                        kernel_spectrum(share, shape).conj().resolve_conj(),
                        kernel_spectrum(centers, shape),
                    )
                    for share, centers in rasters
                ]
                for rasters in self._rasters
            ]
        self._spectra.move_to_end(shape)
        return self._spectra[shape]


def _check(
    depth: np.ndarray,
    mask: np.ndarray,
    camera: PinholeCamera,
    thickness: float,
) -> None:
    if depth.shape != camera.shape:
        raise ValueError(
            f"the depth image is {depth.shape}, the camera's images are "
            f"{camera.shape}"
        )
    if mask.shape != camera.shape:
        raise ValueError(
            f"the target mask is {mask.shape}, the camera's images are "
            f"{camera.shape}"
        )
    if not ((depth > 0) & np.isfinite(depth)).any():
        raise ValueError(
            "the depth image has no reading at all (every pixel is 0, inf or "
            "NaN); check the sensor's range and that it has rendered"
        )
    if camera.X_WC[2, 3] <= thickness:
        raise ValueError(
            f"the camera must be above the target, not at z = "
            f"{camera.X_WC[2, 3]:.3f} m"
        )
