"""Turns samples on an object into poses of the gripper, ranked cheaply."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from xray_drake.grasping.gripper_geometry import GripperParameters
from xray_drake.grasping.judgement import DOWN, GRAVITY, GraspJudge
from xray_drake.grasping.sampling import AntipodalPairs, SuctionPoints
from xray_drake.grasping.wrench import suction_holding_force
from xray_drake.messages import Grasp, GraspKind
from xray_drake.scene.object_model import ObjectModel

JAW_TILTS = np.deg2rad([0.0, -20.0, 20.0, -40.0, 40.0])
"""Approaches of the jaw about its closing axis, from the steepest one, rad."""

_CELL = 0.01
"""Grasps whose centres fall in one cell of this size, m, are alike."""

_LEVER = 0.03
"""Horizontal distance from the centre of mass that halves a score, m."""

_NOT_ROOMY = 0.6
"""Robustness of a cup so near an edge that a wider one would not seal."""

EQUAL_QUALITY = 1e-3
"""Qualities that differ by no more are equal."""

_DIGITS = 4
"""Scores are compared after so many decimals."""


@dataclass(frozen=True, eq=False)
class GraspCandidates:
    """Poses to check, of one kind.

    Attributes:
        kind: jaw or suction.
        X_WG: (n, 4, 4) poses of the grasp frame in the world, m.
        width: (n,) distance of the contacts, m; 0 for suction.
        score: (n,) in [0, 1], more is better.
        group: (n,) of alike candidates: near each other on the object, and
            approached in the same way.
        robustness: (n,) factor of the grasp's quality, in (0, 1].
    """

    kind: GraspKind
    X_WG: np.ndarray
    width: np.ndarray
    score: np.ndarray
    group: np.ndarray
    robustness: np.ndarray

    def __len__(self) -> int:
        return len(self.score)

    def take(self, index: np.ndarray) -> "GraspCandidates":
        """Returns some of them, by index or by (n,) bool mask."""
        return GraspCandidates(
            self.kind,
            self.X_WG[index],
            self.width[index],
            self.score[index],
            self.group[index],
            self.robustness[index],
        )


def by_score(score: np.ndarray, *first: np.ndarray) -> np.ndarray:
    """Orders by score, the highest first; what is equal keeps its order.

    Scores that differ by rounding are equal: which of them is higher would
    depend on the processor.

    Args:
        score: (n,) array.
        *first: (n,) keys that decide before the score does, lowest first.

    Returns:
        (n,) indices.
    """
    return np.lexsort((-np.round(score, _DIGITS), *first[::-1]))


def quality_ranks(quality: np.ndarray) -> np.ndarray:
    """Returns the (n,) ranks of qualities, 0 for the highest.

    The highest, and all that are equal to it (``EQUAL_QUALITY``), are of one
    rank, and so on from the highest of what is left. Which of two equal grasps
    is taken is not to depend on the last digit of a reading.

    Args:
        quality: (n,) array.
    """
    ranks = np.zeros(len(quality), int)
    rank, highest = 0, np.inf
    for i in np.argsort(-quality, kind="stable"):
        if quality[i] < highest - EQUAL_QUALITY:
            rank, highest = rank + np.isfinite(highest), quality[i]
        ranks[i] = rank
    return ranks


def in_groups(score: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Orders by score, but the best of each group before all second bests.

    Args:
        score: (n,) array.
        group: (n,) array of ints.

    Returns:
        (n,) indices.
    """
    if len(score) == 0:
        return np.zeros(0, int)
    order = by_score(score, group)
    starts = np.flatnonzero(np.r_[True, group[order][1:] != group[order][:-1]])
    sizes = np.diff(np.r_[starts, len(order)])
    rank = np.arange(len(order)) - np.repeat(starts, sizes)
    return order[by_score(score[order], rank)]


