"""Exact inference where part of the target is seen: in the image itself.

Near the place where the target is seen, moving it over the floor moves its
silhouette by whole pixels without changing it by more than a fraction of one.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import torch

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.scanlines import Spans, convex_spans
from xray_drake.occupancy.exact_config import ExactInferenceConfig
from xray_drake.occupancy.flat_target import FlatTarget
from xray_drake.occupancy.floor_grid import Window, inside
from xray_drake.occupancy.spectra import (
    inverse,
    kernel_spectrum,
    standard_size,
    transform,
)

_SLACK = 0.05
"""Candidates this close to acceptance are drawn once more, exactly."""

_EXACT_WORK = 1_000_000
"""Rows times corners of all of them up to which that is done: where more are
near, none decides alone."""


def count_seen(
    target: FlatTarget,
    angles: np.ndarray,
    would_show: np.ndarray,
    mask: np.ndarray,
    camera: PinholeCamera,
    half_planes: np.ndarray,
    config: ExactInferenceConfig,
) -> np.ndarray:
    """Counts the accepted poses of a target that is seen, per pixel.

    Candidates are the poses whose body axis, at half the target's height, is
    seen at a pixel's centre, and that could cover two thirds of the mask.

    Args:
        target: the target.
        angles: (k,) orientations about world z, rad.
        would_show: (H, W) bool: the target would be seen here.
        mask: (H, W) bool, its observed modal mask, not blank.
        camera: the camera.
        half_planes: (m, 3) rows a, b, c: candidates keep to a·x + b·y ≤ c on
            the floor.
        config: the rules of acceptance.

    Returns:
        (H, W) float32: by how many accepted poses a pixel is covered; the mask
        itself where no candidate meets it.
    """
    rows, columns = mask.sum(axis=1), mask.sum(axis=0)
    middle = np.array([[_quantile(columns, 0.5), _quantile(rows, 0.5)]])
    outlines = np.concatenate(
        [target.project(angle, middle, camera) for angle in angles]
    )
    outlines -= middle
    reach = int(np.ceil(np.abs(outlines).max())) + 1
    top, bottom = pose_range(rows, reach)
    left, right = pose_range(columns, reach)
    window = Window(
        1.0,
        top - reach,
        left - reach,
        standard_size(bottom - top + 2 * reach + 1),
        standard_size(right - left + 2 * reach + 1),
    )
    shape = window.shape
    tried = (
        slice(reach, reach + bottom - top + 1),
        slice(reach, reach + right - left + 1),
    )
    would_show = would_show | mask
    observed = transform(_crop(mask, window, False))
    shown = transform(_crop(would_show, window, True))
    size = int(np.count_nonzero(mask))
    limits = _image_limits(camera, half_planes)
    silhouettes = [target.mask(outline, reach) for outline in outlines]
    typical = float(np.mean([raster.sum() for raster in silhouettes]))
    kernels = [kernel_spectrum(raster, shape) for raster in silhouettes]
    common = torch.stack(
        [inverse(observed * k.conj(), shape)[tried] for k in kernels]
    ).round_()
    for k, outline in enumerate(outlines):
        bounds = limits.copy()
        bounds[:, 2] -= (limits[:, :2] @ outline.T).max(axis=1)
        if (counts := inside(window, bounds)) is not None:
            common[k] *= torch.from_numpy(counts[tried])
    most = common.amax(dim=(1, 2))
    if most.max() <= 0:
        return mask.astype(np.float32)

    # IoU ≤ common / size, so orientations that cover too little are out.
    rule = AcceptanceRule(config, size, typical)
    chosen = (most >= rule.least_common(float(most.max()))).nonzero()[:, 0]
    common = common[chosen]
    area = torch.stack(
        [inverse(shown * kernels[k].conj(), shape)[tried] for k in chosen]
    ).round_()
    near = rule.accepted(common, area, slack=_SLACK)
    if target.convex:
        poses = near.nonzero()
        work = len(poses) * (2 * reach + 1) * outlines.shape[1]
        if work <= _EXACT_WORK:
            pixels = poses[:, [2, 1]].numpy() + [left, top]
            spans = _spans(
                target, angles[chosen[poses[:, 0]].numpy()], pixels, camera
            )
            accepted = rule.accepted(
                torch.from_numpy(spans.sums(mask)),
                torch.from_numpy(spans.sums(would_show)),
            )
            return spans.total(accepted.numpy())

    total = torch.zeros_like(observed)
    for k, poses in zip(chosen, rule.accepted(common, area), strict=True):
        if poses.any():
            placed = torch.zeros(shape)
            placed[tried] = poses.to(torch.float32)
            total += torch.fft.rfft2(placed) * kernels[k]
    return _paste(inverse(total, shape).round_().numpy(), window, camera.shape)


@dataclass(frozen=True)
class AcceptanceRule:
    """Which candidates are accepted.

    Attributes:
        config: the numbers.
        size: pixels of the observed mask.
        typical: pixels of a silhouette.
    """

    config: ExactInferenceConfig
    size: int
    typical: float

    @property
    def fragment(self) -> bool:
        """The mask is too small to measure an IoU by."""
        return self.size < self.config.fragment_share * self.typical

    def least_common(self, most: float) -> float:
        """Returns a bound of what accepted candidates share with the mask."""
        by_coverage = (self.config.accept_coverage - _SLACK) * most
        if self.fragment:
            return by_coverage
        share = self.config.accept_iou - _SLACK
        return min(by_coverage, share * self.config.trusted_iou * self.size)

    def accepted(
        self, common: torch.Tensor, area: torch.Tensor, slack: float = 0.0
    ) -> torch.Tensor:
        """Returns which candidates are accepted, (n,) bool.

        Args:
            common: (n,) pixels of each predicted modal mask within the
                observed.
            area: (n,) pixels of each predicted modal mask.
            slack: taken off each share that is asked for.
        """
        config = self.config
        if not self.fragment:
            iou = common / (area + (self.size - common))
            best = iou.max()
            if best >= config.trusted_iou:
                return iou >= (config.accept_iou - slack) * best
        share = config.accept_coverage - slack
        accepted = common >= share * common.max()
        spill = area - common
        more = (config.accept_spill + slack) * self.typical
        return accepted & (spill <= spill[accepted].min() + more)


def _spans(
    target: FlatTarget,
    angles: np.ndarray,
    pixels: np.ndarray,
    camera: PinholeCamera,
) -> Spans:
    """Draws n poses of a convex target, each where it really is seen."""
    outlines = []
    for angle in np.unique(angles):
        corners = target.project(angle, pixels[angles == angle], camera)
        around = cv2.convexHull(
            corners[0].astype(np.float32), returnPoints=False
        )[:, 0]
        outlines.append(corners[:, around])
    corners_most = max(outline.shape[1] for outline in outlines)
    return convex_spans(
        np.concatenate(
            [
                np.pad(
                    outline,
                    ((0, 0), (0, corners_most - outline.shape[1]), (0, 0)),
                    mode="edge",
                )
                for outline in outlines
            ]
        ),
        camera.shape,
    )


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


def _paste(
    values: np.ndarray, window: Window, shape: tuple[int, int]
) -> np.ndarray:
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
