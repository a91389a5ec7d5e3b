"""Which poses of a flat target explain what is seen of it: correlations.

Near the place where the target is seen, moving it over the floor moves its
silhouette by whole pixels without changing it by more than a fraction of one.
"""

import numpy as np
import torch

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.floor_grid import Window, inside
from xray_drake.occupancy.geometric.flat_target import FlatTarget
from xray_drake.occupancy.geometric.spectra import (
    inverse,
    kernel_spectrum,
    standard_size,
    transform,
)


class PoseSearch:
    """Compares the silhouettes of all poses with an observed mask.

    Candidates are the poses whose body axis, at half the target's height, is
    seen at a pixel's centre, and that could cover two thirds of the mask.

    Attributes:
        target: as given, and so are the next four.
        angles: see there.
        would_show: see there.
        mask: see there.
        camera: see there.
        window: of the image; all silhouettes are inside.
        left: column of the first candidate in the image, pixels.
        top: row of the first candidate.
        reach: half width of the silhouettes, pixels.
        silhouettes: (k, 2·reach + 1, 2·reach + 1) float32, 1 where a target at
            the middle pixel covers a pixel, else 0.
        spectra: those of the silhouettes, in the window.
        tried: rows and columns of the window that hold candidates.
        common: (k, h, w) float32: pixels of a candidate's predicted modal mask
            within the mask; 0 where it leaves floor or image.
        corners: of an outline.
    """

    def __init__(
        self,
        target: FlatTarget,
        angles: np.ndarray,
        would_show: np.ndarray,
        mask: np.ndarray,
        camera: PinholeCamera,
        half_planes: np.ndarray,
    ) -> None:
        """Compares them.

        Args:
            target: the target.
            angles: (k,) orientations about world z, rad.
            would_show: (H, W) bool: the target would be seen here; true
                within the mask.
            mask: (H, W) bool, its observed modal mask, not blank.
            camera: the camera.
            half_planes: (m, 3) rows a, b, c: candidates keep to
                a·x + b·y ≤ c on the floor.
        """
        self.target, self.angles = target, angles
        self.would_show, self.mask, self.camera = would_show, mask, camera
        rows, columns = mask.sum(axis=1), mask.sum(axis=0)
        middle = np.array([[_quantile(columns, 0.5), _quantile(rows, 0.5)]])
        outlines = np.concatenate(
            [target.project(angle, middle, camera) for angle in angles]
        )
        outlines -= middle
        self.corners = outlines.shape[1]
        self.reach = reach = int(np.ceil(np.abs(outlines).max())) + 1
        self.top, bottom = pose_range(rows, reach)
        self.left, right = pose_range(columns, reach)
        self.window = window = Window(
            1.0,
            self.top - reach,
            self.left - reach,
            standard_size(bottom - self.top + 2 * reach + 1),
            standard_size(right - self.left + 2 * reach + 1),
        )
        self.tried = tried = (
            slice(reach, reach + bottom - self.top + 1),
            slice(reach, reach + right - self.left + 1),
        )
        observed = transform(_crop(mask, window, False))
        self._shown = transform(_crop(would_show, window, True))
        limits = _image_limits(camera, half_planes)
        self.silhouettes = np.stack(
            [target.mask(outline, reach) for outline in outlines]
        )
        self.spectra = [
            kernel_spectrum(raster, window.shape) for raster in self.silhouettes
        ]
        self.common = torch.stack(
            [
                inverse(observed * spectrum.conj(), window.shape)[tried]
                for spectrum in self.spectra
            ]
        ).round_()
        for k, outline in enumerate(outlines):
            bounds = limits.copy()
            bounds[:, 2] -= (limits[:, :2] @ outline.T).max(axis=1)
            if (counts := inside(window, bounds)) is not None:
                self.common[k] *= torch.from_numpy(counts[tried])

    def areas(self, chosen: torch.Tensor) -> torch.Tensor:
        """Returns (n, h, w) pixels of predicted modal masks.

        Args:
            chosen: (n,) int64, of the orientations.
        """
        return torch.stack(
            [
                inverse(
                    self._shown * self.spectra[k].conj(), self.window.shape
                )[self.tried]
                for k in chosen
            ]
        ).round_()


def _image_limits(camera: PinholeCamera, half_planes: np.ndarray) -> np.ndarray:
    """Returns half-planes of the floor, and the image's sides, in pixels."""
    to_floor = np.linalg.inv(camera.plane_homography(0.0))
    lines = np.column_stack([-half_planes[:, :2], half_planes[:, 2]]) @ to_floor
    lines *= np.sign(to_floor[2] @ [*_middle(camera), 1.0])
    lines /= np.linalg.norm(lines[:, :2], axis=1, keepdims=True)
    sides = [
        [1.0, 0.0, camera.width - 0.5],
        [-1.0, 0.0, 0.5],
        [0.0, 1.0, camera.height - 0.5],
        [0.0, -1.0, 0.5],
    ]
    return np.concatenate(
        [np.column_stack([-lines[:, :2], lines[:, 2]]), sides]
    )


def _middle(camera: PinholeCamera) -> tuple[float, float]:
    return (camera.width - 1) / 2, (camera.height - 1) / 2


def _quantile(weights: np.ndarray, share: float) -> int:
    cumulated = np.cumsum(weights, dtype=np.float64)
    return int(np.searchsorted(cumulated, share * cumulated[-1]))


def pose_range(weights: np.ndarray, reach: int) -> tuple[int, int]:
    """Returns where a body can be that covers two thirds of a mask."""
    first, last = _quantile(weights, 1 / 3), _quantile(weights, 2 / 3)
    middle = (first + last) // 2
    return min(last - reach, middle), max(first + reach, middle)


def _crop(image: np.ndarray, window: Window, outside: bool) -> np.ndarray:
    result = np.full(window.shape, outside, dtype=np.float32)
    inner, outer = _overlap(window, image.shape)
    result[inner] = image[outer]
    return result


def paste(
    values: np.ndarray, window: Window, shape: tuple[int, int]
) -> np.ndarray:
    """Returns an (H, W) float32 image of a window's values, else 0."""
    result = np.zeros(shape, dtype=np.float32)
    inner, outer = _overlap(window, shape)
    result[outer] = values[inner]
    return result


def _overlap(
    window: Window, shape: tuple[int, ...]
) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Returns where window and image overlap, in each one's indices."""
    inner, outer = [], []
    starts = window.row0, window.column0
    for start, size, limit in zip(starts, window.shape, shape, strict=True):
        low = min(max(start, 0), limit)
        high = min(max(start + size, low), limit)
        inner.append(slice(low - start, high - start))
        outer.append(slice(low, high))
    return (inner[0], inner[1]), (outer[0], outer[1])
