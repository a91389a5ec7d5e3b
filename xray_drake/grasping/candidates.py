"""Candidates for grasps: poses of the gripper, ranked cheaply."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np

from xray_drake.grasping.judgement import DOWN, TOO_WEAK, GripperModel
from xray_drake.messages import Grasp, GraspKind, Rejection

JAW_TILTS = np.deg2rad([0.0, -20.0, 20.0, -40.0, 40.0])
"""Approaches of the jaw about its closing axis, from the steepest one, rad."""

_LEVER = 0.03
"""Horizontal distance from the centre of mass that halves a score, m."""

_NOT_ROOMY = 0.6
"""Robustness of a cup so near an edge that a wider one would not seal."""

EQUAL_QUALITY = 1e-3
"""Qualities that differ by no more are equal."""

_DIGITS = 4
"""Scores are compared after so many decimals."""


class Failures(Counter[tuple[GraspKind, str]]):
    """Kind of grasp and reason, to the number of candidates that failed for it.

    Those too weak are one reason, told of the strongest.
    """

    def __init__(
        self, counts: Mapping[tuple[GraspKind, str], int] | None = None
    ) -> None:
        """Counts none, or begins with those given."""
        super().__init__(counts or {})
        self._strongest: dict[GraspKind, tuple[float, float]] = {}

    def count_weak(
        self, kind: GraspKind, holding: float, weight: float, number: int = 1
    ) -> None:
        """Counts candidates that hold less than the weight, at most so much.

        Args:
            kind: of the candidates.
            holding: the most that one of them holds, N.
            weight: of the object, N.
            number: of the candidates.
        """
        self[kind, TOO_WEAK] += number
        before = self._strongest.get(kind, (holding, weight))
        self._strongest[kind] = max(before, (holding, weight))

    def rejections(self) -> tuple[Rejection, ...]:
        """Returns why candidates failed; the commonest reasons first."""
        told = []
        for (kind, reason), number in self.items():
            if reason == TOO_WEAK:
                holding, weight = self._strongest[kind]
                reason = f"{TOO_WEAK}{holding:.2f} of {weight:.2f} N"
            if number:
                told.append(Rejection(kind, reason, number))
        return tuple(sorted(told, key=lambda r: (r.kind.value, -r.candidates)))


@dataclass(frozen=True, eq=False)
class Rows:
    """Things of one sort, a row of each array for each of them."""

    def take(self, index: np.ndarray | slice) -> Self:
        """Returns some of them, by indices, slice or (n,) bool mask."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        rows: dict = {
            name: value[index]
            for name, value in values.items()
            if isinstance(value, np.ndarray)
        }
        return replace(self, **rows)

    def __len__(self) -> int:
        values = (getattr(self, f.name) for f in fields(self))
        return next(len(v) for v in values if isinstance(v, np.ndarray))


@dataclass(frozen=True, eq=False)
class AntipodalPairs(Rows):
    """Pairs of points that two opposite fingers can squeeze.

    Attributes:
        first: (n, 3) contact of the finger on the +axis side, m.
        second: (n, 3) contact of the opposite finger, m.
        axis: (n, 3) unit closing axis, from ``second`` towards ``first``.
        width: (n,) distance of the contacts along the axis, m.
        angle: (n,) the larger of the two angles between the axis and a surface
            normal, rad.
        cell: (n, k) ints, the same for pairs that are alike.
    """

    first: np.ndarray
    second: np.ndarray
    axis: np.ndarray
    width: np.ndarray
    angle: np.ndarray
    cell: np.ndarray

    @property
    def middle(self) -> np.ndarray:
        """The (n, 3) midpoints, m."""
        return 0.5 * (self.first + self.second)


@dataclass(frozen=True, eq=False)
class SuctionPoints(Rows):
    """Places where a suction cup seals.

    Attributes:
        point: (n, 3) centre of the lip on the surface, m.
        approach: (n, 3) unit normal of the lip's plane, into the object.
        unevenness: (n,) largest distance of the surface under the lip from
            that plane, m.
        roomy: (n,) whether a larger cup would seal there, too.
        cell: (n, k) ints, the same for places that are alike.
    """

    point: np.ndarray
    approach: np.ndarray
    unevenness: np.ndarray
    roomy: np.ndarray
    cell: np.ndarray


