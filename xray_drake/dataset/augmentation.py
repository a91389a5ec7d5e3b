"""Makes many observations of one: mirrored, turned, seen by a real sensor.

All act on :class:`LabelledImages`, and draw from the generator that they are
given alone. A mirrored or turned image has no camera pose any more, which is
why the reader returns none.
"""

import math
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from xray_drake.configuration import count, number
from xray_drake.dataset.images import LabelledImages
from xray_drake.perception.depth_noise import DepthNoise


@dataclass(frozen=True)
class Augmentation:
    """What the reader does to a sample before it is scaled down."""

    # Mirror left and right, up and down, each in every second image.
    flips: bool = True
    # Turn about the image centre by up to ±, rad. What comes from outside the
    # image has no reading and no label.
    max_rotation: float = number(math.pi, "[0, 3.1416]")
    # The sensor; None leaves the depth as it was rendered.
    noise: DepthNoise | None = field(default_factory=DepthNoise)
    # Grow or shrink the modal mask by up to so many pixels.
    mask_noise: int = count(0, "[0, 100]")

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
            images = sense(images, self.noise, rng)
        if self.mask_noise > 0:
            images = resize_mask(
                images, int(rng.integers(-self.mask_noise, self.mask_noise + 1))
            )
        return images


def sense(
    images: LabelledImages, noise: DepthNoise, rng: np.random.Generator
) -> LabelledImages:
    """Returns images with a noisy depth; all else is as it was."""
    depth = noise.noisy(images.depth, images.focal_length, rng)
    return replace(images, depth=depth)


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
