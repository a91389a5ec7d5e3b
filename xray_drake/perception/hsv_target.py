"""The target by its colour: the paper's detection of the real target."""

from dataclasses import dataclass

import cv2
import numpy as np

from xray_drake.configuration import count, number
from xray_drake.messages import TargetMask


@dataclass
class HsvTargetConfig:
    """Which colours are the target's, and how much of them is enough."""

    # Middle of the target's hues, degrees; 0 is red.
    hue: float = number(0.0, "[-360, 360]")
    # How far a hue may be from it, on either side, degrees.
    hue_tolerance: float = number(15.0, "[0, 180]")
    # Paler than this is not the target: saturation in [0, 1].
    min_saturation: float = number(0.6, "[0, 1]")
    # Darker than this has no hue to speak of: value in [0, 1].
    min_value: float = number(0.1, "[0, 1]")
    # Patches of fewer pixels are specks, not the target.
    min_area: int = count(10, "[1, 10000000]")


def detect_target(
    image: np.ndarray, config: HsvTargetConfig | None = None
) -> TargetMask:
    """Finds the pixels of the target's colour.

    All patches that are large enough count: what lies on the target may part
    its modal mask.

    Args:
        image: (H, W, 3) uint8 RGB.
        config: by default red.

    Returns:
        The mask; blank where nothing is found.

    Raises:
        ValueError: not an RGB image.
    """
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise ValueError(
            f"a colour image is (H, W, 3) uint8, not {image.shape} "
            f"{image.dtype}"
        )
    config = config or HsvTargetConfig()
    hue, saturation, value = cv2.split(
        cv2.cvtColor(image.astype(np.float32) / 255, cv2.COLOR_RGB2HSV)
    )
    # The hue is an angle, so both ends of its circle are one.
    off = np.abs((hue - config.hue + 180) % 360 - 180)
    colored = (
        (off <= config.hue_tolerance)
        & (saturation >= config.min_saturation)
        & (value >= config.min_value)
    )
    _, patches, stats, _ = cv2.connectedComponentsWithStats(
        colored.astype(np.uint8), connectivity=8
    )
    large = stats[:, cv2.CC_STAT_AREA] >= config.min_area
    large[0] = False
    return TargetMask(large[patches])