def same_grasp(
    grasp: Grasp,
    kind: GraspKind,
    X_OG: np.ndarray,
    *,
    position: float,
    angle: float,
) -> bool:
    """Says whether a pose on the same object is a grasp again.

    A jaw turned by half a turn about its approach is the same jaw, and a cup
    turned about its axis is the same cup.

    Args:
        grasp: to compare with.
        kind: of the other grasp.
        X_OG: 4×4 pose of the other grasp in the object's frame.
        position: tolerance, m.
        angle: tolerance, rad.
    """
    if grasp.kind is not kind:
        return False
    if np.linalg.norm(grasp.X_OG[:3, 3] - X_OG[:3, 3]) >= position:
        return False
    R = grasp.X_OG[:3, :3].T @ X_OG[:3, :3]
    if kind is GraspKind.SUCTION:
        return bool(R[2, 2] > np.cos(angle))
    if R[1, 1] < 0:
        R = np.diag([-1.0, -1.0, 1.0]) @ R
    return bool(0.5 * (np.trace(R) - 1.0) > np.cos(angle))


def is_among(
    grasps: Iterable[Grasp],
    kind: GraspKind,
    X_OG: np.ndarray,
    *,
    position: float,
    angle: float,
) -> bool:
    """Says whether any of the grasps is this one; see :func:`same_grasp`."""
    return any(
        same_grasp(grasp, kind, X_OG, position=position, angle=angle)
        for grasp in grasps
    )


def _steepness(approach: np.ndarray, max_tilt: float) -> np.ndarray:
    """0 at the largest tilt allowed, 1 straight down, negative beyond."""
    limit = np.cos(max_tilt)
    return (-approach[..., 2] - limit) / (1.0 - limit)


def _groups(columns: Sequence[np.ndarray]) -> np.ndarray:
    cells = np.column_stack(columns)
    if len(cells) == 0:
        return np.zeros(0, int)
    return np.unique(cells, axis=0, return_inverse=True)[1].reshape(-1)


def jaw_candidates(
    model: ObjectModel,
    pairs: AntipodalPairs,
    X_WO: np.ndarray,
    judge: GraspJudge,
    *,
    friction: float,
    max_tilt: float,
    insertion: float,
) -> GraspCandidates:
    """Approaches antipodal pairs from above.

    Each pair is approached by the steepest direction across its axis and by
    others about the axis, with the jaw either way round. The jaw stops above
    the floor.

    Args:
        model: of the object.
        pairs: on it.
        X_WO: 4×4 pose of the object.
        judge: knows the gripper, and where the floor stops it.
        friction: Coulomb coefficient.
        max_tilt: largest angle between approach and straight down, rad.
        insertion: how far beyond the contacts the jaw goes, m.
    """
    R, p = X_WO[:3, :3], X_WO[:3, 3]
    across = DOWN - (pairs.axis @ (R.T @ DOWN))[:, None] * (pairs.axis @ R.T)
    length = np.linalg.norm(across, axis=1)
    usable = length > 0.1
    axis = pairs.axis[usable] @ R.T
    middle = pairs.middle[usable] @ R.T + p
    steepest = across[usable] / length[usable, None]
    sideways = np.cross(axis, steepest)

    # Axes (tilt, side, pair), then flat.
    approach = (
        np.cos(JAW_TILTS)[:, None, None] * steepest
        + np.sin(JAW_TILTS)[:, None, None] * sideways
    )
    sides = np.array([1.0, -1.0])
    shape = (len(JAW_TILTS), len(sides), len(axis), 3)
    z = np.broadcast_to(approach[:, None], shape).reshape(-1, 3)
    y = np.broadcast_to(sides[:, None, None] * axis, shape).reshape(-1, 3)
    pair = np.tile(np.arange(len(axis)), len(JAW_TILTS) * len(sides))
    way = np.repeat(np.arange(len(JAW_TILTS) * len(sides)), len(axis))
    width = pairs.width[usable][pair]

    X_WG = np.tile(np.eye(4), (len(z), 1, 1))
    X_WG[:, :3, :3] = np.stack([np.cross(y, z), y, z], axis=-1)
    X_WG[:, :3, 3] = middle[pair] + insertion * z
    retreat = judge.floor_retreat(X_WG, judge.opening(width))
    stop = np.where(np.isfinite(retreat), np.maximum(retreat, 0.0), 0.0)
    X_WG[:, :3, 3] -= stop[:, None] * z

    com = R @ model.p_OCom + p
    lever = np.linalg.norm((middle - com)[:, :2], axis=1)[pair]
    steepness = _steepness(z, max_tilt)
    alignment = 1 - pairs.angle[usable][pair] / np.arctan(max(friction, 1e-6))
    parameters = judge.parameters
    slack = np.clip(
        (parameters.opening - width) / (2 * judge.config.clearance), 0.0, 1.0
    )
    score = (
        (0.5 + 0.5 * alignment)
        * (0.5 + 0.5 * steepness)
        * (0.5 + 0.5 * slack)
        / (1 + (lever / _LEVER) ** 2)
    )
    # No jaw holds more than two friction cones' edges.
    holdable = 2 * parameters.force * np.sqrt(1 + friction**2)
    keep = (
        (steepness >= 0)
        & (retreat <= judge.config.max_retreat)
        & (GRAVITY * model.mass < holdable)
    )
    place = np.round(pairs.middle[usable][pair][keep] / _CELL)
    direction = np.round(2 * pairs.axis[usable][pair][keep])
    return GraspCandidates(
        kind=GraspKind.JAW,
        X_WG=X_WG[keep],
        width=width[keep],
        score=score[keep],
        group=_groups([place, direction, way[keep]]),
        robustness=np.ones(np.count_nonzero(keep)),
    )


