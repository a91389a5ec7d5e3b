"""Evidence of models: shapes, weights and poses of all objects are known."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from xray_drake.cell.bin import Bin
from xray_drake.cell.gripper import GripperSpec
from xray_drake.configuration import count
from xray_drake.grasping.candidates import (
    AntipodalPairs,
    Failures,
    GraspCandidates,
    SuctionPoints,
    by_score,
    cup_poses,
    in_groups,
    is_among,
    jaw_poses,
    moved,
)
from xray_drake.grasping.config import GraspPlannerConfig
from xray_drake.grasping.evidence.clearance import clearance
from xray_drake.grasping.evidence.collision import GraspScene
from xray_drake.grasping.evidence.pads import touch
from xray_drake.grasping.evidence.protocol import Approach, Squeeze
from xray_drake.grasping.evidence.sampling import (
    sample_antipodal,
    sample_suction,
    seal_cups,
    surface_points,
)
from xray_drake.grasping.judgement import (
    DOWN,
    GRAVITY,
    GripperModel,
)
from xray_drake.grasping.seal import Seal
from xray_drake.grasping.wrench import jaw_holding_force
from xray_drake.messages import Grasp, GraspKind
from xray_drake.scene.object_model import ObjectModel
from xray_drake.seeding import stream

_CHUNK = 96
"""Candidates whose clearance is estimated at once."""

_COARSE = 8
"""The first estimate of clearance takes one point in so many."""

_POINT_TOLERANCE = 0.0015
"""Surface points may be this deep in the gripper without excluding a pose, m:
collision pieces only approximate the surface."""

_STOP_TOLERANCE = 0.0005
"""The jaw is stopped so accurately, m."""


@dataclass
class ModelPlannerConfig(GraspPlannerConfig):
    """How grasps are looked for on models."""

    # Surface points drawn per object for the jaw.
    jaw_samples: int = count(400, "[1, 100000]")
    # Points on each object's surface, for the cheap check of clearance; the
    # object to grasp gets four times as many.
    surface_points: int = count(150, "[1, 100000]")
    # The search ends when this many grasps that hold have been found.
    enough: int = count(10, "[1, 100000]")


class ModelEvidence:
    """What models tell: the literature's analytic planning.

    Candidates (antipodal pairs, places where the cup seals) are sampled once
    per object and kept. They are ranked by upper bounds of what they can hold,
    by how near the centre of mass they are and how steep the approach is. A
    cloud of points on all surfaces tells which of them cannot be free and how
    much space the others have. Contacts and collisions are exact; what rests on
    the object is ignored.

    What it says depends on the seed, on the object's name and pose, and on the
    heap, not on what was asked before. It owns the scene that collisions are
    looked for in, so two threads cannot use it at the same time.
    """

    exhaustive = False

    def __init__(
        self,
        objects: Sequence[ObjectModel],
        *,
        bin_: Bin | None = None,
        gripper: GripperSpec | None = None,
        config: ModelPlannerConfig | None = None,
        seed: int = 0,
    ) -> None:
        """Builds the collision scene; samples are drawn when first needed.

        Args:
            objects: all that can be in the heap.
            bin_: in which it lies; by default the nominal cell's.
            gripper: that grasps; by default the nominal cell's.
            config: of the search.
            seed: of the samples.
        """
        self.config = config or ModelPlannerConfig()
        self.gripper = GripperModel(gripper, self.config.judgement)
        self.seed = seed
        self.objects = {model.name: model for model in objects}
        self.scene = GraspScene(
            objects,
            gripper=self.gripper.geometry,
            bin_=bin_,
            approach_distance=self.config.judgement.approach_distance,
            cup_standoff=self.config.judgement.cup_standoff,
        )
        self._surfaces: dict[str, np.ndarray] = {}
        self._samples: dict[
            str, tuple[AntipodalPairs, SuctionPoints | None, Failures]
        ] = {}

    def look(
        self, object_name: str, known: Mapping[str, np.ndarray]
    ) -> "PlacedModel":
        """Puts the objects where they are.

        Args:
            object_name: of the object to grasp.
            known: 4×4 X_WO of every object in the bin.

        Raises:
            KeyError: an object without a model or without a pose.
        """
        poses = {name: np.asarray(X, float) for name, X in known.items()}
        self.scene.set_poses(poses)
        return PlacedModel(self, object_name, poses)

    def friction(self, name: str) -> float:
        """Returns the coefficient between gripper and object.

        Combined as Drake does: 2 μ₁ μ₂ / (μ₁ + μ₂).
        """
        a, b = self.gripper.spec.friction, self.objects[name].friction
        return 2 * a * b / (a + b) if a + b > 0 else 0.0

    def samples(
        self, name: str
    ) -> tuple[AntipodalPairs, SuctionPoints | None, Failures]:
        """Returns the grasp candidates of an object in its body frame.

        Without a cup there are no suction points. And how many other samples
        are no candidates, and why.
        """
        if name not in self._samples:
            mesh, config = self.objects[name].visual, self.config
            rng = stream(self.seed, f"samples of {name}")
            pairs, wide = sample_antipodal(
                mesh,
                rng,
                count=config.jaw_samples,
                friction=self.friction(name),
                max_width=self.gripper.spec.opening - 2 * config.min_clearance,
            )
            unfit = Failures({(GraspKind.JAW, "too wide"): wide})
            points = None
            if self.gripper.spec.has_cup:
                points, leaky = sample_suction(
                    mesh,
                    rng,
                    self.gripper.lip,
                    count=config.suction_samples,
                )
                unfit[GraspKind.SUCTION, "cup does not seal"] = leaky
            self._samples[name] = pairs, points, unfit
        return self._samples[name]

    def surface(self, name: str) -> np.ndarray:
        """Returns (n, 3) points on an object's surface, in its frame, m."""
        if name not in self._surfaces:
            rng = stream(self.seed, f"surface of {name}")
            self._surfaces[name], _ = surface_points(
                self.objects[name].visual, 4 * self.config.surface_points, rng
            )
        return self._surfaces[name]


