"""Plans a grasp on an object of a heap whose shapes and poses are known."""

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from xray_drake.grasping.clearance import clearance
from xray_drake.grasping.gripper_geometry import GripperParameters
from xray_drake.grasping.judgement import (
    GRAVITY,
    GraspJudge,
    JudgedGrasp,
    JudgementConfig,
)
from xray_drake.grasping.sampling import (
    AntipodalPairs,
    SuctionPoints,
    sample_antipodal,
    sample_suction,
    surface_points,
)
from xray_drake.grasping.wrench import suction_holding_force
from xray_drake.messages import Grasp, GraspKind
from xray_drake.scene.object_model import ObjectModel

_CHUNK = 96
"""Candidates whose clearance is estimated at once."""

_COARSE = 8
"""The first estimate of clearance takes one point in so many."""

_POINT_TOLERANCE = 0.0015
"""Surface points may be this deep in the gripper without excluding a pose, m:
collision pieces only approximate the surface."""


class GraspPlanner(Protocol):
    """Anything that plans a grasp on one object of a heap."""

    def plan(
        self,
        object_name: str,
        poses: Mapping[str, np.ndarray],
        *,
        excluded: Sequence[Grasp] = (),
    ) -> Grasp:
        """Returns the best grasp found; of kind NONE if there is none."""


@dataclass
class GraspPlannerConfig:
    """How grasps are looked for."""

    # Surface points drawn per object for the jaw and for the cup.
    jaw_samples: int = 400
    suction_samples: int = 150
    # Free space that must be left beside the widest object, m.
    min_clearance: float = 0.0025
    # How far beyond the contacts the jaw is commanded, m: the middle of the
    # pads then meets the contacts, where nothing stops it earlier.
    insertion: float = 0.002
    # Largest angle between approach and straight down, rad.
    max_tilt: float = 1.05
    # Turns of the cup about its axis that are tried.
    suction_turns: int = 8
    # Points on each object's surface, for the cheap check of clearance.
    surface_points: int = 150
    # Candidates whose clearance is estimated, and those of them that are
    # judged, at most.
    max_candidates: int = 800
    max_checks: int = 60
    # A grasp with this much free space around the gripper loses nothing, m.
    full_clearance: float = 0.005
    # The search ends when this many grasps that hold have been found, …
    enough: int = 5
    # … or one of this quality.
    good_enough: float = 0.85
    # An excluded grasp excludes those this near, m and rad.
    same_position: float = 0.005
    same_angle: float = 0.175
    # How execution is judged.
    judgement: JudgementConfig = field(default_factory=JudgementConfig)


@dataclass(frozen=True, eq=False)
class _Candidates:
    """Poses to check: (n, 4, 4) X_WG; (n,) width, score and group."""

    kind: GraspKind
    X_WG: np.ndarray
    width: np.ndarray
    score: np.ndarray
    group: np.ndarray

    def take(self, index: np.ndarray) -> "_Candidates":
        return _Candidates(
            self.kind,
            self.X_WG[index],
            self.width[index],
            self.score[index],
            self.group[index],
        )


@dataclass(frozen=True, eq=False)
class _Candidate:
    """One of them that may be free, and how much space it has, in [½, 1]."""

    kind: GraspKind
    X_WG: np.ndarray
    width: float
    score: float
    robustness: float


def _rotation(axes: Sequence[np.ndarray]) -> np.ndarray:
    return np.stack(axes, axis=-1)


