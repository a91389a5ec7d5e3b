"""What inference is told wrongly: a noisy depth, a floor, a focal length."""

import math
from dataclasses import dataclass, replace

import numpy as np

from xray_drake.dataset.augmentation import DepthNoise
from xray_drake.dataset.images import labelled_images
from xray_drake.dataset.sample import Sample
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.seeding import stream


def believed_camera(
    camera: PinholeCamera, height_offset: float, focal_error: float
) -> PinholeCamera:
    """Returns a camera as a wrong calibration has it.

    Args:
        camera: as it is.
        height_offset: m, by which it is believed to be higher.
        focal_error: share by which its focal length is believed to be larger.
    """
    X_WC = np.array(camera.X_WC)
    X_WC[2, 3] += height_offset
    K = np.array(camera.intrinsics)
    K[[0, 1], [0, 1]] *= 1 + focal_error
    return replace(camera, intrinsics=K, X_WC=X_WC)


@dataclass(frozen=True)
class Disturbance:
    """Changes what inference sees of a sample; the truth stays.

    Raises:
        ValueError: an offset or error that is no number, or a focal length
            that would not be positive.
    """

    # The sensor; None leaves the depth as it was rendered.
    noise: DepthNoise | None = None
    # Inference believes the camera so much higher, m: the floor is off.
    height_offset: float = 0.0
    # Inference believes the focal length larger by this share.
    focal_error: float = 0.0
    # Of the noise; with the sample's key it decides.
    seed: int = 0

    def __post_init__(self) -> None:
        if not math.isfinite(self.height_offset):
            raise ValueError(f"a height offset is not {self.height_offset} m")
        if not (math.isfinite(self.focal_error) and self.focal_error > -1):
            raise ValueError(
                f"an error of the focal length is a share above -1, not "
                f"{self.focal_error}"
            )

    def __call__(self, sample: Sample) -> Sample:
        """Returns the sample with depth, pose or intrinsics changed."""
        if self.noise is not None:
            sample = replace(sample, depth=self._seen(sample, self.noise))
        if not (self.height_offset or self.focal_error):
            return sample
        camera = believed_camera(
            sample.camera, self.height_offset, self.focal_error
        )
        return replace(sample, X_WC=camera.X_WC, intrinsics=camera.intrinsics)

    def _seen(self, sample: Sample, noise: DepthNoise) -> np.ndarray:
        key = sample.key
        images = labelled_images(sample)
        rng = stream(
            self.seed, "sensor", key.heap_seed, key.view, key.num_dropped
        )
        return noise.noisy(images.depth, images.focal_length, rng)
