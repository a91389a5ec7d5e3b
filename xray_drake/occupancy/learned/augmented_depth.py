"""What the paper's networks see (section IV.A)."""

import numpy as np

from xray_drake.geometry.readings import has_reading

NOMINAL_DEPTH = 0.8
"""Depth that the network sees as 0, m: the floor from the nominal camera."""

DEPTH_UNIT = 0.1
"""Depth that the network sees as 1, m."""

NO_READING = 3.0
"""What the network sees where there is no reading, and the farthest that it
sees: 1.1 m, behind the floor, where nothing can hide anything."""


def augmented_depth(depth: np.ndarray, modal: np.ndarray) -> np.ndarray:
    """Returns the network's input (paper section IV.A).

    Args:
        depth: (H, W) z-depth, m; 0 or not finite where there is no reading.
        modal: (H, W) bool, the target's visible pixels; blank where hidden.

    Returns:
        (3, H, W) float32: the mask as 0 and 1, then twice the depth as
        (depth − :data:`NOMINAL_DEPTH`) / :data:`DEPTH_UNIT`, clipped to
        ±:data:`NO_READING`, and :data:`NO_READING` where there is none.
    """
    seen = np.empty((3, *depth.shape), np.float32)
    seen[0] = modal
    seen[1] = depth
    valid = has_reading(seen[1])
    seen[1] -= NOMINAL_DEPTH
    seen[1] /= DEPTH_UNIT
    np.clip(seen[1], -NO_READING, NO_READING, out=seen[1])
    seen[1][~valid] = NO_READING
    seen[2] = seen[1]
    return seen
