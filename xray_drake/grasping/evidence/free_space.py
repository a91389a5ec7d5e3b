"""Where a gripper may go: only where a camera has seen that there is nothing.

What lies behind the surface that a camera sees is unknown, and taken as full;
so is what lies outside its image. So a body is free of collision if every point
of it is in the image, and nearer to the camera than the surface in the same
pixel. Points on the gripper's faces are compared with a
depth image in which every pixel has the least depth around it; so what lies
between them is not missed.
"""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from xray_drake.cell.bin import Bin
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.grasping.evidence.approach_shape import ApproachShape
from xray_drake.messages import GraspKind

ROOM_LEVELS = (0.0, 0.002, 0.004, 0.008)
"""Distances from the surface, across the view, that are told apart, m."""

_FLOOR_NOISE = 0.002
"""Readings less than this above the bin's floor are of the floor, m. Who asks
keeps the fingertips above it, since the floor is known better than seen."""

_WALL_MARGIN = 0.002
"""Kept from the bin's walls, beyond whose edges no points need be, m."""

_CHUNK = 16_000
"""Points compared at once, few enough to stay in the processor's cache."""

_IDENTITY = np.eye(4)[:3]


def lower_floor(depth: np.ndarray, camera: PinholeCamera) -> np.ndarray:
    """Returns a depth image whose floor is a little lower than the bin's.

    Args:
        depth: (H, W) z-depth, m.
        camera: of the image.
    """
    a, b, c = camera.pixel_to_ray[2]
    slope = a * np.arange(camera.width) + (
        b * np.arange(camera.height)[:, None] + c
    )
    height = camera.X_WC[2, 3] + slope * depth
    below = (-_FLOOR_NOISE - camera.X_WC[2, 3]) / np.minimum(slope, -1e-6)
    return np.where(height < _FLOOR_NOISE, below, depth)


def bin_room(points_W: np.ndarray, bin_: Bin) -> np.ndarray:
    """Returns how far from the bin's walls points stay.

    Beyond the walls' inside and below their top all is taken as full.

    Args:
        points_W: (n, 3, m) in the world, m.
        bin_: the bin.

    Returns:
        (n,) the least distance, across or above the walls, m.
    """
    points_W = np.moveaxis(points_W, 1, -1)
    above = points_W[..., 2] - bin_.wall_height
    return np.maximum(bin_.distance_to_walls(points_W), above).min(axis=1)