def suction_candidates(
    model: ObjectModel,
    points: SuctionPoints,
    X_WO: np.ndarray,
    *,
    parameters: GripperParameters,
    friction: float,
    max_tilt: float,
    seal_tolerance: float,
    turns: int,
) -> GraspCandidates:
    """Approaches places where the cup seals, turned about its axis.

    Those that cannot hold the weight (``suction_holding_force``) are dropped.

    Args:
        model: of the object.
        points: on it.
        X_WO: 4×4 pose of the object.
        parameters: of the gripper.
        friction: Coulomb coefficient.
        max_tilt: largest angle between approach and straight down, rad.
        seal_tolerance: unevenness at which the cup just seals, m.
        turns: of the gripper about the cup's axis.
    """
    R, p = X_WO[:3, :3], X_WO[:3, 3]
    steepness = _steepness(points.approach @ R.T, max_tilt)
    usable = np.flatnonzero(steepness >= 0)
    point = np.tile(usable, turns)
    turn = np.repeat(np.arange(turns), len(usable))

    z = points.approach[point] @ R.T
    reference = np.eye(3)[np.where(np.abs(z[:, 0]) < 0.9, 0, 1)]
    x = reference - np.einsum("ni,ni->n", reference, z)[:, None] * z
    x = x / np.linalg.norm(x, axis=1, keepdims=True)
    angle = (2 * np.pi * turn / turns)[:, None]
    x = np.cos(angle) * x + np.sin(angle) * np.cross(z, x)
    X_WG = np.tile(np.eye(4), (len(z), 1, 1))
    X_WG[:, :3, :3] = np.stack([x, np.cross(z, x), z], axis=-1)
    X_WG[:, :3, 3] = points.point[point] @ R.T + p

    lever = R @ model.p_OCom + p - X_WG[:, :3, 3]
    holding = suction_holding_force(
        np.einsum("nji,nj->ni", X_WG[:, :3, :3], lever),
        np.einsum("nji,j->ni", X_WG[:, :3, :3], DOWN),
        friction=friction,
        vacuum_force=parameters.vacuum_force,
        cup_radius=parameters.cup_radius,
        elasticity=parameters.cup_elasticity,
    )
    held = 1 - GRAVITY * model.mass / holding
    evenness = 1 - points.unevenness[point] / seal_tolerance
    robustness = np.where(points.roomy[point], 1.0, _NOT_ROOMY)
    distance = np.linalg.norm(lever[:, :2], axis=1)
    score = (
        held
        * robustness
        * (0.5 + 0.5 * evenness)
        * (0.5 + 0.5 * steepness[point])
        / (1 + (distance / _LEVER) ** 2)
    )
    keep = held > 0
    place = np.round(points.point[point][keep] / _CELL)
    return GraspCandidates(
        kind=GraspKind.SUCTION,
        X_WG=X_WG[keep],
        width=np.zeros(np.count_nonzero(keep)),
        score=score[keep],
        group=_groups([place, turn[keep]]),
        robustness=robustness[keep],
    )
