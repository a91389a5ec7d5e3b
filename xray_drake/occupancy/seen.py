"""Exact inference where part of the target is seen: in the image itself.

Near the place where the target is seen, moving it over the floor moves its
silhouette by whole pixels without changing it by more than a fraction of one.
"""

import numpy as np
import torch

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.occupancy.columns import FlatTarget
from xray_drake.occupancy.floor_grid import Window, inside
from xray_drake.occupancy.spectra import (
    inverse,
    kernel_spectrum,
    standard_size,
    transform,
)


def count_seen(
    target: FlatTarget,
    angles: np.ndarray,
    would_show: np.ndarray,
    mask: np.ndarray,
    camera: PinholeCamera,
    half_planes: np.ndarray,
    *,
    accept_iou: float,
    trusted_iou: float,
    accept_coverage: float,
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
        accept_iou: share of the best IoU that an accepted pose reaches.
        trusted_iou: if the best IoU is lower, coverage of the mask decides.
        accept_coverage: share of the best coverage of the mask that is then
            enough.

    Returns:
        (H, W) float32: by how many accepted poses a pixel is covered; the mask
        itself where no candidate meets it.
    """
    rows, columns = mask.sum(axis=1), mask.sum(axis=0)
    middle = np.array([_quantile(columns, 0.5), _quantile(rows, 0.5)])
    outlines = _outlines(target, angles, middle, camera)
    reach = int(np.ceil(np.abs(outlines).max())) + 1
    top, bottom = _pose_range(rows, reach)
    left, right = _pose_range(columns, reach)
    window = Window(
        1.0,
        top - reach,
        left - reach,
        standard_size(bottom - top + 2 * reach + 1),
        standard_size(right - left + 2 * reach + 1),
    )
    shape = window.shape
    in_range = np.zeros(shape, dtype=bool)
    in_range[
        reach : reach + bottom - top + 1, reach : reach + right - left + 1
    ] = True

    observed = transform(_crop(mask, window, False))
    shown = transform(_crop(would_show | mask, window, True))
    size = np.count_nonzero(mask)
    limits = _image_limits(camera, half_planes)
    ious, common_areas, kernels = [], [], []
    for outline in outlines:
        kernel = kernel_spectrum(target.mask(outline, reach), shape)
        area = inverse(shown * kernel.conj(), shape).round_()
        common = inverse(observed * kernel.conj(), shape).round_()
        bounds = limits.copy()
        bounds[:, 2] -= (limits[:, :2] @ outline.T).max(axis=1)
        counts = torch.from_numpy(in_range & inside(window, bounds))
        ious.append(common / (area + size - common) * counts)
        common_areas.append(common * counts)
        kernels.append(kernel)

    scores, share = ious, accept_iou
    best = max(float(score.max()) for score in scores)
    if best < trusted_iou:
        scores, share = common_areas, accept_coverage
        best = max(float(score.max()) for score in scores)
    if best <= 0:
        return mask.astype(np.float32)
    import os

    if os.environ.get("DBG"):
        print(
            "fast best",
            best,
            sum(int((s >= share * best).sum()) for s in scores),
            np.sort(np.concatenate([s.numpy().ravel() for s in scores]))[-8:],
        )
    total = torch.zeros_like(observed)
    for score, kernel in zip(scores, kernels, strict=True):
        accepted = score >= share * best
        if accepted.any():
            total += torch.fft.rfft2(accepted.to(torch.float32)) * kernel
    return _paste(inverse(total, shape).round_().numpy(), window, camera.shape)


def _outlines(
    target: FlatTarget,
    angles: np.ndarray,
    pixel: np.ndarray,
    camera: PinholeCamera,
) -> np.ndarray:
    """Projects the target, its axis seen at a pixel.

    Returns:
        (k, n, 2) vertices for each orientation, pixels from ``pixel``.
    """
    half = target.thickness / 2
    to_plane = np.linalg.inv(camera.plane_homography(half))
    x, y, scale = to_plane @ [*pixel, 1.0]
    origin = np.array([x / scale, y / scale, 0.0])
    return np.stack(
        [
            camera.project(target.rotated(angle) + origin)[:, :2] - pixel
            for angle in angles
        ]
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


def _pose_range(weights: np.ndarray, reach: int) -> tuple[int, int]:
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