class FreeSpace:
    """Compares approaches with a depth image, and with the bin's walls."""

    def __init__(
        self,
        depth: np.ndarray,
        camera: PinholeCamera,
        shapes: Mapping[GraspKind, ApproachShape],
        bin_: Bin,
        *,
        levels: Sequence[float] = ROOM_LEVELS,
    ) -> None:
        """Prepares the image.

        Args:
            depth: (H, W) z-depth without gaps, m; inf where a pixel shows
                nothing.
            camera: of the image.
            shapes: of each kind of grasp.
            bin_: in which the heap lies.
            levels: rooms to tell apart, rising, m.
        """
        self._shape = camera.shape
        self._shapes = shapes
        self._bin = bin_
        self._levels = np.array(levels)
        self._projection = camera.intrinsics @ np.linalg.inv(camera.X_WC)[:3]
        shown = np.isfinite(depth)
        usual = float(np.median(depth[shown])) if shown.any() else 1.0
        pixel = usual / float(camera.intrinsics[0, 0])
        image = lower_floor(depth, camera).astype(np.float32)
        self._images = {
            spacing: self._nearest_around(
                image, (self._levels + 0.5 * spacing) / pixel
            )
            for shape in shapes.values()
            for spacing in set(shape.spacings)
        }

    @staticmethod
    def _nearest_around(
        image: np.ndarray, radii: np.ndarray
    ) -> list[np.ndarray]:
        """Returns images of the least depth within rising radii, pixels.

        Outside the image the depth is 0: nothing is nearer.
        """
        images, done = [], 0
        for radius in np.ceil(radii).astype(int).tolist():
            size = 2 * (radius - done) + 1
            kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
            image = cv2.erode(
                image, kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0.0
            )
            images.append(image.ravel())
            done = radius
        return images

    def tips_are_free(
        self, kind: GraspKind, X_WG: np.ndarray, opening: np.ndarray
    ) -> np.ndarray:
        """Returns whether a few points at the gripper's end are free, fast.

        Args:
            kind: jaw or suction.
            X_WG: (n, 4, 4) poses of the grasp frame in the world.
            opening: (n,) distances of the pads, m; of no account for suction.

        Returns:
            (n,) bool.
        """
        shape = self._shapes[kind]
        free = np.zeros(len(X_WG), bool)
        image = self._images[shape.spacings[0]][0]
        for part in self._chunks(np.arange(len(X_WG)), shape, 0):
            pixel, z = self._seen(shape, 0, X_WG[part], opening[part])
            free[part] = (z < image[pixel]).all(axis=1)
        return free

    def room(
        self, kind: GraspKind, X_WG: np.ndarray, opening: np.ndarray
    ) -> np.ndarray:
        """Returns how much room the gripper has on its approach.

        Sideways, as the camera sees it: what is below stops the gripper, but
        does not catch it.

        Args:
            kind: jaw or suction.
            X_WG: (n, 4, 4) poses of the grasp frame in the world.
            opening: (n,) distances of the pads, m; of no account for suction.

        Returns:
            (n,) the largest of the levels that is kept, m; −1 where the
            gripper is not free.
        """
        shape = self._shapes[kind]
        best = np.full(len(X_WG), len(self._levels))
        for part, spacing in enumerate(shape.spacings):
            alive = np.flatnonzero(best > 0)
            for chunk in self._chunks(alive, shape, part):
                poses = part, X_WG[chunk], opening[chunk]
                best[chunk] = np.minimum(
                    best[chunk], self._count(shape, spacing, *poses)
                )
        return np.concatenate([[-1.0], self._levels])[best]

    @staticmethod
    def _chunks(
        index: np.ndarray, shape: ApproachShape, part: int
    ) -> list[np.ndarray]:
        size = max(1, _CHUNK // shape.parts[part][0].shape[1])
        return [index[i : i + size] for i in range(0, len(index), size)]

    def _seen(
        self,
        shape: ApproachShape,
        part: int,
        X_WG: np.ndarray,
        opening: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Returns (n, m) pixels, as indices, and z-depths of a part's points.

        What is outside the image has a depth of inf: it is not free.
        """
        height, width = self._shape
        uvz = shape.transform(part, self._projection, X_WG, opening)
        z = uvz[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.rint(uvz[:, 0] / z)
            v = np.rint(uvz[:, 1] / z)
        seen = (u >= 0) & (u < width) & (v >= 0) & (v < height) & (z > 0)
        pixel = np.where(seen, v * width + u, 0).astype(np.int32)
        return pixel, np.where(seen, z, np.inf)

    def _count(
        self,
        shape: ApproachShape,
        spacing: float,
        part: int,
        X_WG: np.ndarray,
        opening: np.ndarray,
    ) -> np.ndarray:
        """Returns (n,) how many of the levels a part keeps."""
        pixel, z = self._seen(shape, part, X_WG, opening)
        count = np.full(len(z), len(self._levels))
        for level, image in enumerate(self._images[spacing]):
            alive = np.flatnonzero(count > level)
            hit = (z[alive] >= image[pixel[alive]]).any(axis=1)
            count[alive[hit]] = level
        alive = np.flatnonzero(count)
        walls = bin_room(
            shape.transform(part, _IDENTITY, X_WG[alive], opening[alive]),
            self._bin,
        )
        keeps = np.searchsorted(
            self._levels + _WALL_MARGIN, walls, side="right"
        )
        count[alive] = np.minimum(count[alive], keeps)
        return count
