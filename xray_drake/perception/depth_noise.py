"""What a structured-light sensor makes of a depth image."""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from xray_drake.configuration import number
from xray_drake.geometry.readings import has_reading


@dataclass
class DepthNoise:
    """A structured-light sensor; the figures are ours, not a data sheet's.

    Each is an upper limit: an image draws its own share of it.
    """

    # Standard deviation at 1 m, m; it grows with the square of the depth.
    sigma: float = number(0.0004, "[0, 0.1]")
    # Step of 1/depth that the sensor resolves, 1/m.
    inverse_depth_step: float = number(1e-4, "[0, 1]")
    # Distance of the projector from the camera, along image x, m. What the
    # projector does not reach has no reading.
    baseline: float = number(0.15, "[-1, 1]")
    # Surfaces seen at a larger angle from their normal have no reading, rad;
    # an image draws between this and a right angle. Depth edges are such.
    max_incidence: float = number(math.radians(78), "(0, 1.5708]")
    # Expected number of blobs without a reading (dark or shiny places), and
    # their largest radius in pixels of an image 512 wide.
    blobs: float = number(4.0, "[0, 1000]")
    blob_radius: float = number(8.0, "[0, 1000]")
    # Share of single pixels without a reading.
    speckle: float = number(0.003, "[0, 1]")

    def noisy(
        self, depth: np.ndarray, focal_length: float, rng: np.random.Generator
    ) -> np.ndarray:
        """Returns a depth image as the sensor sees it.

        Args:
            depth: (H, W) z-depth, m; 0, inf and NaN are no reading and stay
                without one.
            focal_length: pixels.
            rng: decides what is drawn.

        Returns:
            (H, W) float32; 0 where there is no reading.
        """
        read = has_reading(depth)
        depth = np.ascontiguousarray(np.where(read, depth, 0), np.float32)
        lost = (
            ~read
            | unlit(
                depth, focal_length, rng.uniform(-self.baseline, self.baseline)
            )
            | self._grazing(depth, focal_length, rng)
            | self._blobs(depth.shape, rng)
            | (
                rng.random(depth.shape, dtype=np.float32)
                < rng.uniform(0, self.speckle)
            )
        )
        sigma = np.float32(rng.uniform(0, self.sigma))
        noise = rng.standard_normal(depth.shape, dtype=np.float32)
        depth = depth * (1 + sigma * depth * noise)
        lost |= depth <= 0
        depth[lost] = 1.0  # anything that can be divided by
        if self.inverse_depth_step > 0:
            step = np.float32(self.inverse_depth_step)
            depth = 1 / (np.maximum(np.rint(1 / (depth * step)), 1) * step)
        depth[lost] = 0.0
        return depth

    def _grazing(
        self, depth: np.ndarray, focal_length: float, rng: np.random.Generator
    ) -> np.ndarray:
        """(H, W) bool: seen too much from the side.

        Of angles to the camera's axis, by differences smoothed over 3 × 3
        pixels: a turned image has steps.
        """
        limit = math.tan(rng.uniform(self.max_incidence, math.pi / 2))
        right, down = (
            cv2.Sobel(depth, cv2.CV_32F, *order, ksize=3, scale=1 / 8)
            for order in ((1, 0), (0, 1))
        )
        slope_squared = down * down + right * right
        steepest = np.float32(limit / focal_length) * depth
        return slope_squared > steepest * steepest

    def _blobs(
        self, shape: tuple[int, ...], rng: np.random.Generator
    ) -> np.ndarray:
        height, width = shape
        canvas = np.zeros((height, width), np.uint8)
        largest = self.blob_radius * width / 512
        for _ in range(rng.poisson(self.blobs)):
            center = rng.uniform(0, (width, height)).astype(int)
            axes = np.ceil(rng.uniform(0, largest, 2)).astype(int)
            angle = rng.uniform(0, 180)
            cv2.ellipse(
                canvas, center.tolist(), axes.tolist(), angle, 0, 360, 1, -1
            )
        return canvas > 0


def unlit(
    depth: np.ndarray, focal_length: float, baseline: float
) -> np.ndarray:
    """Returns the pixels that a projector beside the camera does not reach.

    The projector looks along the camera's axis; in its image a point lies its
    disparity f·b/z away. Of all points of a row that fall on one projector
    pixel or cross over, only the nearest is lit.

    Args:
        depth: (H, W) z-depth, m; 0 where there is no reading, which shades
            nothing.
        focal_length: pixels.
        baseline: position of the projector along image x, m.

    Returns:
        (H, W) bool.
    """
    if baseline < 0:
        return unlit(depth[:, ::-1], focal_length, -baseline)[:, ::-1]
    valid = depth > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        disparity = focal_length * baseline / depth
    seen_at = np.where(valid, np.arange(depth.shape[1]) - disparity, np.inf)
    # Whatever lies farther right must be seen farther right, too.
    leftmost = np.minimum.accumulate(seen_at[:, ::-1], axis=1)[:, ::-1]
    beyond = np.full_like(seen_at, np.inf)
    beyond[:, :-1] = leftmost[:, 1:]
    return valid & (beyond <= seen_at)
