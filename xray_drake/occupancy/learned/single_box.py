"""One network per aspect ratio, and targets of every size: the paper's way.

A network knows one box. A target goes to the network whose box has the nearest
aspect ratio, in an image that is scaled until the target is as large as that
box (paper section IV.C, "Target Object Scale"; PROTOCOL.md, "Metrics").
"""

from collections.abc import Sequence

import cv2
import numpy as np
import trimesh
from numpy.typing import ArrayLike

BOX_SIDE = 0.03
"""Square root of length times width of every box trained on, m."""


def oriented_size(mesh_or_extents: trimesh.Trimesh | ArrayLike) -> np.ndarray:
    """Returns length, width and thickness, the longest first.

    Args:
        mesh_or_extents: a mesh, measured by its oriented bounding box of the
            least volume; or (3,) sides of such a box, in any order, m.

    Returns:
        (3,) float64, m.

    Raises:
        ValueError: there are not three sides, one is negative or not finite,
            or length or width is 0.
    """
    if isinstance(mesh_or_extents, trimesh.Trimesh):
        sides = trimesh.bounds.oriented_bounds(mesh_or_extents)[1]
    else:
        sides = mesh_or_extents
    size = np.array(sides, dtype=float)
    if (
        size.shape != (3,)
        or not np.all(np.isfinite(size))
        or size.min() < 0
        or np.count_nonzero(size) < 2
    ):
        raise ValueError(
            f"{size.tolist()} is no size of a target: length, width and "
            "thickness in m are needed, length and width above 0"
        )
    return np.sort(size)[::-1]


def aspect_ratio(mesh_or_extents: trimesh.Trimesh | ArrayLike) -> float:
    """Returns L / W ≥ 1, of the two longer sides.

    Args:
        mesh_or_extents: as :func:`oriented_size` takes it.

    Raises:
        ValueError: it has no size.
    """
    length, width, _ = oriented_size(mesh_or_extents)
    return float(length / width)


def box_scale(size: trimesh.Trimesh | ArrayLike) -> float:
    """Returns s = √(L·W) / 0.03 m, how much larger than the boxes it is.

    Args:
        size: as :func:`oriented_size` takes it.

    Raises:
        ValueError: it has no size.
    """
    length, width, _ = oriented_size(size)
    return float(np.sqrt(length * width) / BOX_SIDE)


def nearest_ratio(ratio: float, available: Sequence[float]) -> float:
    """Returns the one of ``available`` that is nearest in logarithm.

    So 1:1 and 4:1 are as far from 2:1; of two that are as near, the smaller.

    Args:
        ratio: of the target, above 0.
        available: of the networks, above 0; at least one.
    """
    return min(available, key=lambda a: (abs(np.log(a) - np.log(ratio)), a))


def rescale_input(
    depth: np.ndarray, mask: np.ndarray, s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Scales what is seen by 1/s about the image's centre.

    Pixel (u, v) of the result shows what (u₀ + s (u − u₀), v₀ + s (v − v₀))
    showed, the nearest pixel, with (u₀, v₀) half of (width − 1, height − 1).
    Depths stay metric, as PROTOCOL.md has it: a large target gets smaller, not
    farther away. What lies outside the image is not known.

    Args:
        depth: (H, W) z-depth, m.
        mask: (H, W) bool.
        s: above 0; 1 returns the arguments themselves.

    Returns:
        depth and mask of the same shapes and types; 0 (no reading) and False
        where nothing is known.
    """
    if s == 1:
        return depth, mask
    rows, row_known = _nearest(depth.shape[0], s)
    columns, column_known = _nearest(depth.shape[1], s)
    known = row_known[:, None] & column_known
    at = np.ix_(rows, columns)
    return (
        np.where(known, depth[at], depth.dtype.type(0)),
        np.where(known, mask[at], mask.dtype.type(0)),
    )


def rescale_output(distribution: np.ndarray, s: float) -> np.ndarray:
    """Scales a distribution back, by s about the image's centre, bilinearly.

    It is not normalised again: its maximum may drop a little.

    Args:
        distribution: (H, W) float32, for an image of :func:`rescale_input`.
        s: as it was there; 1 returns the argument itself.

    Returns:
        (H, W) float32; 0 where s is below 1 and nothing is known.
    """
    if s == 1:
        return distribution
    height, width = distribution.shape
    center = np.array([width - 1, height - 1]) / 2
    to_input = np.column_stack([np.eye(2) / s, center - center / s])
    return cv2.warpAffine(
        distribution.astype(np.float32, copy=False),
        to_input,
        (width, height),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=0,
    )


def _nearest(size: int, s: float) -> tuple[np.ndarray, np.ndarray]:
    """(size,) what each pixel shows along one axis, and whether it is seen."""
    center = (size - 1) / 2
    # All halves go up; np.rint would send every other one down.
    shown = np.floor(center + s * (np.arange(size) - center) + 0.5)
    known = (shown >= 0) & (shown < size)
    return np.clip(shown, 0, size - 1).astype(int), known