def _in_groups(score: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Orders by score, but the best of each group before all second bests."""
    order = np.lexsort((-score, group))
    first = np.r_[True, group[order][1:] != group[order][:-1]]
    starts = np.flatnonzero(first)
    rank = np.arange(len(order)) - np.repeat(
        starts, np.diff(np.r_[starts, len(order)])
    )
    return order[np.lexsort((-score[order], rank))]


class ModelGraspPlanner:
    """Plans from the objects' models: what the literature calls analytic.

    Candidates (antipodal pairs, places where the cup seals) are sampled once
    per object and cached. A plan ranks them cheaply, by upper bounds of what
    they can hold, by how near the centre of mass they are and how steep the
    approach is; then it judges them in this order, as ``GraspJudge`` does, and
    returns the best of the first few that hold. In between, a cloud of points
    on all surfaces tells which candidates cannot be free and how much space the
    others have; quality and rank suffer where there is little of it.

    The result depends on the seed, on the object's name and pose, and on the
    heap, not on what was planned before.
    """

    def __init__(
        self,
        objects: Sequence[ObjectModel],
        *,
        parameters: GripperParameters | None = None,
        config: GraspPlannerConfig | None = None,
        seed: int = 0,
    ) -> None:
        """Builds the collision scene; samples are drawn when first needed.

        Args:
            objects: all that can be in the heap.
            parameters: of the gripper.
            config: of the search.
            seed: of the samples.
        """
        self.parameters = parameters or GripperParameters()
        self.config = config or GraspPlannerConfig()
        self._judge = GraspJudge(
            objects,
            parameters=self.parameters,
            config=self.config.judgement,
        )
        self._objects = {model.name: model for model in objects}
        self._seed = seed
        self._surfaces: dict[str, np.ndarray] = {}
        self._samples: dict[str, tuple[AntipodalPairs, SuctionPoints]] = {}

    def friction(self, name: str) -> float:
        """Returns the coefficient between gripper and object.

        Combined as Drake does: 2 μ₁ μ₂ / (μ₁ + μ₂).
        """
        a, b = self.parameters.friction, self._objects[name].friction
        return 2 * a * b / (a + b) if a + b > 0 else 0.0

    def samples(self, name: str) -> tuple[AntipodalPairs, SuctionPoints]:
        """Returns the grasp candidates of an object in its body frame."""
        if name not in self._samples:
            model, config = self._objects[name], self.config
            rng = np.random.default_rng([self._seed, zlib.crc32(name.encode())])
            pairs = sample_antipodal(
                model.visual,
                rng,
                count=config.jaw_samples,
                friction=self.friction(name),
                max_width=self.parameters.opening - 2 * config.min_clearance,
            )
            points = sample_suction(
                model.visual,
                rng,
                count=config.suction_samples,
                radius=self.parameters.cup_radius,
                tolerance=config.judgement.seal_tolerance,
                max_normal_angle=config.judgement.seal_angle,
            )
            self._samples[name] = pairs, points
        return self._samples[name]

    def plan(
        self,
        object_name: str,
        poses: Mapping[str, np.ndarray],
        *,
        excluded: Sequence[Grasp] = (),
    ) -> Grasp:
        """Plans a grasp.

        Args:
            object_name: of the object to grasp.
            poses: 4×4 X_WO of every object in the bin.
            excluded: grasps not to be returned again, nor any like them.

        Returns:
            The grasp; its pose is where the gripper is expected to stop. Its
            kind is NONE if nothing was found.

        Raises:
            KeyError: an object without a model or without a pose.
        """
        X_WO = np.asarray(poses[object_name], dtype=float)
        X_OW = np.linalg.inv(X_WO)
        self._judge.scene.set_poses(poses)
        points = self._points_around(object_name, poses)
        both = (
            self._jaw_candidates(object_name, X_WO),
            self._suction_candidates(object_name, X_WO),
        )
        groups = 1 + both[0].group.max(initial=0)
        order = _in_groups(
            np.concatenate([c.score for c in both]),
            np.concatenate([both[0].group, groups + both[1].group]),
        )[: self.config.max_candidates]
        size = len(both[0].score)

        best, found, checked = Grasp(), 0, 0
        for start in range(0, len(order), _CHUNK):
            part = order[start : start + _CHUNK]
            queue = [
                *self._with_clearance(both[0].take(part[part < size]), points),
                *self._with_clearance(
                    both[1].take(part[part >= size] - size), points
                ),
            ]
            queue.sort(key=lambda c: -c.score)
            for candidate in queue:
                if checked >= self.config.max_checks:
                    return best
                kind, X_WG = candidate.kind, candidate.X_WG
                if self._is_excluded(kind, X_OW @ X_WG, excluded):
                    continue
                checked += 1
                judged = self._judge_one(
                    kind,
                    object_name,
                    poses,
                    X_WG,
                    candidate.width,
                    self.friction(object_name),
                )
                quality = judged.quality * candidate.robustness
                X_OG = X_OW @ judged.X_WG
                if quality == 0.0 or self._is_excluded(kind, X_OG, excluded):
                    continue
                found += 1
                if quality > best.quality:
                    best = Grasp(
                        kind=kind,
                        object=object_name,
                        X_WG=judged.X_WG,
                        X_OG=X_OG,
                        width=judged.width,
                        quality=quality,
                    )
                if (
                    found >= self.config.enough
                    or best.quality >= self.config.good_enough
                ):
                    return best
        return best

    def _with_clearance(
        self, candidates: _Candidates, points: np.ndarray
    ) -> list[_Candidate]:
        """Drops those that cannot be free, scores the others by their space."""
        for stride in (_COARSE, 1):
            space = self._clearance(candidates, points[::stride])
            free = space > -_POINT_TOLERANCE
            candidates, space = candidates.take(free), space[free]
        robustness = 0.5 + 0.5 * np.clip(
            space / self.config.full_clearance, 0.0, 1.0
        )
        return [
            _Candidate(
                candidates.kind,
                candidates.X_WG[i],
                float(candidates.width[i]),
                float(candidates.score[i] * robustness[i]),
                float(robustness[i]),
            )
            for i in range(len(space))
        ]

    def _points_around(
        self, name: str, poses: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Returns (m, 3) surface points that the gripper could meet, m."""
        clouds = [self._judge.scene.bin_points]
        for other, X_WO in poses.items():
            cloud = self._surface(other)
            clouds.append(cloud @ X_WO[:3, :3].T + X_WO[:3, 3])
        points = np.concatenate(clouds)
        middle = poses[name][:3, 3]
        size = 0.5 * float(np.linalg.norm(self._objects[name].extents))
        near = np.linalg.norm(points[:, :2] - middle[:2], axis=1) < size + 0.17
        return points[near & (points[:, 2] > 0.001)]

    def _surface(self, name: str) -> np.ndarray:
        if name not in self._surfaces:
            rng = np.random.default_rng([self._seed, zlib.crc32(name.encode())])
            self._surfaces[name], _ = surface_points(
                self._objects[name].visual, self.config.surface_points, rng
            )
        return self._surfaces[name]

    def _clearance(
        self, candidates: _Candidates, points: np.ndarray
    ) -> np.ndarray:
        """Returns the (n,) free space around the gripper where it may stop."""
        gripper, config = self._judge.gripper, self.config.judgement
        X_WG = np.array(candidates.X_WG)
        if candidates.kind is GraspKind.JAW:
            X_BG, back = gripper.X_BJ, config.max_retreat
            lower, upper = gripper.swept_jaw(config.approach_distance)
            opening = self._judge.opening(candidates.width)
            shift = gripper.closing_shift(opening)
            lower, upper = lower + shift, upper + shift
            round_ = np.zeros(len(gripper.round), bool)
        else:
            X_BG, back = gripper.X_BC, self.parameters.bellows_travel
            lower, upper = gripper.swept_suction(
                config.approach_distance, config.cup_standoff
            )
            round_ = gripper.round
        X_WG[:, :3, 3] -= back * X_WG[:, :3, 2]
        return clearance(
            points, X_WG @ np.linalg.inv(X_BG), lower, upper, round_
        )

    def judge(
        self,
        grasp: Grasp,
        poses: Mapping[str, np.ndarray],
        *,
        X_WG_perturbed: np.ndarray,
        friction: float,
    ) -> JudgedGrasp:
        """Judges a grasp as it is executed rather than as it was planned.

        Args:
            grasp: as planned.
            poses: 4×4 X_WO of every object in the bin.
            X_WG_perturbed: 4×4 pose that the gripper really is commanded to.
            friction: Coulomb coefficient that it really meets.

        Raises:
            ValueError: the grasp is of kind NONE.
            KeyError: an object without a model or without a pose.
        """
        if not grasp:
            raise ValueError("there is no grasp to judge")
        self._judge.scene.set_poses(poses)
        return self._judge_one(
            grasp.kind,
            grasp.object,
            poses,
            np.asarray(X_WG_perturbed, dtype=float),
            grasp.width,
            friction,
            self.config.judgement.overtravel,
        )

    def _judge_one(
        self,
        kind: GraspKind,
        name: str,
        poses: Mapping[str, np.ndarray],
        X_WG: np.ndarray,
        width: float,
        friction: float,
        overtravel: float = 0.0,
    ) -> JudgedGrasp:
        if kind is GraspKind.JAW:
            return self._judge.jaw(
                name,
                poses,
                X_WG,
                opening=float(self._judge.opening(np.asarray(width))),
                friction=friction,
                overtravel=overtravel,
            )
        return self._judge.suction(
            name, poses, X_WG, friction=friction, overtravel=overtravel
        )

    def _is_excluded(
        self, kind: GraspKind, X_OG: np.ndarray, excluded: Sequence[Grasp]
    ) -> bool:
        """A jaw turned by half a turn about its approach is the same jaw."""
        for grasp in excluded:
            if grasp.kind is not kind:
                continue
            distance = np.linalg.norm(grasp.X_OG[:3, 3] - X_OG[:3, 3])
            R = grasp.X_OG[:3, :3].T @ X_OG[:3, :3]
            if kind is GraspKind.JAW and R[1, 1] < 0:
                R = np.diag([-1.0, -1.0, 1.0]) @ R
            cosine = (
                R[2, 2]
                if kind is GraspKind.SUCTION
                else (0.5 * (np.trace(R) - 1))
            )
            if distance < self.config.same_position and cosine > np.cos(
                self.config.same_angle
            ):
                return True
        return False

    def _steepness(self, approach: np.ndarray) -> np.ndarray:
        """0 at the largest tilt allowed, 1 straight down, negative beyond."""
        limit = np.cos(self.config.max_tilt)
        return (-approach[..., 2] - limit) / (1 - limit)

    def _jaw_candidates(self, name: str, X_WO: np.ndarray) -> _Candidates:
        model = self._objects[name]
        pairs, _ = self.samples(name)
        R, p = X_WO[:3, :3], X_WO[:3, 3]
        middle, axis = pairs.middle @ R.T + p, pairs.axis @ R.T
        across = np.array([0.0, 0.0, -1.0]) + axis[:, 2:] * axis
        norm = np.linalg.norm(across, axis=1)
        usable = norm > 0.1
        middle, axis = middle[usable], axis[usable]
        steepest = across[usable] / norm[usable, None]
        sideways = np.cross(axis, steepest)

        # (tilt, flip, pair) → flat
        tilt = np.deg2rad([0.0, -20.0, 20.0, -40.0, 40.0])
        approach = (
            np.cos(tilt)[:, None, None] * steepest
            + np.sin(tilt)[:, None, None] * sideways
        )
        flip = np.array([1.0, -1.0])
        n = len(axis)
        shape = (len(tilt), len(flip), n, 3)
        z = np.broadcast_to(approach[:, None], shape).reshape(-1, 3)
        y = np.broadcast_to(flip[:, None, None] * axis, shape).reshape(-1, 3)
        X_WG = np.tile(np.eye(4), (len(z), 1, 1))
        X_WG[:, :3, :3] = _rotation([np.cross(y, z), y, z])
        pair = np.tile(np.arange(n), len(tilt) * len(flip))
        X_WG[:, :3, 3] = middle[pair] + self.config.insertion * z
        width = pairs.width[usable][pair]

        opening = self._judge.opening(width)
        retreat = self._judge.floor_retreat(X_WG, opening)
        stop = np.where(np.isfinite(retreat), np.maximum(retreat, 0.0), 0.0)
        X_WG[:, :3, 3] -= stop[:, None] * z

        friction = self.friction(name)
        com = R @ model.p_OCom + p
        distance = np.linalg.norm((middle - com)[:, :2], axis=1)[pair]
        steepness = self._steepness(z)
        alignment = 1 - pairs.angle[usable][pair] / np.arctan(friction)
        slack = (self.parameters.opening - width) / (
            2 * self.config.judgement.clearance
        )
        score = (
            (0.5 + 0.5 * alignment)
            * (0.5 + 0.5 * steepness)
            * (0.5 + 0.5 * np.clip(slack, 0, 1))
            / (1 + (distance / 0.03) ** 2)
        )
        holdable = 2 * self.parameters.force * np.sqrt(1 + friction**2)
        keep = (
            (steepness >= 0)
            & (retreat <= self.config.judgement.max_retreat)
            & (GRAVITY * model.mass < holdable)
        )
        # Neighbours on the object, approached alike, are one group.
        local = (middle - p) @ R
        cells = np.column_stack(
            [
                np.round(local[pair] / 0.01),
                np.round(pairs.axis[usable][pair] / 0.5),
                np.repeat(np.arange(len(tilt) * len(flip)), n),
            ]
        )[keep]
        group = (
            np.unique(cells, axis=0, return_inverse=True)[1].reshape(-1)
            if len(cells)
            else np.zeros(0, int)
        )
        return _Candidates(
            GraspKind.JAW, X_WG[keep], width[keep], score[keep], group
        )

    def _suction_candidates(self, name: str, X_WO: np.ndarray) -> _Candidates:
        model, p = self._objects[name], self.parameters
        _, points = self.samples(name)
        R = X_WO[:3, :3]
        approach = points.approach @ R.T
        center = points.point @ R.T + X_WO[:3, 3]
        steepness = self._steepness(approach)
        usable = steepness >= 0
        approach, center = approach[usable], center[usable]

        # The first turn has the fingers' side (−x) away from the bin's centre.
        turns = self.config.suction_turns
        angle = 2 * np.pi * np.arange(turns) / turns
        reference = np.tile([1.0, 0.0, 0.0], (len(approach), 1))
        x0 = reference - (reference * approach).sum(1)[:, None] * approach
        small = np.linalg.norm(x0, axis=1) < 0.1
        x0[small] = np.cross(approach[small], [0.0, 1.0, 0.0])
        x0 = x0 / np.linalg.norm(x0, axis=1, keepdims=True)
        y0 = np.cross(approach, x0)
        x = (
            np.cos(angle)[:, None, None] * x0
            + np.sin(angle)[:, None, None] * y0
        ).reshape(-1, 3)
        point = np.tile(np.arange(len(approach)), turns)
        z = approach[point]
        X_WG = np.tile(np.eye(4), (len(z), 1, 1))
        X_WG[:, :3, :3] = _rotation([x, np.cross(z, x), z])
        X_WG[:, :3, 3] = center[point]

        com = R @ model.p_OCom + X_WO[:3, 3]
        R_GW = np.swapaxes(X_WG[:, :3, :3], 1, 2)
        lever = np.einsum("nij,nj->ni", R_GW, com - X_WG[:, :3, 3])
        holding = suction_holding_force(
            lever,
            R_GW @ np.array([0.0, 0.0, -1.0]),
            friction=self.friction(name),
            vacuum_force=p.vacuum_force,
            cup_radius=p.cup_radius,
            elasticity=p.cup_elasticity,
        )
        held = 1 - GRAVITY * model.mass / holding
        distance = np.linalg.norm((center - com)[:, :2], axis=1)[point]
        evenness = 1 - points.unevenness[usable] / (
            self.config.judgement.seal_tolerance
        )
        score = (
            held
            * (0.5 + 0.5 * evenness[point])
            * (0.5 + 0.5 * steepness[usable][point])
            / (1 + (distance / 0.03) ** 2)
        )
        keep = held > 0
        cells = np.column_stack(
            [
                np.round(points.point[usable][point] / 0.01),
                np.repeat(np.arange(turns), len(approach)),
            ]
        )[keep]
        group = (
            np.unique(cells, axis=0, return_inverse=True)[1].reshape(-1)
            if len(cells)
            else np.zeros(0, int)
        )
        return _Candidates(
            GraspKind.SUCTION,
            X_WG[keep],
            np.zeros(int(keep.sum())),
            score[keep],
            group,
        )
