"""What the depth image would show if an object were gone."""

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.floor_grid import observed_heights
from xray_drake.geometry.readings import depth_readings

_STEP = 0.001
"""A surface that is lower than the object's edge by less than this may be the
object's own, m."""


class Removal:
    """Imagines a heap without one of its objects.

    What lies behind an object is not known. Here each of its pixels takes the
    height of the nearest surface that is seen beside the object and lower than
    its edge there: what is seen to go under it goes on under it. Where nothing
    lower is seen beside it, it is taken to lie on the floor. Nothing moves.
    """

    def __init__(self, depth: np.ndarray, camera: PinholeCamera) -> None:
        """Measures the heights of an image.

        Args:
            depth: (H, W) float32 z-depth, m; 0, inf and NaN are no reading.
            camera: the camera of it.
        """
        self._depth = depth_readings(depth, camera)
        self.heights = observed_heights(self._depth, camera, 0.0)
        self._camera = camera

    def without(self, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns depth and heights without an object.

        Args:
            mask: (H, W) bool, the object's modal mask.

        Returns:
            (H, W) float32 z-depth and (H, W) float32 height over the floor, m.
        """
        heights = surface_behind(self.heights, mask)
        rows, columns = np.nonzero(mask)
        depth = self._depth.copy()
        ray = self._camera.pixel_to_ray[2] @ np.stack(
            [columns, rows, np.ones(len(rows))]
        )
        center = self._camera.X_WC[2, 3]
        depth[mask] = (heights[mask] - center) / ray
        return depth, heights


def surface_behind(heights: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Fills an object's pixels with what is seen to go under it.

    Args:
        heights: (H, W) float32 height over the floor, m; −inf is no reading.
        mask: (H, W) bool, the object.

    Returns:
        (H, W) float32 heights; nowhere higher than before, nor lower than the
        floor, unless they were.
    """
    result = heights.copy()
    if not mask.any():
        return result
    rows, columns = (np.flatnonzero(mask.any(axis=a)) for a in (1, 0))
    box = (
        slice(max(rows[0] - 1, 0), rows[-1] + 2),
        slice(max(columns[0] - 1, 0), columns[-1] + 2),
    )
    inside, around = mask[box], heights[box]
    own = np.where(inside, around, -np.inf).astype(np.float32)
    edge = cv2.dilate(own, np.ones((3, 3), np.uint8))
    lower = ~inside & (around < edge - _STEP) & (around > -np.inf)
    if lower.any():
        nearest = distance_transform_edt(
            ~lower, return_distances=False, return_indices=True
        )
        behind = around[tuple(nearest)]
    else:
        behind = np.zeros_like(around)
    result[box] = np.where(inside, np.minimum(around, behind), around)
    return result
