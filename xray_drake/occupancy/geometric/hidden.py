"""Poses of a flat target that is hidden: counted on the floor plane."""

from collections import OrderedDict

import numpy as np
import torch

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.floor_grid import (
    Floor,
    Window,
    image_half_planes,
    inside,
    pose_bounds,
)
from xray_drake.occupancy.geometric.config import GeometricConfig
from xray_drake.occupancy.geometric.flat_target import FlatTarget
from xray_drake.occupancy.geometric.spectra import (
    inverse,
    kernel_spectrum,
    standard_size,
    transform,
)

_MARGIN = 8
"""Cells around the hidden region that a nearly hidden target may touch."""

_CACHED_SIZES = 8
"""Window sizes whose transformed kernels are kept."""

_LEVEL_SPACING = 0.008
"""A column is looked at in heights at most this far apart, m."""


class HiddenSearch:
    """Counts the poses in which a target would not be seen.

    Candidates are the poses whose origin lies on a lattice of the floor, in
    each orientation. Columns of the target stand on cells of that lattice, and
    where a column of a given height would be seen is one binary image, read at
    the pixels where its ends appear. The visible area of all candidates of one
    orientation is its correlation with the silhouette, and the sum of the
    accepted silhouettes a convolution; both are products of spectra.
    """

    def __init__(
        self,
        target: FlatTarget,
        angles: np.ndarray,
        floor: Floor,
        config: GeometricConfig,
    ) -> None:
        """Draws the silhouettes.

        Args:
            target: the target.
            angles: (k,) orientations about world z, rad.
            floor: inside of the bin.
            config: pitch and tolerances.
        """
        self._config = config
        self._floor = floor
        self._groups = [
            (
                np.linspace(
                    group.low,
                    group.high,
                    2 + int((group.high - group.low) / _LEVEL_SPACING),
                ),
                group.top,
            )
            for group in target.groups
        ]
        self._points = [target.rotated(angle) for angle in angles]
        self._reach = int(np.ceil(target.radius / config.cell)) + 1
        self._rasters = [
            target.group_rasters(angle, config.cell, self._reach)
            for angle in angles
        ]
        self._areas = [
            sum(float(share.sum()) for share, _ in rasters)
            for rasters in self._rasters
        ]
        self._spectra: OrderedDict[
            tuple[int, int], list[list[tuple[torch.Tensor, torch.Tensor]]]
        ] = OrderedDict()

    def count(self, heights: np.ndarray, camera: PinholeCamera) -> np.ndarray:
        """Counts the accepted poses, per pixel.

        Args:
            heights: (H, W) float32 height of the observed surface over the
                floor, −inf where there is no reading, m.
            camera: the camera, above the target.

        Returns:
            (H, W) float32: by how many accepted poses a pixel is covered.
        """
        result = np.zeros(camera.shape, dtype=np.float32)
        found = self._hidden_window(heights, camera)
        if found is None:
            return result
        window, visible = found
        images = [transform(image) for image in visible]
        totals = [torch.zeros_like(image) for image in images]
        within = self._limits(camera)
        around = window.half_planes()
        center = camera.X_WC[:3, 3]
        for k, kernels in enumerate(self._kernels(window.shape)):
            points = self._points[k]
            bounds = np.concatenate(
                [
                    pose_bounds(points, center, within),
                    # What reaches beyond the window comes in opposite.
                    pose_bounds(points * [1, 1, 0], center, around),
                ]
            )
            spectrum = images[0] * kernels[0][0]
            for image, kernel in zip(images[1:], kernels[1:], strict=True):
                spectrum += image * kernel[0]
            allowed = self._config.blank_tolerance * self._areas[k] + 0.01
            blank = inverse(spectrum, window.shape) <= allowed
            if (counts := inside(window, bounds)) is not None:
                blank &= torch.from_numpy(counts)
            if not blank.any():
                continue
            accepted = torch.fft.rfft2(blank.to(torch.float32))
            for total, kernel in zip(totals, kernels, strict=True):
                total += accepted * kernel[1]
        for total, (levels, _) in zip(totals, self._groups, strict=True):
            covered = inverse(total, window.shape).round_().numpy()
            result += np.maximum.reduce(
                [window.show(covered, camera, level) for level in levels]
            )
        return result

    def _hidden_window(
        self, heights: np.ndarray, camera: PinholeCamera
    ) -> tuple[Window, list[np.ndarray]] | None:
        """Returns the window around what is hidden, and where columns show."""

        def visible_in(window: Window) -> list[np.ndarray]:
            return [
                _visible_columns(heights, camera, window, levels, top)
                for levels, top in self._groups
            ]

        whole = self._floor_window()
        visible = visible_in(whole)
        hidden = np.minimum.reduce(visible) == 0
        floor = self._floor.half_planes(self._config.floor_tolerance)
        if (on_floor := inside(whole, floor)) is not None:
            hidden &= on_floor
        rows = np.flatnonzero(hidden.any(axis=1))
        columns = np.flatnonzero(hidden.any(axis=0))
        if not len(rows):
            return None
        window = self._window(
            whole.row0 + rows[0] - _MARGIN,
            whole.row0 + rows[-1] + _MARGIN,
            whole.column0 + columns[0] - _MARGIN,
            whole.column0 + columns[-1] + _MARGIN,
        )
        if window.rows * window.columns >= whole.rows * whole.columns:
            return whole, visible
        return window, visible_in(window)

    def _floor_window(self) -> Window:
        cell, tolerance = self._config.cell, self._config.floor_tolerance
        (x_low, x_high), (y_low, y_high) = self._floor.x, self._floor.y
        return self._window(
            int(np.floor((y_low - tolerance) / cell)),
            int(np.ceil((y_high + tolerance) / cell)),
            int(np.floor((x_low - tolerance) / cell)),
            int(np.ceil((x_high + tolerance) / cell)),
        )

    def _window(self, top: int, bottom: int, left: int, right: int) -> Window:
        """Returns a window of a standard size around lattice bounds."""
        kernel = 2 * self._reach + 1
        rows = standard_size(max(bottom - top + 1, kernel))
        columns = standard_size(max(right - left + 1, kernel))
        return Window(
            self._config.cell,
            (int(top) + int(bottom) + 1 - rows) // 2,
            (int(left) + int(right) + 1 - columns) // 2,
            rows,
            columns,
        )

    def _limits(self, camera: PinholeCamera) -> np.ndarray:
        """Returns sides of the floor, and of the image where it cuts that."""
        floor = self._floor.half_planes(self._config.floor_tolerance)
        image = image_half_planes(camera)
        slack = 2 * self._config.floor_tolerance
        across = image[:, :2] @ self._floor.corners().T
        cuts = (across > image[:, 2:] - slack).any(axis=1)
        return np.concatenate([floor, image[cuts]])

    def _kernels(
        self, shape: tuple[int, int]
    ) -> list[list[tuple[torch.Tensor, torch.Tensor]]]:
        """Returns spectra by orientation and group, of shares and centres."""
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


def _visible_columns(
    heights: np.ndarray,
    camera: PinholeCamera,
    window: Window,
    levels: np.ndarray,
    top: float,
) -> np.ndarray:
    """Returns uint8 1 where a column of the target would be seen, else 0.

    What is observed at the pixel of its highest level is compared with the
    column's top; that at lower ones with half of it at least, lest noise of
    the floor's depth hides them.
    """
    result = np.zeros(window.shape, dtype=np.uint8)
    for level in levels:
        reference = top if level == levels[-1] else max(level, top / 2)
        lower = (heights < reference).astype(np.uint8)
        result |= window.sample(lower, camera, level, outside=1)
    return result
