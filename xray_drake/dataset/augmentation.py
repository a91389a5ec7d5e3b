"""Makes many observations of one: mirrored, turned, seen by a real sensor.

All act on :class:`LabelledImages`, and draw from the generator that they are
given alone. A mirrored or turned image has no camera pose any more, which is
why the reader returns none.
"""

import math
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from xray_drake.dataset.images import LabelledImages


@dataclass(frozen=True)
class DepthNoise:
    """A structured-light sensor; the figures are ours, not a data sheet's.

    Each is an upper limit: an image draws its own share of it.
    """

    # Standard deviation at 1 m, m; it grows with the square of the depth.
    sigma: float = 0.0004
    # Step of 1/depth that the sensor resolves, 1/m.
    inverse_depth_step: float = 1e-4
    # Distance of the projector from the camera, along image x, m. What the
    # projector does not reach has no reading.
    baseline: float = 0.15
    # Surfaces seen at a larger angle from their normal have no reading, rad;
    # an image draws between this and a right angle. Depth edges are such.
    max_incidence: float = math.radians(78)
    # Expected number of blobs without a reading (dark or shiny places), and
    # their largest radius in pixels of an image 512 wide.
    blobs: float = 4.0
    blob_radius: float = 8.0
    # Share of single pixels without a reading.
    speckle: float = 0.003

    def __call__(
        self, images: LabelledImages, rng: np.random.Generator
    ) -> LabelledImages:
        """Returns images with a noisy depth; missing readings stay missing."""
        depth = images.depth
        lost = (
            (depth <= 0)
            | self._unlit(images, rng)
            | self._grazing(images, rng)
            | self._blobs(images, rng)
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
        return replace(images, depth=depth)

    def _unlit(
        self, images: LabelledImages, rng: np.random.Generator
    ) -> np.ndarray:
        return unlit(
            images.depth,
            images.focal_length,
            rng.uniform(-self.baseline, self.baseline),
        )

    def _grazing(
        self, images: LabelledImages, rng: np.random.Generator
    ) -> np.ndarray:
        """(H, W) bool: seen too much from the side.

        Of angles to the camera's axis, by differences smoothed over 3 × 3
        pixels: a turned image has steps.
        """
        depth = np.ascontiguousarray(images.depth)
        limit = math.tan(rng.uniform(self.max_incidence, math.pi / 2))
        right, down = (
            cv2.Sobel(depth, cv2.CV_32F, *order, ksize=3, scale=1 / 8)
            for order in ((1, 0), (0, 1))
        )
        slope_squared = down * down + right * right
        steepest = np.float32(limit / images.focal_length) * depth
        return slope_squared > steepest * steepest

    def _blobs(
        self, images: LabelledImages, rng: np.random.Generator
    ) -> np.ndarray:
        height, width = images.shape
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


@dataclass(frozen=True)
class Augmentation:
    """What the reader does to a sample before it is scaled down."""

    # Mirror left and right, up and down, each in every second image.
    flips: bool = True
    # Turn about the image centre by up to ±, rad. What comes from outside the
    # image has no reading and no label.
    max_rotation: float = math.pi
    # The sensor; None leaves the depth as it was rendered.
    noise: DepthNoise | None = field(default_factory=DepthNoise)
    # Grow or shrink the modal mask by up to so many pixels.
    mask_noise: int = 0

    def __call__(
        self, images: LabelledImages, rng: np.random.Generator
    ) -> LabelledImages:
        """Returns one of the many observations.

        The sensor comes last: its projector does not turn with the heap.
        """
        if self.flips:
            images = flip(
                images,
                left_right=bool(rng.integers(2)),
                up_down=bool(rng.integers(2)),
            )
        if self.max_rotation > 0:
            images = rotate(
                images, rng.uniform(-self.max_rotation, self.max_rotation)
            )
        if self.noise is not None:
            images = self.noise(images, rng)
        if self.mask_noise > 0:
            images = resize_mask(
                images, int(rng.integers(-self.mask_noise, self.mask_noise + 1))
            )
        return images


def flip(
    images: LabelledImages, *, left_right: bool = False, up_down: bool = False
) -> LabelledImages:
    """Mirrors all images."""
    rows = slice(None, None, -1 if up_down else 1)
    columns = slice(None, None, -1 if left_right else 1)
    return replace(
        images,
        depth=images.depth[rows, columns],
        modal=images.modal[rows, columns],
        amodal=images.amodal[rows, columns],
        occupancy=images.occupancy[rows, columns],
    )


def rotate(images: LabelledImages, angle: float) -> LabelledImages:
    """Turns all images about the centre, each pixel taking the nearest one.

    No value is mixed from two: edges stay sharp and the readings true. Depth
    does not change as long as the centre is the principal point.

    Args:
        images: to be turned.
        angle: rad, counterclockwise as seen.

    Returns:
        Images of the same shape. What comes from outside has no reading, is in
        no mask and has occupancy 0; what leaves is lost, perhaps with the
        distribution's maximum.
    """
    height, width = images.shape
    c, s = math.cos(angle), math.sin(angle)
    # Source pixel of each pixel; image y points down.
    rows = np.arange(height)[:, None] - (height - 1) / 2
    columns = np.arange(width)[None, :] - (width - 1) / 2

    def nearest(
        along_row: float, along_column: float, middle: float
    ) -> np.ndarray:
        # A hair more: rounding errors of a quarter turn must not decide.
        source = (along_row * columns + (middle + 1e-3)).astype(np.float32)
        source = source + (along_column * rows).astype(np.float32)
        return np.rint(source, out=source).astype(np.int32)

    source_u = nearest(c, -s, (width - 1) / 2)
    source_v = nearest(s, c, (height - 1) / 2)
    outside = (source_u < 0) | (source_u >= width)
    outside |= (source_v < 0) | (source_v >= height)
    source_v *= width
    source_v += source_u
    source_v[outside] = 0

    def turned(image: np.ndarray) -> np.ndarray:
        found = image.reshape(-1)[source_v]
        found[outside] = 0
        return found

    return replace(
        images,
        depth=turned(images.depth),
        modal=turned(images.modal),
        amodal=turned(images.amodal),
        occupancy=turned(images.occupancy),
    )


def resize_mask(images: LabelledImages, pixels: int) -> LabelledImages:
    """Grows the modal mask by so many pixels, or shrinks it.

    A blank mask stays blank; a small one may become so.
    """
    if pixels == 0:
        return images
    size = 2 * abs(pixels) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    change = cv2.dilate if pixels > 0 else cv2.erode
    modal = change(images.modal.astype(np.uint8), kernel)
    return replace(images, modal=modal > 0)


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
