"""Turns rims and places of a depth image into poses of the gripper."""

from dataclasses import dataclass

import numpy as np

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.grasping.candidates import JAW_TILTS, GraspCandidates
from xray_drake.grasping.depth_jaw import RimPairs
from xray_drake.grasping.judgement import DOWN, GraspJudge
from xray_drake.grasping.sampling import SuctionPoints
from xray_drake.messages import GraspKind

_CELL = 0.005
"""Pairs whose middles fall in one cell of this size, m, are alike."""

_EQUAL_ANGLE = 0.005
"""Pairs whose angles are in one step of this size are as well aligned, rad."""

_LEVER = 0.03
"""Horizontal distance from the object's middle that halves a score, m."""

_NOT_ROOMY = 0.6
"""Robustness of a cup so near an edge that a wider one would not seal."""


@dataclass(frozen=True, eq=False)
class SeenObject:
    """What candidates are compared by.

    Attributes:
        center: (3,) middle of what is seen of the object, in the world, m.
        camera: that sees it. Candidates are put in groups in its frame, so
            that they turn as scene and camera do.
    """

    center: np.ndarray
    camera: PinholeCamera

    def lever(self, points: np.ndarray) -> np.ndarray:
        """Returns (n,) horizontal distances of (n, 3) points, m."""
        return np.linalg.norm((points - self.center)[:, :2], axis=1)

    def cells(self, points: np.ndarray, axes: np.ndarray) -> np.ndarray:
        """Returns (n, 6) integers, the same for alike points and axes."""
        R, p = self.camera.X_WC[:3, :3], self.camera.X_WC[:3, 3]
        return np.column_stack(
            [np.round((points - p) @ R / _CELL), np.round(3 * axes @ R)]
        )


def _groups(cells: np.ndarray) -> np.ndarray:
    if len(cells) == 0:
        return np.zeros(0, int)
    return np.unique(cells, axis=0, return_inverse=True)[1].reshape(-1)


def _steepness(approach: np.ndarray, max_tilt: float) -> np.ndarray:
    """0 at the largest tilt allowed, 1 straight down, negative beyond."""
    limit = np.cos(max_tilt)
    return (-approach[:, 2] - limit) / (1.0 - limit)


def distinct_pairs(pairs: RimPairs, seen: SeenObject) -> RimPairs:
    """Returns the best aligned of all pairs that are alike."""
    order = np.argsort(np.floor(pairs.angle / _EQUAL_ANGLE), kind="stable")
    pairs = pairs.take(order)
    cells = seen.cells(0.5 * (pairs.first + pairs.second), pairs.axis)
    if len(cells) == 0:
        return pairs
    return pairs.take(np.unique(cells, axis=0, return_index=True)[1])


def jaw_poses(
    pairs: RimPairs,
    seen: SeenObject,
    rules: GraspJudge,
    *,
    friction: float,
    max_tilt: float,
    insertion: float,
) -> GraspCandidates:
    """Approaches pairs of rims from above.

    Each pair is approached by the steepest direction across its axis and by
    others about the axis, with the jaw either way round.

    Args:
        pairs: of one object.
        seen: the object.
        rules: knows the gripper.
        friction: Coulomb coefficient.
        max_tilt: largest angle between approach and straight down, rad.
        insertion: how far below the lower rim the fingertips go, m.
    """
    across = DOWN - (pairs.axis @ DOWN)[:, None] * pairs.axis
    steepest = across / np.maximum(
        np.linalg.norm(across, axis=1, keepdims=True), 1e-9
    )
    sideways = np.cross(pairs.axis, steepest)

    # Axes (tilt, side, pair), then flat.
    approach = (
        np.cos(JAW_TILTS)[:, None, None] * steepest
        + np.sin(JAW_TILTS)[:, None, None] * sideways
    )
    sides = np.array([1.0, -1.0])
    shape = (len(JAW_TILTS), len(sides), len(pairs), 3)
    z = np.broadcast_to(approach[:, None], shape).reshape(-1, 3)
    y = np.broadcast_to(sides[:, None, None] * pairs.axis, shape)
    y = y.reshape(-1, 3)
    pair = np.tile(np.arange(len(pairs)), len(JAW_TILTS) * len(sides))
    way = np.repeat(np.arange(len(JAW_TILTS) * len(sides)), len(pairs))

    middle = 0.5 * (pairs.first + pairs.second)
    half = 0.5 * (pairs.first - pairs.second)
    beyond = np.abs(np.einsum("ni,ni->n", half[pair], z)) + insertion
    X_WG = np.tile(np.eye(4), (len(z), 1, 1))
    X_WG[:, :3, :3] = np.stack([np.cross(y, z), y, z], axis=-1)
    X_WG[:, :3, 3] = (
        middle[pair] + (beyond - rules.gripper.tip_length)[:, None] * z
    )
    width = pairs.width[pair]
    steepness = _steepness(z, max_tilt)
    alignment = 1 - pairs.angle[pair] / np.arctan(max(friction, 1e-6))
    slack = np.clip(
        (rules.parameters.opening - width) / (2 * rules.config.clearance),
        0.0,
        1.0,
    )
    score = (
        (0.5 + 0.5 * alignment)
        * (0.5 + 0.5 * steepness)
        * (0.5 + 0.5 * slack)
        / (1 + (seen.lever(middle)[pair] / _LEVER) ** 2)
    )
    group = _groups(
        np.column_stack([seen.cells(middle, pairs.axis)[pair], way])
    )
    return GraspCandidates(
        kind=GraspKind.JAW,
        X_WG=X_WG,
        width=width,
        score=score,
        group=group,
        robustness=np.ones(len(z)),
    ).take(steepness >= 0)


def cup_poses(
    points: SuctionPoints,
    seen: SeenObject,
    *,
    seal_tolerance: float,
    max_tilt: float,
    turns: int,
) -> GraspCandidates:
    """Approaches places where the cup seals, turned about its axis.

    Args:
        points: on one object.
        seen: the object.
        seal_tolerance: unevenness at which the cup just seals, m.
        max_tilt: largest angle between approach and straight down, rad.
        turns: of the gripper about the cup's axis.
    """
    steepness = _steepness(points.approach, max_tilt)
    robustness = np.where(points.roomy, 1.0, _NOT_ROOMY)
    evenness = 1 - points.unevenness / seal_tolerance
    score = (
        robustness
        * (0.5 + 0.5 * evenness)
        * (0.5 + 0.5 * steepness)
        / (1 + (seen.lever(points.point) / _LEVER) ** 2)
    )
    usable = np.flatnonzero(steepness >= 0)
    place = np.repeat(usable, turns)
    angle = 2 * np.pi * np.tile(np.arange(turns), len(usable)) / turns
    z = points.approach[place]
    ahead = seen.camera.X_WC[:3, 0]
    x = ahead - (z @ ahead)[:, None] * z
    x = x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-9)
    x = np.cos(angle)[:, None] * x + np.sin(angle)[:, None] * np.cross(z, x)
    X_WG = np.tile(np.eye(4), (len(z), 1, 1))
    X_WG[:, :3, :3] = np.stack([x, np.cross(z, x), z], axis=-1)
    X_WG[:, :3, 3] = points.point[place]
    return GraspCandidates(
        kind=GraspKind.SUCTION,
        X_WG=X_WG,
        width=np.zeros(len(place)),
        score=score[place],
        group=np.tile(np.arange(turns), len(usable)),
        robustness=robustness[place],
    )
