"""Points and lines in the world, whichever Meshcat draws them."""

from dataclasses import dataclass

import numpy as np

from xray_drake.geometry.camera import PinholeCamera

_BOX_EDGES = [
    (a, b) for a in range(8) for b in range(a + 1, 8) if (a ^ b) in (1, 2, 4)
]


@dataclass(frozen=True, eq=False)
class Points:
    """Points in the world.

    Attributes:
        positions: (n, 3), m.
        colors: (n, 3) RGB in [0, 1].
        size: of a point, m.
    """

    positions: np.ndarray
    colors: np.ndarray
    size: float


@dataclass(frozen=True, eq=False)
class Lines:
    """Lines in the world.

    Attributes:
        ends: (n, 2, 3), m.
        color: RGB in [0, 1].
    """

    ends: np.ndarray
    color: tuple[float, float, float]


def frustum_lines(camera: PinholeCamera, depth: float) -> np.ndarray:
    """Returns the edges of what a camera sees.

    Args:
        camera: whose.
        depth: z-depth at which the frustum ends, m.

    Returns:
        (8, 2, 3): from the camera's centre to the image corners, and around,
        in the world, m.
    """
    rays = camera.rays()
    corners = camera.X_WC[:3, 3] + depth * np.array(
        [rays[0, 0], rays[0, -1], rays[-1, -1], rays[-1, 0]]
    )
    center = np.broadcast_to(camera.X_WC[:3, 3], corners.shape)
    return np.concatenate(
        [
            np.stack([center, corners], axis=1),
            np.stack([corners, np.roll(corners, -1, axis=0)], axis=1),
        ]
    )


def box_lines(X_WB: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Returns the edges of a box about the origin of a frame B.

    Args:
        X_WB: 4×4 pose, m.
        size: (3,) along the axes of B, m.

    Returns:
        (12, 2, 3) ends in the world, m.
    """
    signs = np.array([[(i >> k & 1) - 0.5 for k in range(3)] for i in range(8)])
    corners = (signs * size) @ X_WB[:3, :3].T + X_WB[:3, 3]
    return corners[np.array(_BOX_EDGES)]
