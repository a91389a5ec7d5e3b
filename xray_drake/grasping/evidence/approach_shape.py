"""Points on a gripper and on all that it passes on a straight approach."""

import numpy as np

from xray_drake.grasping.gripper_geometry import GripperGeometry
from xray_drake.messages import GraspKind

TIP_SPACING = 0.0028
"""Distance of the points on what goes among the objects, m: the fingers, or
stem and cup."""

BODY_SPACING = 0.010
"""Distance of the points on the rest of the gripper, m."""

_END_LENGTH = 0.02
"""What is so far from the foremost point is the end of the gripper, m."""


def box_points(
    lower: np.ndarray,
    upper: np.ndarray,
    spacing: float,
    back: int | None = None,
) -> np.ndarray:
    """Returns (n, 3) points on a box but for its lower face of one axis."""
    axes = [
        np.linspace(a, b, 1 + max(1, int(np.ceil((b - a) / spacing))))
        for a, b in zip(lower, upper, strict=True)
    ]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    at_lower, at_upper = np.isclose(grid, lower), np.isclose(grid, upper)
    if back is not None:
        at_lower[:, back] = False
    return grid[(at_lower | at_upper).any(axis=1)]


def _tube_points(
    lower: np.ndarray, upper: np.ndarray, spacing: float
) -> np.ndarray:
    """Returns (n, 3) points on the cylinder along x in a box, but its back."""
    radius = 0.5 * (upper[1] - lower[1])
    middle = 0.5 * (lower + upper)

    def ring(r: float, x: float) -> np.ndarray:
        count = max(1, int(np.ceil(2 * np.pi * r / spacing)))
        angle = 2 * np.pi * np.arange(count) / count
        return np.stack(
            [
                np.full(count, x),
                middle[1] + r * np.cos(angle),
                middle[2] + r * np.sin(angle),
            ],
            axis=-1,
        )

    rings = [ring(radius, x) for x in np.arange(upper[0], lower[0], -spacing)]
    disc = [ring(r, upper[0]) for r in np.arange(radius - spacing, 0, -spacing)]
    return np.concatenate([*rings, *disc, ring(0.0, upper[0])])


class ApproachShape:
    """Spreads points on the faces of a gripper that comes straight.

    The gripper's boxes are extended backwards along the approach. Their rear
    faces are left out, since a gripper seen from above shows them, and so is
    what lies within another box.

    Attributes:
        parts: the points as (points (3, m), side (m,)), float32, in the
            gripper's base frame with the jaw open, m: a few of the gripper's
            end; all of the fingers, or of stem and cup; the rest. ``side`` is
            the direction along y in which a point moves when the jaw closes.
        spacings: distance of the points in each part, m.
    """

    spacings = (TIP_SPACING, TIP_SPACING, BODY_SPACING)

    def __init__(
        self,
        kind: GraspKind,
        gripper: GripperGeometry,
        *,
        approach_distance: float,
        cup_standoff: float,
    ) -> None:
        """Spreads the points.

        Args:
            kind: jaw or suction.
            gripper: its frames and boxes.
            approach_distance: length of the approach, m.
            cup_standoff: the cup ends this far before its lip, m.
        """
        tool = gripper.approach(kind, approach_distance, cup_standoff)
        lower, upper, closing = tool.lower, tool.upper, tool.closing
        ahead = 2 if kind is GraspKind.JAW else 0
        slender = (closing != 0) | tool.round
        shut = 0.5 * gripper.open_width * np.array([0.0, 1.0, 0.0])

        clouds, sides, fine = [], [], []
        for i in range(len(lower)):
            spacing = TIP_SPACING if slender[i] else BODY_SPACING
            points = (
                _tube_points(lower[i], upper[i], spacing)
                if tool.round[i]
                else box_points(lower[i], upper[i], spacing, back=ahead)
            )
            within = np.zeros(len(points), bool)
            for j in np.flatnonzero((closing == 0) & ~tool.round):
                ways = (points, points + closing[i] * shut)
                within |= (j != i) & np.all(
                    [((p > lower[j]) & (p < upper[j])) for p in ways],
                    axis=(0, 2),
                )
            clouds.append(points[~within])
            sides.append(np.full(len(clouds[-1]), closing[i]))
            fine.append(np.full(len(clouds[-1]), slender[i]))
        cloud, side = np.concatenate(clouds), np.concatenate(sides)
        is_fine = np.concatenate(fine)
        along = cloud[:, ahead]
        end = np.flatnonzero(is_fine & (along > along.max() - _END_LENGTH))
        self.parts = tuple(
            (cloud[part].astype(np.float32).T, side[part].astype(np.float32))
            for part in (end[::2], is_fine, ~is_fine)
        )
        self._open_width = gripper.open_width
        self._X_GB = np.linalg.inv(gripper.frame(kind))

    def transform(
        self, part: int, A: np.ndarray, X_WG: np.ndarray, opening: np.ndarray
    ) -> np.ndarray:
        """Maps the points of a part at many poses.

        Args:
            part: which.
            A: (3, 4) affine or projective map of world points.
            X_WG: (n, 4, 4) poses of the grasp frame.
            opening: (n,) distances of the pads, m.

        Returns:
            (n, 3, m) float32.
        """
        points, side = self.parts[part]
        M = (A @ X_WG @ self._X_GB).astype(np.float32)
        mapped = M[:, :, :3] @ points
        mapped += M[:, :, 3:]
        if side.any():
            travel = 0.5 * (self._open_width - opening).astype(np.float32)
            mapped += (M[:, :, 1] * travel[:, None])[:, :, None] * side
        return mapped
