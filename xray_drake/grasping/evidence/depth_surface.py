"""What a depth image says of an object, and of the space around it.

The camera has looked through free space; what lies behind the surface that it
met is unknown, and taken as full.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.readings import (
    depth_readings,
    has_reading,
    nearest_values,
)

_MARGIN = 6
"""Pixels around the object that belong to its part of the image."""


@dataclass(frozen=True, eq=False)
class DepthSurface:
    """The part of a depth image around an object, with all gaps filled.

    Attributes:
        depth: (h, w) z-depth, m; inf where a ray without reading leaves the
            scene.
        points_W: (h, w, 3) what the pixels show, in the world, m; the camera
            where they show nothing.
        mask: (h, w) bool, the object's pixels.
        camera: of this part.
        whole: (H, W) z-depth of the whole image, m.
        whole_mask: (H, W) bool, the object's pixels in it.
        whole_camera: of the whole image.
    """

    depth: np.ndarray
    points_W: np.ndarray
    mask: np.ndarray
    camera: PinholeCamera
    whole: np.ndarray
    whole_mask: np.ndarray
    whole_camera: PinholeCamera

    @cached_property
    def normals_W(self) -> np.ndarray:
        """The (h, w, 3) unit normals; see :func:`surface_normals`."""
        return surface_normals(self)

    @property
    def object_points(self) -> np.ndarray:
        """The (n, 3) points of the object, in the world, m."""
        return self.points_W[self.mask]

    def pixel_size(self) -> float:
        """Returns how far apart the object's points are, m."""
        near = float(np.median(self.depth[self.mask]))
        return near / float(self.camera.intrinsics[0, 0])


def fill_gaps(depth: np.ndarray) -> np.ndarray:
    """Gives each pixel without a reading the farther of its row's next ones.

    Most gaps are shadows of the sensor's projector: what is lost there is the
    background, beside the edge that casts the shadow. A row without any
    reading shows nothing: inf.

    Args:
        depth: (h, w) z-depth, m.
    """
    read = has_reading(depth)
    if read.all():
        return depth
    height, width = depth.shape
    column = np.arange(width)
    before = np.maximum.accumulate(np.where(read, column, -1), axis=1)
    after = np.minimum.accumulate(
        np.where(read, column, width)[:, ::-1], axis=1
    )[:, ::-1]
    padded = np.zeros((height, width + 2), depth.dtype)
    padded[:, 1:-1] = np.where(read, depth, 0.0)
    row = np.arange(height)[:, None]
    filled = np.maximum(padded[row, before + 1], padded[row, after + 1])
    filled = np.where(read, depth, filled)
    return np.where(filled > 0, filled, np.inf)


def fill_mask(depth: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Gives each pixel of the mask without a reading its nearest in the mask.

    Args:
        depth: (h, w) z-depth, m; at least one pixel of the mask has a reading.
        mask: (h, w) bool.
    """
    known = mask & has_reading(depth)
    lost = mask & ~known
    if not lost.any():
        return depth
    nearest, _ = nearest_values(depth, known)
    filled = depth.copy()
    filled[lost] = nearest[lost]
    return filled


def observe(
    depth: np.ndarray,
    mask: np.ndarray,
    camera: PinholeCamera,
    *,
    min_pixels: int,
) -> DepthSurface | None:
    """Fills the gaps of a depth image and cuts out an object.

    Args:
        depth: (H, W) z-depth, m; 0, inf and NaN are no reading.
        mask: (H, W) bool, the object's pixels.
        camera: of both.
        min_pixels: readings of the object that there must be.

    Returns:
        The surface, or None where there are too few readings.

    Raises:
        ValueError: images of another shape than the camera's, or depths that
            are not in metres.
    """
    for name, image in (("depth image", depth), ("mask", mask)):
        if image.shape != camera.shape:
            raise ValueError(
                f"the {name} is {image.shape}, the camera's images are "
                f"{camera.shape}"
            )
    mask = np.asarray(mask, bool)
    depth = depth_readings(depth, camera)
    if np.count_nonzero(mask & has_reading(depth)) < max(min_pixels, 1):
        return None
    whole = fill_gaps(fill_mask(depth, mask))
    rows, columns = (
        slice(
            max(0, int(hits[0]) - _MARGIN),
            min(size, int(hits[-1]) + _MARGIN + 1),
        )
        for hits, size in (
            (np.flatnonzero(mask.any(axis=1)), camera.height),
            (np.flatnonzero(mask.any(axis=0)), camera.width),
        )
    )
    part = camera.cropped(rows, columns)
    depth = whole[rows, columns].astype(float)
    points = part.unproject(np.where(np.isfinite(depth), depth, 0.0))
    return DepthSurface(
        depth=depth,
        points_W=points,
        mask=mask[rows, columns],
        camera=part,
        whole=whole,
        whole_mask=mask,
        whole_camera=camera,
    )


def surface_normals(surface: DepthSurface, step: int = 2) -> np.ndarray:
    """Returns the (h, w, 3) unit normals of the object, towards the camera.

    By differences between the object's pixels ``step`` to either side; where
    there are none, by shorter ones. Of no meaning outside the mask.

    Args:
        surface: what is seen.
        step: pixels.
    """
    points, mask = surface.points_W, surface.mask
    tangents = []
    for axis in (0, 1):
        ends = []
        for sign in (-1, 1):
            end = points
            for size in range(1, step + 1):
                shift = -sign * size
                near = np.roll(mask, shift, axis=axis)
                end = np.where(
                    (near & mask)[..., None],
                    np.roll(points, shift, axis=axis),
                    end,
                )
            ends.append(end)
        tangents.append(ends[1] - ends[0])
    normal = np.cross(tangents[0], tangents[1])
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    up = -surface.camera.X_WC[:3, 2]
    return np.where(length > 1e-12, normal / np.maximum(length, 1e-12), up)
