"""Plans a grasp on an object of a heap, whatever the heap is known by."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Generic, TypeVar

import numpy as np

from xray_drake.grasping.candidates import (
    EQUAL_QUALITY,
    Failures,
    GraspCandidates,
    is_among,
    quality_ranks,
)
from xray_drake.grasping.evidence.protocol import GraspEvidence, ObjectEvidence
from xray_drake.grasping.judge import judge
from xray_drake.grasping.judgement import JudgedGrasp
from xray_drake.grasping.perturbation import perturb
from xray_drake.messages import Grasp, GraspKind, GraspPlan
from xray_drake.seeding import stream

Known = TypeVar("Known")


class GraspPlanner(Generic[Known]):
    """Plans grasps by what an evidence tells of objects.

    The evidence finds candidates and ranks them cheaply; the planner judges
    them as execution would go (:func:`xray_drake.grasping.judge.judge`), drops
    what was excluded, rehearses the best under perturbations, and returns the
    one that is expected to hold best. Quality is what the judge says, times
    factors in [½, 1] for free space around the gripper and what the evidence
    knows of robustness, times the share of rehearsals that hold: the
    expectation of quality under perturbation is what Dex-Net 2.0 calls
    robustness (Mahler et al. 2017, section III).

    The result depends on the arguments, the evidence and its seed, not on what
    was planned before. Two threads cannot use one planner at the same time.

    Attributes:
        evidence: what is known of the objects.
    """

    def __init__(self, evidence: GraspEvidence[Known]) -> None:
        """Draws the errors of the rehearsals."""
        self.evidence = evidence
        config = evidence.config
        # All grasps meet the same errors, none of which is the execution's.
        rng = stream(evidence.seed, "rehearsal")
        drawn = [
            perturb(Grasp(), rng, config.perturbation)
            for _ in range(config.rehearsals)
        ]
        self._errors = np.array([X for X, _ in drawn]).reshape(-1, 4, 4)
        self._frictions = np.array([friction for _, friction in drawn])

    def plan(
        self,
        object_name: str,
        known: Known,
        *,
        excluded: Sequence[Grasp] = (),
    ) -> GraspPlan:
        """Plans a grasp.

        Args:
            object_name: of the object to grasp; the grasp says it is of it.
            known: what is known of the heap: 4×4 X_WO by name with models, a
                :class:`~xray_drake.grasping.evidence.depth.SeenObject` in a
                depth image.
            excluded: grasps not to be returned again, nor any like them.

        Returns:
            The grasp, whose pose is where the gripper is expected to stop and
            whose kind is NONE if nothing was found; and why others failed.

        Raises:
            KeyError: an object without a model or without a pose.
            ValueError: images of another shape than the camera's.
        """
        failures = Failures()
        found = self._find(object_name, known, excluded, failures)
        return GraspPlan(found[0] if found else Grasp(), failures.rejections())

    def find_grasps(
        self,
        object_name: str,
        known: Known,
        *,
        excluded: Sequence[Grasp] = (),
    ) -> list[Grasp]:
        """Returns the best grasps, the first being that of :meth:`plan`.

        At most ``finalists`` many; of an evidence that is exhaustive they are
        distinct. Arguments and errors are those of :meth:`plan`.
        """
        return self._find(object_name, known, excluded, Failures())

    def judge(
        self,
        grasp: Grasp,
        known: Known,
        *,
        X_WG_perturbed: np.ndarray,
        friction: float,
    ) -> JudgedGrasp:
        """Judges a grasp as it is executed rather than as it was planned.

        Args:
            grasp: as planned; of an object without a name, nothing is lifted.
            known: what is known of the heap.
            X_WG_perturbed: 4×4 pose that the gripper really is commanded to.
            friction: Coulomb coefficient that it really meets.

        Raises:
            ValueError: the grasp is of kind NONE.
            KeyError: an object without a model or without a pose.
        """
        if not grasp:
            raise ValueError("there is no grasp to judge")
        X_WG = np.array(X_WG_perturbed, dtype=float)
        if not grasp.object:
            return JudgedGrasp(0.0, "no object is under the grasp", X_WG)
        seen = self.evidence.look(grasp.object, known)
        if seen is None:
            return JudgedGrasp(0.0, "too little is seen of the object", X_WG)
        return self._execute(seen, [grasp], X_WG[None], np.array([friction]))[0]

    def _find(
        self,
        name: str,
        known: Known,
        excluded: Sequence[Grasp],
        failures: Failures,
    ) -> list[Grasp]:
        seen = self.evidence.look(name, known)
        if seen is None:
            for kind in self.evidence.gripper.geometry.kinds:
                failures[kind, "too little is seen of the object"] += 1
            return []
        found: list[Grasp] = []
        for batch in seen.candidates(excluded, failures):
            for grasp in self._judged(name, seen, batch, failures):
                if seen.excludes(excluded, grasp.kind, grasp.X_WG):
                    failures[grasp.kind, "failed before"] += 1
                else:
                    found.append(grasp)
            if len(found) >= seen.enough:
                break
        finalists = self._finalists(_best_first(found, seen))
        return _best_first(self._rehearsed(seen, finalists, failures), seen)

    def _judged(
        self,
        name: str,
        seen: ObjectEvidence,
        batch: GraspCandidates,
        failures: Failures,
    ) -> list[Grasp]:
        """Returns those of the candidates that hold."""
        kind, full = batch.kind, self.evidence.config.full_clearance
        judged = judge(
            seen,
            self.evidence.gripper,
            kind,
            batch.X_WG,
            batch.width,
            np.full(len(batch), seen.friction),
            stopped=batch.space if batch.stopped else None,
        )
        space = np.array([one.space for one in judged])
        batch = replace(batch, space=np.minimum(batch.space, space))
        grasps = []
        for one, factor in zip(judged, batch.quality_factor(full), strict=True):
            if one.quality > 0:
                grasps.append(
                    Grasp(
                        kind=kind,
                        object=name,
                        X_WG=one.X_WG,
                        X_OG=seen.X_OW @ one.X_WG,
                        width=one.width,
                        quality=one.quality * float(factor),
                    )
                )
            elif one.is_too_weak:
                failures.count_weak(kind, one.holding, seen.weight)
            else:
                failures[kind, one.reason] += 1
        return grasps

    def _finalists(self, grasps: Sequence[Grasp]) -> list[Grasp]:
        """Returns the first of them that are to be rehearsed."""
        config, chosen = self.evidence.config, list[Grasp]()
        for grasp in grasps:
            if len(chosen) == config.finalists:
                break
            again = self.evidence.exhaustive and is_among(
                chosen,
                grasp.kind,
                grasp.X_OG,
                position=config.same_position,
                angle=config.same_angle,
            )
            if not again:
                chosen.append(grasp)
        return chosen

    def _rehearsed(
        self, seen: ObjectEvidence, grasps: list[Grasp], failures: Failures
    ) -> list[Grasp]:
        """Multiplies qualities by the share of rehearsals that hold.

        Unless the evidence is exhaustive, those are left out that cannot be,
        or are not, better than one before.
        """
        if not len(self._errors):
            return grasps
        if self.evidence.exhaustive:
            return [
                grasp
                for kind in (GraspKind.JAW, GraspKind.SUCTION)
                for grasp in self._rehearse(
                    seen, [g for g in grasps if g.kind is kind]
                )
            ]
        better: list[Grasp] = []
        for grasp in grasps:
            least = better[-1].quality + EQUAL_QUALITY if better else 0.0
            if grasp.quality <= least:
                break
            (grasp,) = self._rehearse(seen, [grasp])
            if grasp.quality > least:
                better.append(grasp)
        return better

    def _rehearse(
        self, seen: ObjectEvidence, grasps: list[Grasp]
    ) -> list[Grasp]:
        """Rehearses grasps of one kind, all under the same errors."""
        if not grasps:
            return []
        count = len(self._errors)
        X_WG = np.array([grasp.X_WG for grasp in grasps])[:, None]
        X_WG = np.tile(X_WG, (1, count, 1, 1))
        X_WG[..., :3, :3] = self._errors[:, :3, :3] @ X_WG[..., :3, :3]
        X_WG[..., :3, 3] += self._errors[:, :3, 3]
        judged = self._execute(
            seen,
            [grasp for grasp in grasps for _ in range(count)],
            X_WG.reshape(-1, 4, 4),
            np.tile(self._frictions, len(grasps)),
        )
        held = np.reshape([one.quality > 0 for one in judged], (-1, count))
        # Laplace's rule keeps a grasp that failed every rehearsal: it may be
        # the only one.
        share = (held.sum(axis=1) + 1) / (count + 1)
        return [
            replace(grasp, quality=grasp.quality * float(part))
            for grasp, part in zip(grasps, share, strict=True)
        ]

    def _execute(
        self,
        seen: ObjectEvidence,
        grasps: Sequence[Grasp],
        X_WG: np.ndarray,
        friction: np.ndarray,
    ) -> Sequence[JudgedGrasp]:
        """Judges grasps of one kind at other poses, with overtravel."""
        return judge(
            seen,
            self.evidence.gripper,
            grasps[0].kind,
            X_WG,
            np.array([grasp.width for grasp in grasps]),
            friction,
            overtravel=self.evidence.config.judgement.overtravel,
        )


def _best_first(grasps: Sequence[Grasp], seen: ObjectEvidence) -> list[Grasp]:
    """Orders by quality, and what is equal as the evidence prefers."""
    if not grasps:
        return []
    ranks = quality_ranks(np.array([grasp.quality for grasp in grasps]))
    keys = seen.preference(np.array([grasp.X_WG for grasp in grasps]))
    return [grasps[i] for i in np.lexsort((keys, ranks))]
