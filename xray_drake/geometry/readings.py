"""Which pixels of a depth image have a reading, and filling the others."""

from collections.abc import Mapping

import cv2
import numpy as np

from xray_drake.geometry.camera import PinholeCamera

FAR_BELOW = 0.05
"""m under the floor. What is lower is no reading: there is nothing to see."""

_LEAST_READ = 0.01
"""Share of the readings that are not so low in any image of a bin."""

_UNITS = {1e2: "centimetres", 1e3: "millimetres", 1e4: "tenths of millimetres"}
"""By how many of them make a metre."""


def has_reading(depth: np.ndarray) -> np.ndarray:
    """Returns where a z-depth image has a reading, bool; 0, inf, NaN is none.

    Args:
        depth: of any shape, m.
    """
    return np.isfinite(depth) & (depth > 0)


def check_shapes(
    images: Mapping[str, np.ndarray], camera: PinholeCamera
) -> None:
    """Refuses images that are not the camera's.

    Args:
        images: by what a message calls them.
        camera: that they should be of.

    Raises:
        ValueError: one has another shape.
    """
    for name, image in images.items():
        if image.shape != camera.shape:
            raise ValueError(
                f"the {name} is {image.shape}, the camera's images are "
                f"{camera.shape}"
            )


def depth_readings(depth: np.ndarray, camera: PinholeCamera) -> np.ndarray:
    """Checks a depth image, and takes out what lies far under the floor.

    Args:
        depth: (H, W) z-depth, m; 0, inf and NaN are no reading.
        camera: of the image.

    Returns:
        (H, W) float32; 0 where the reading was more than ``FAR_BELOW`` under
        the floor.

    Raises:
        ValueError: an image of integers, a camera that is not above the floor,
            or an image in which hardly anything lies over the floor, as when
            its depths are not in metres.
    """
    depth = np.asarray(depth)
    if depth.dtype.kind != "f":
        raise ValueError(
            f"the depth image is of {depth.dtype}: sensors give integers in "
            "millimetres; give metres, as depth / 1000.0 makes them"
        )
    if camera.X_WC[2, 3] <= 0:
        raise ValueError(
            f"the camera must be above the floor, not at z = "
            f"{camera.X_WC[2, 3]:.3f} m"
        )
    depth = depth.astype(np.float32, copy=False)
    limit = np.float32(-FAR_BELOW - camera.X_WC[2, 3])
    with np.errstate(invalid="ignore"):
        low = _slopes(camera) * depth < limit
    if not low.any():
        return depth
    read = has_reading(depth)
    low &= read
    number = np.count_nonzero(low)
    if number == 0:
        return depth
    if number > (1 - _LEAST_READ) * np.count_nonzero(read):
        raise ValueError(_wrong_unit(depth[low], camera))
    return np.where(low, np.float32(0.0), depth)


def _slopes(camera: PinholeCamera) -> np.ndarray:
    """Returns (H, W) float32: how far a ray climbs per unit of z-depth."""
    x, y, z = camera.pixel_to_ray[2]
    across = x * np.arange(camera.width) + z
    return np.add.outer(y * np.arange(camera.height), across, dtype=np.float32)


def _wrong_unit(depth: np.ndarray, camera: PinholeCamera) -> str:
    """Says what depths look like that are nearly all under the floor."""
    middle = float(np.median(depth))
    ratio = middle / float(camera.X_WC[2, 3])
    found = [unit for n, unit in _UNITS.items() if 0.4 * n < ratio < 2.5 * n]
    said = (
        f"the depth image's surfaces lie under the floor (depths of about "
        f"{middle:.4g} from a camera {camera.X_WC[2, 3]:.4g} m over it)"
    )
    if found:
        return f"{said}: it looks like {found[0]}; give metres"
    return f"{said}: are its depths metres, and is X_WC the camera's pose?"


def nearest_values(
    values: np.ndarray, known: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gives each pixel the value of the nearest one that is known.

    Args:
        values: (H, W).
        known: (H, W) bool, some True.

    Returns:
        (H, W) of the values' type; (H, W) float32, how far that pixel is,
        pixels.
    """
    away, label = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8),
        cv2.DIST_L2,
        cv2.DIST_MASK_5,
        labelType=cv2.DIST_LABEL_PIXEL,
    )
    value_of = np.zeros(int(label.max()) + 1, values.dtype)
    value_of[label[known]] = values[known]
    return value_of[label], away