@dataclass(frozen=True, eq=False)
class GraspCandidates(Rows):
    """Poses to check, of one kind.

    Attributes:
        kind: jaw or suction.
        X_WG: (n, 4, 4) poses of the grasp frame in the world, m.
        width: (n,) distance of the contacts, m; 0 for suction.
        score: (n,) in [0, 1], more is better.
        group: (n,) of alike candidates: near each other on the object, and
            approached in the same way.
        robustness: (n,) factor of the grasp's quality, in (0, 1].
        space: (n,) free around the gripper, m; inf where it is not known yet.
        stopped: the poses are where the gripper stops at contact.
    """

    kind: GraspKind
    X_WG: np.ndarray
    width: np.ndarray
    score: np.ndarray
    group: np.ndarray
    robustness: np.ndarray
    space: np.ndarray
    stopped: bool = False

    @classmethod
    def none(cls, kind: GraspKind) -> Self:
        """Returns no candidates."""
        none = np.zeros(0)
        return cls(
            kind=kind,
            X_WG=np.zeros((0, 4, 4)),
            width=none,
            score=none,
            group=np.zeros(0, dtype=int),
            robustness=none,
            space=none,
        )

    def quality_factor(self, full: float) -> np.ndarray:
        """Returns (n,) factors in (0, 1] of quality: robustness and space.

        Args:
            full: more free space than this is worth no more, m.
        """
        share = np.clip(self.space / full, 0.0, 1.0)
        return self.robustness * (0.5 + 0.5 * share)


def moved(X: np.ndarray, distance: np.ndarray | float) -> np.ndarray:
    """Returns (n, 4, 4) poses moved along their own z axes by (n,) m."""
    X = np.array(X)
    X[:, :3, 3] += np.reshape(distance, (-1, 1)) * X[:, :3, 2]
    return X


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


def is_among(
    grasps: Iterable[Grasp],
    kind: GraspKind,
    X_OG: np.ndarray,
    *,
    position: float,
    angle: float,
) -> bool:
    """Says whether a pose on the same object is one of some grasps again.

    A jaw turned by half a turn about its approach is the same jaw, and a cup
    turned about its axis is the same cup.

    Args:
        grasps: to compare with.
        kind: of the other grasp.
        X_OG: 4×4 pose of the other grasp in the object's frame.
        position: tolerance, m.
        angle: tolerance, rad.
    """

    def same(grasp: Grasp) -> bool:
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

    return any(same(grasp) for grasp in grasps)


def _steepness(approach: np.ndarray, max_tilt: float) -> np.ndarray:
    """0 at the largest tilt allowed, 1 straight down, negative beyond."""
    limit = np.cos(max_tilt)
    return (-approach[..., 2] - limit) / (1.0 - limit)


def _nearness(points: np.ndarray, center: np.ndarray) -> np.ndarray:
    """1 over or under the centre, ½ at ``_LEVER`` from there."""
    lever = np.linalg.norm((points - center)[:, :2], axis=1)
    return 1 / (1 + (lever / _LEVER) ** 2)


def _groups(cell: np.ndarray, way: np.ndarray) -> np.ndarray:
    if len(way) == 0:
        return np.zeros(0, int)
    cells = np.column_stack([cell, way])
    return np.unique(cells, axis=0, return_inverse=True)[1].reshape(-1)


def _count_tilted(
    failures: Failures, kind: GraspKind, steep: np.ndarray
) -> None:
    failures[kind, "approach too tilted"] += int(np.count_nonzero(~steep))