class PlacedModel:
    """An :class:`ObjectEvidence`: a model at its pose, among others."""

    def __init__(
        self,
        evidence: ModelEvidence,
        name: str,
        poses: Mapping[str, np.ndarray],
    ) -> None:
        """Takes the 4×4 X_WO of all objects; the scene has them already."""
        X_WO = poses[name]
        self._evidence = evidence
        self._scene = evidence.scene
        self._gripper = evidence.gripper
        self._config = evidence.config
        self._name = name
        self._poses = poses
        self._model = evidence.objects[name]
        self._X_WO = X_WO
        self.enough = float(evidence.config.enough)
        self.X_OW = np.linalg.inv(X_WO)
        self.weight = GRAVITY * self._model.mass
        self.center = X_WO[:3, :3] @ self._model.p_OCom + X_WO[:3, 3]
        self.friction = evidence.friction(name)

    def candidates(
        self, excluded: Sequence[Grasp], failures: Failures
    ) -> Iterator[GraspCandidates]:
        """Yields them one by one; see the protocol."""
        both = self.all_candidates(failures)
        points = self._points_around()
        size, groups = len(both[0]), 1 + both[0].group.max(initial=0)
        order = in_groups(
            np.concatenate([c.score for c in both]),
            np.concatenate([both[0].group, groups + both[1].group]),
        )[: self._config.max_candidates]
        checked = 0
        for start in range(0, len(order), _CHUNK):
            part = order[start : start + _CHUNK]
            chunks = part[part < size], part[part >= size] - size
            queue = [
                free.take(slice(i, i + 1))
                for candidates, chunk in zip(both, chunks, strict=True)
                for free in [
                    self._free(candidates.take(chunk), points, failures)
                ]
                for i in range(len(free))
            ]
            for i in by_score(np.array([float(c.score[0]) for c in queue])):
                kind, X_WG = queue[i].kind, queue[i].X_WG[0]
                if self.excludes(excluded, kind, X_WG):
                    failures[kind, "failed before"] += 1
                    continue
                if checked == self._config.max_checks:
                    return
                checked += 1
                yield queue[i]

    def excludes(
        self, excluded: Sequence[Grasp], kind: GraspKind, X_WG: np.ndarray
    ) -> bool:
        """Says so by the pose on the object; see the protocol."""
        return is_among(
            excluded,
            kind,
            self.X_OW @ X_WG,
            position=self._config.same_position,
            angle=self._config.same_angle,
        )

    def preference(self, X_WG: np.ndarray) -> np.ndarray:
        """None: the first found is the best; see the protocol."""
        return np.zeros(len(X_WG))

    def all_candidates(
        self, failures: Failures
    ) -> tuple[GraspCandidates, GraspCandidates]:
        """Returns jaws and cups that could hold where they are free.

        Args:
            failures: those that could not are counted here.
        """
        pairs, points, unfit = self._evidence.samples(self._name)
        failures.update(unfit)
        return self._jaws(pairs, failures), self._cups(points, failures)

    def _jaws(
        self, pairs: AntipodalPairs, failures: Failures
    ) -> GraspCandidates:
        """Returns poses that stop above the floor."""
        gripper = self._gripper
        R, p = self._X_WO[:3, :3], self._X_WO[:3, 3]
        in_world = replace(
            pairs,
            first=pairs.first @ R.T + p,
            second=pairs.second @ R.T + p,
            axis=pairs.axis @ R.T,
        )
        jaws, _ = jaw_poses(
            in_world,
            self.center,
            gripper,
            failures,
            friction=self.friction,
            max_tilt=self._config.max_tilt,
        )
        X_WG = moved(jaws.X_WG, self._config.insertion)
        retreat = gripper.floor_retreat(X_WG, gripper.opening(jaws.width))
        above = retreat <= gripper.config.max_retreat
        failures[GraspKind.JAW, "jaw hits floor"] += int(np.sum(~above))
        jaws = replace(jaws, X_WG=moved(X_WG, -np.maximum(retreat, 0.0)))
        jaws = jaws.take(above)
        most = gripper.most_held(self.friction)
        if self.weight < most:
            return jaws
        failures.count_weak(GraspKind.JAW, most, self.weight, len(jaws))
        return jaws.take(slice(0))

    def _cups(
        self, points: SuctionPoints | None, failures: Failures
    ) -> GraspCandidates:
        """Returns poses that can hold the weight where they seal."""
        if points is None:
            return GraspCandidates.none(GraspKind.SUCTION)
        R, p = self._X_WO[:3, :3], self._X_WO[:3, 3]
        cups = cup_poses(
            replace(
                points,
                point=points.point @ R.T + p,
                approach=points.approach @ R.T,
            ),
            self.center,
            self._gripper,
            failures,
            max_tilt=self._config.max_tilt,
            turns=self._config.suction_turns,
        )
        R_WG = cups.X_WG[:, :3, :3]
        lever = self.center - cups.X_WG[:, :3, 3]
        holding = self._gripper.cup_holds(R_WG, lever, self.friction)
        held = 1 - self.weight / holding
        weak = holding[held <= 0]
        if len(weak):
            strongest = float(weak.max())
            failures.count_weak(
                GraspKind.SUCTION, strongest, self.weight, len(weak)
            )
        return replace(cups, score=held * cups.score).take(held > 0)

    def _points_around(self) -> np.ndarray:
        """Returns (m, 3) surface points that the gripper could meet, m."""
        clouds = [self._scene.bin_points]
        for other, X_WO in self._poses.items():
            cloud = self._evidence.surface(other)
            if other != self._name:
                cloud = cloud[: self._config.surface_points]
            clouds.append(cloud @ X_WO[:3, :3].T + X_WO[:3, 3])
        points = np.concatenate(clouds)
        away = np.linalg.norm((points - self._X_WO[:3, 3])[:, :2], axis=1)
        size = 0.5 * float(np.linalg.norm(self._model.extents))
        return points[(away < size + 0.17) & (points[:, 2] > 0.001)]

    def _free(
        self,
        candidates: GraspCandidates,
        points: np.ndarray,
        failures: Failures,
    ) -> GraspCandidates:
        """Drops those that cannot be free, scores the others by their space."""
        kind, count = candidates.kind, len(candidates)
        if not count:
            return candidates
        for stride in (_COARSE, 1):
            space = self._clearance(candidates, points[::stride])
            candidates = replace(candidates, space=space)
            candidates = candidates.take(space > -_POINT_TOLERANCE)
        failures[kind, "no space for the gripper"] += count - len(candidates)
        full = self._config.full_clearance
        return replace(
            candidates, score=candidates.score * candidates.quality_factor(full)
        )

    def _clearance(
        self, candidates: GraspCandidates, points: np.ndarray
    ) -> np.ndarray:
        """Returns the (n,) free space around the gripper where it may stop."""
        gripper, config = self._gripper, self._gripper.config
        kind, back = candidates.kind, gripper.spec.bellows_travel
        tool = gripper.geometry.approach(
            kind, config.approach_distance, config.cup_standoff
        )
        lower, upper = tool.lower, tool.upper
        if kind is GraspKind.JAW:
            back = config.max_retreat
            shift = tool.closing_shift(gripper.opening(candidates.width))
            lower, upper = lower + shift, upper + shift
        X_WB = moved(candidates.X_WG, -back) @ np.linalg.inv(tool.frame(kind))
        return clearance(points, X_WB, lower, upper, tool.round)

    def stop_jaw(
        self, X_WG: np.ndarray, opening: np.ndarray, overtravel: float
    ) -> Approach:
        """Stops it short of the exact collision; see the protocol."""
        stops = [
            self._stop_one(X, float(d), -overtravel)
            for X, d in zip(X_WG, opening, strict=True)
        ]
        reason = [f"jaw hits {hit}" if hit else "" for _, hit in stops]
        retreat = np.array([0.0 if hit else stop for stop, hit in stops])
        return _approach(moved(X_WG, -retreat), np.array(reason))

    def _stop_one(
        self, X_WG: np.ndarray, opening: float, start: float
    ) -> tuple[float, str]:
        """Returns how far short of the pose the jaw stops, at least ``start``.

        And what it hits if it would have to stop earlier than is allowed.
        """

        def collides(retreat: float) -> bool:
            (X,) = moved(X_WG[None], -retreat)
            return self._scene.jaw_collides(X, opening)

        low = max(start, float(self._gripper.floor_retreat(X_WG, opening)))
        high = self._gripper.config.max_retreat
        if low > high:
            return high, "floor"
        if not collides(low):
            return low, ""
        if collides(high):
            return high, ", ".join(self._scene.hit()) or "bin"
        while high - low > _STOP_TOLERANCE:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if collides(middle) else (low, middle)
        return high, ""

    def close_pads(
        self, X_WG: np.ndarray, opening: np.ndarray, friction: np.ndarray
    ) -> Squeeze:
        """Finds the contacts on the model, and their wrenches."""
        columns = zip(
            *(
                self._close_one(X, float(d), float(mu))
                for X, d, mu in zip(X_WG, opening, friction, strict=True)
            ),
            strict=True,
        )
        return Squeeze(*map(np.array, columns))

    def _close_one(
        self, X_WG: np.ndarray, opening: float, friction: float
    ) -> tuple[float, float, float, float, str]:
        """Returns the row of a Squeeze."""
        X_OG = self.X_OW @ X_WG
        touched = touch(self._model.visual, X_OG, opening, self._gripper)
        if touched is None:
            return 0.0, 0.0, 0.0, 0.0, "a pad misses the object"
        contacts, width, coverage = touched
        with self._scene.without(self._name):
            if self._scene.jaw_collides(X_WG, width):
                hit = ", ".join(self._scene.hit())
                return width, 0.0, coverage, 0.0, f"jaw closes on {hit}"
        holding = 0.0
        if self.weight < self._gripper.most_held(friction):
            holding = jaw_holding_force(
                contacts,
                self._model.p_OCom,
                self._X_WO[:3, :3].T @ DOWN,
                friction=friction,
                force=self._gripper.spec.force,
            )
        y = X_OG[:3, 1]
        cosine = min(-contacts[0].normal @ y, contacts[1].normal @ y)
        angle = float(np.arccos(min(1.0, cosine)))
        return width, angle, coverage, holding, ""

    def lay_cup(self, X_WG: np.ndarray) -> Seal:
        """Projects the lip on the model; see the protocol."""
        mesh, R = self._model.visual, self._X_WO[:3, :3]
        seal = seal_cups(mesh, self.X_OW @ X_WG, self._gripper.lip)
        return replace(
            seal,
            center=seal.center @ R.T + self._X_WO[:3, 3],
            normal=seal.normal @ R.T,
        )

    def cup_space(self, X_WG: np.ndarray) -> Approach:
        """Looks for exact collisions; see the protocol."""
        hits = [
            "suction tool hits " + ", ".join(self._scene.hit())
            if self._scene.suction_collides(X)
            else ""
            for X in X_WG
        ]
        return _approach(X_WG, np.array(hits))


def _approach(X_WG: np.ndarray, reason: np.ndarray) -> Approach:
    return Approach(X_WG, np.where(reason == "", np.inf, -1.0), reason)
