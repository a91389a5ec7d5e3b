"""Plans a grasp on an object of a heap whose shapes and poses are known."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from xray_drake.configuration import count, number
from xray_drake.grasping.candidates import (
    EQUAL_QUALITY,
    GraspCandidates,
    by_score,
    in_groups,
    is_among,
    jaw_candidates,
    quality_ranks,
    suction_candidates,
)
from xray_drake.grasping.clearance import clearance
from xray_drake.grasping.gripper_geometry import GripperParameters
from xray_drake.grasping.judgement import (
    GraspJudge,
    JudgedGrasp,
    JudgementConfig,
)
from xray_drake.grasping.perturbation import PerturbationConfig, perturb
from xray_drake.grasping.sampling import (
    AntipodalPairs,
    SuctionPoints,
    sample_antipodal,
    sample_suction,
    surface_points,
)
from xray_drake.messages import Grasp, GraspKind, GraspPlan
from xray_drake.scene.object_model import ObjectModel
from xray_drake.seeding import stream

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
    ) -> GraspPlan:
        """Returns the best grasp found, or why there is none."""


@dataclass
class GraspPlannerConfig:
    """How grasps are looked for."""

    # Surface points drawn per object for the jaw and for the cup.
    jaw_samples: int = count(400, "[1, 100000]")
    suction_samples: int = count(150, "[1, 100000]")
    # Free space that must be left beside the widest object, m.
    min_clearance: float = number(0.0025, "[0, 0.1]")
    # How far beyond the contacts the jaw is commanded, m: the middle of the
    # pads then meets the contacts, where nothing stops it earlier.
    insertion: float = number(0.002, "[0, 0.1]")
    # Largest angle between approach and straight down, rad.
    max_tilt: float = number(1.05, "[0, 1.5708]")
    # Turns of the cup about its axis that are tried.
    suction_turns: int = count(8, "[1, 360]")
    # Points on each object's surface, for the cheap check of clearance; the
    # object to grasp gets four times as many.
    surface_points: int = count(150, "[1, 100000]")
    # Candidates whose clearance is estimated, and those of them that are
    # judged, at most.
    max_candidates: int = count(800, "[1, 1000000]")
    max_checks: int = count(100, "[1, 100000]")
    # A grasp with this much free space around the gripper loses nothing, m.
    full_clearance: float = number(0.008, "(0, 1]")
    # The search ends when this many grasps that hold have been found.
    enough: int = count(10, "[1, 100000]")
    # The best of them are judged again under this many perturbations; the
    # share that holds multiplies their quality. 0 leaves it out.
    rehearsals: int = count(6, "[0, 1000]")
    # How many of them.
    finalists: int = count(4, "[1, 1000]")
    # What a rehearsal perturbs by.
    perturbation: PerturbationConfig = field(default_factory=PerturbationConfig)
    # An excluded grasp excludes those this near, m and rad.
    same_position: float = number(0.005, "[0, 1]")
    same_angle: float = number(0.175, "[0, 3.1416]")
    # How execution is judged.
    judgement: JudgementConfig = field(default_factory=JudgementConfig)


@dataclass(frozen=True, eq=False)
class _Candidate:
    """One of them that may be free, and how robust it is, in (0, 1]."""

    kind: GraspKind
    X_WG: np.ndarray
    width: float
    score: float
    robustness: float


class ModelGraspPlanner:
    """Plans from the objects' models: what the literature calls analytic.

    Candidates (antipodal pairs, places where the cup seals) are sampled once
    per object and cached. A plan ranks them cheaply, by upper bounds of what
    they can hold, by how near the centre of mass they are and how steep the
    approach is; then it judges them in this order, as ``GraspJudge`` does, and
    returns the best of the first few that hold, and of equal ones the first. In
    between, a cloud of points on all surfaces tells which candidates cannot be
    free and how much space the others have; quality and rank suffer where there
    is little of it.

    Quality is 1 − weight / largest weight that can be held, times factors in
    [½, 1] for what it depends on in execution: alignment of the contact normals
    with the closing axis and share of the pad that touches, or evenness under
    the lip and distance from edges; and free space around the gripper.

    The result depends on the seed, on the object's name and pose, and on the
    heap, not on what was planned before. Two threads cannot use one planner at
    the same time.
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
            rng = stream(self._seed, f"samples of {name}")
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
    ) -> GraspPlan:
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
        poses = {name: np.asarray(X, float) for name, X in poses.items()}
        X_WO = poses[object_name]
        X_OW = np.linalg.inv(X_WO)
        self._judge.scene.set_poses(poses)
        points = self._points_around(object_name, poses)
        both = self._candidates(object_name, X_WO)
        groups = 1 + both[0].group.max(initial=0)
        order = in_groups(
            np.concatenate([c.score for c in both]),
            np.concatenate([both[0].group, groups + both[1].group]),
        )[: self.config.max_candidates]
        size = len(both[0])

        found: list[Grasp] = []
        checked = 0
        for start in range(0, len(order), _CHUNK):
            part = order[start : start + _CHUNK]
            queue = [
                *self._with_clearance(both[0].take(part[part < size]), points),
                *self._with_clearance(
                    both[1].take(part[part >= size] - size), points
                ),
            ]
            for i in by_score(np.array([c.score for c in queue])):
                candidate = queue[i]
                if (
                    checked >= self.config.max_checks
                    or len(found) >= self.config.enough
                ):
                    return GraspPlan(self._most_robust(found, poses))
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
                found.append(
                    Grasp(
                        kind=kind,
                        object=object_name,
                        X_WG=judged.X_WG,
                        X_OG=X_OG,
                        width=judged.width,
                        quality=quality,
                    )
                )
        return GraspPlan(self._most_robust(found, poses))

    def _most_robust(
        self, found: list[Grasp], poses: Mapping[str, np.ndarray]
    ) -> Grasp:
        """Rehearses the best grasps and returns the one expected to hold.

        The expectation of quality under perturbation is what Dex-Net 2.0 calls
        robustness (Mahler et al. 2017, section III). All grasps meet the same
        perturbations, none of which is the one of the execution.
        """
        config = self.config
        ranks = quality_ranks(np.array([grasp.quality for grasp in found]))
        found = [found[i] for i in np.argsort(ranks, kind="stable")]
        if not config.rehearsals or not found:
            return found[0] if found else Grasp()
        best = Grasp()
        for grasp in found[: config.finalists]:
            least = best.quality + EQUAL_QUALITY if best else 0.0
            if grasp.quality <= least:
                break
            rng = stream(self._seed, "rehearsal")
            held = 0
            for _ in range(config.rehearsals):
                X_WG, friction = perturb(grasp, rng, config.perturbation)
                judged = self.judge(
                    grasp, poses, X_WG_perturbed=X_WG, friction=friction
                )
                held += judged.quality > 0.0
            # Laplace's rule keeps a grasp that failed every rehearsal: it may
            # be the only one.
            share = (held + 1) / (config.rehearsals + 1)
            if grasp.quality * share > least:
                best = replace(grasp, quality=grasp.quality * share)
        return best

    def _candidates(
        self, name: str, X_WO: np.ndarray
    ) -> tuple[GraspCandidates, GraspCandidates]:
        """Returns those of the jaw and those of the cup."""
        model, config = self._objects[name], self.config
        pairs, points = self.samples(name)
        return (
            jaw_candidates(
                model,
                pairs,
                X_WO,
                self._judge,
                friction=self.friction(name),
                max_tilt=config.max_tilt,
                insertion=config.insertion,
            ),
            suction_candidates(
                model,
                points,
                X_WO,
                parameters=self.parameters,
                friction=self.friction(name),
                max_tilt=config.max_tilt,
                seal_tolerance=config.judgement.seal_tolerance,
                turns=config.suction_turns,
            ),
        )

    def _with_clearance(
        self, candidates: GraspCandidates, points: np.ndarray
    ) -> list[_Candidate]:
        """Drops those that cannot be free, scores the others by their space."""
        for stride in (_COARSE, 1):
            space = self._clearance(candidates, points[::stride])
            free = space > -_POINT_TOLERANCE
            candidates, space = candidates.take(free), space[free]
        robustness = candidates.robustness * (
            0.5 + 0.5 * np.clip(space / self.config.full_clearance, 0.0, 1.0)
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
            if other != name:
                cloud = cloud[: self.config.surface_points]
            clouds.append(cloud @ X_WO[:3, :3].T + X_WO[:3, 3])
        points = np.concatenate(clouds)
        middle = poses[name][:3, 3]
        size = 0.5 * float(np.linalg.norm(self._objects[name].extents))
        near = np.linalg.norm(points[:, :2] - middle[:2], axis=1) < size + 0.17
        return points[near & (points[:, 2] > 0.001)]

    def _surface(self, name: str) -> np.ndarray:
        if name not in self._surfaces:
            rng = stream(self._seed, f"surface of {name}")
            self._surfaces[name], _ = surface_points(
                self._objects[name].visual, 4 * self.config.surface_points, rng
            )
        return self._surfaces[name]

    def _clearance(
        self, candidates: GraspCandidates, points: np.ndarray
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
            grasp: as planned; of an object without a name, nothing is lifted.
            poses: 4×4 X_WO of every object in the bin.
            X_WG_perturbed: 4×4 pose that the gripper really is commanded to.
            friction: Coulomb coefficient that it really meets.

        Raises:
            ValueError: the grasp is of kind NONE.
            KeyError: an object without a model or without a pose.
        """
        if not grasp:
            raise ValueError("there is no grasp to judge")
        if not grasp.object:
            return JudgedGrasp(
                0.0, "no object is under the grasp", np.array(X_WG_perturbed)
            )
        poses = {name: np.asarray(X, float) for name, X in poses.items()}
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
        return is_among(
            excluded,
            kind,
            X_OG,
            position=self.config.same_position,
            angle=self.config.same_angle,
        )