def jaw_poses(
    pairs: AntipodalPairs,
    center: np.ndarray,
    gripper: GripperModel,
    failures: Failures,
    *,
    friction: float,
    max_tilt: float,
) -> tuple[GraspCandidates, np.ndarray]:
    """Approaches antipodal pairs from above.

    Each pair is approached by the steepest direction across its axis and by
    others about the axis, with the jaw either way round.

    Args:
        pairs: in the world.
        center: (3,) the object's centre of mass in the world, m.
        gripper: what it can do.
        failures: those too tilted are counted here.
        friction: Coulomb coefficient.
        max_tilt: largest angle between approach and straight down, rad.

    Returns:
        The candidates, their origins in the middle of the pairs; and (n,) the
        index of each one's pair.
    """
    across = DOWN - (pairs.axis @ DOWN)[:, None] * pairs.axis
    length = np.linalg.norm(across, axis=1)
    usable = np.flatnonzero(length > 0.1)
    axis = pairs.axis[usable]
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
    pair = np.tile(usable, len(JAW_TILTS) * len(sides))
    way = np.repeat(np.arange(len(JAW_TILTS) * len(sides)), len(axis))

    X_WG = np.tile(np.eye(4), (len(z), 1, 1))
    X_WG[:, :3, :3] = np.stack([np.cross(y, z), y, z], axis=-1)
    X_WG[:, :3, 3] = pairs.middle[pair]
    width = pairs.width[pair]
    steepness = _steepness(z, max_tilt)
    alignment = 1 - pairs.angle[pair] / np.arctan(max(friction, 1e-6))
    slack = np.clip(
        (gripper.spec.opening - width) / (2 * gripper.config.clearance),
        0.0,
        1.0,
    )
    candidates = GraspCandidates(
        kind=GraspKind.JAW,
        X_WG=X_WG,
        width=width,
        score=(0.5 + 0.5 * alignment)
        * (0.5 + 0.5 * steepness)
        * (0.5 + 0.5 * slack)
        * _nearness(pairs.middle, center)[pair],
        group=_groups(pairs.cell[pair], way),
        robustness=np.ones(len(z)),
        space=np.full(len(z), np.inf),
    )
    steep = steepness >= 0
    _count_tilted(failures, GraspKind.JAW, steep)
    return candidates.take(steep), pair[steep]


def cup_poses(
    points: SuctionPoints,
    center: np.ndarray,
    gripper: GripperModel,
    failures: Failures,
    *,
    max_tilt: float,
    turns: int,
    ahead: np.ndarray | None = None,
) -> GraspCandidates:
    """Approaches places where the cup seals, turned about its axis.

    All places come in one turn, then in the next.

    Args:
        points: in the world.
        center: (3,) the object's centre of mass in the world, m.
        gripper: what it can do.
        failures: those too tilted are counted here.
        max_tilt: largest angle between approach and straight down, rad.
        turns: of the gripper about the cup's axis.
        ahead: (3,) the direction that turns are counted from, in the world; by
            default the world's x axis, or y where the cup comes along x.
    """
    steepness = _steepness(points.approach, max_tilt)
    usable = np.flatnonzero(steepness >= 0)
    _count_tilted(failures, GraspKind.SUCTION, steepness >= 0)
    place = np.tile(usable, turns)
    turn = np.repeat(np.arange(turns), len(usable))
    z = points.approach[place]
    if ahead is None:
        x = np.eye(3)[np.where(np.abs(z[:, 0]) < 0.9, 0, 1)]
    else:
        x = np.broadcast_to(ahead, z.shape)
    x = x - np.einsum("ni,ni->n", x, z)[:, None] * z
    x = x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-9)
    angle = (2 * np.pi * turn / turns)[:, None]
    x = np.cos(angle) * x + np.sin(angle) * np.cross(z, x)
    X_WG = np.tile(np.eye(4), (len(z), 1, 1))
    X_WG[:, :3, :3] = np.stack([x, np.cross(z, x), z], axis=-1)
    X_WG[:, :3, 3] = points.point[place]
    robustness = np.where(points.roomy, 1.0, _NOT_ROOMY)
    evenness = 1 - points.unevenness / gripper.config.seal_tolerance
    score = (
        robustness
        * (0.5 + 0.5 * evenness)
        * (0.5 + 0.5 * steepness)
        * _nearness(points.point, center)
    )
    return GraspCandidates(
        kind=GraspKind.SUCTION,
        X_WG=X_WG,
        width=np.zeros(len(place)),
        score=score[place],
        group=_groups(points.cell[place], turn),
        robustness=robustness[place],
        space=np.full(len(place), np.inf),
    )
