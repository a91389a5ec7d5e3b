"""Plans a grasp on an object that is only seen: a depth image and a mask."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from xray_drake.configuration import count, number
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.grasping.candidates import (
    by_score,
    in_groups,
    is_among,
    quality_ranks,
)
from xray_drake.grasping.depth_approach import ApproachShape
from xray_drake.grasping.depth_candidates import (
    SeenObject,
    cup_poses,
    distinct_pairs,
    jaw_poses,
)
from xray_drake.grasping.depth_jaw import Rims, find_rims, pair_rims
from xray_drake.grasping.depth_judge import (
    DepthJudge,
    DepthJudgement,
    guess_weight,
)
from xray_drake.grasping.depth_suction import find_seals
from xray_drake.grasping.depth_surface import DepthSurface, observe
from xray_drake.grasping.gripper_geometry import GripperParameters
from xray_drake.grasping.judgement import GraspJudge, JudgementConfig
from xray_drake.grasping.perturbation import PerturbationConfig, perturb
from xray_drake.messages import Grasp, GraspKind, GraspPlan
from xray_drake.seeding import stream


@dataclass
class DepthPlannerConfig:
    """How grasps are looked for in a depth image."""

    # Readings of the object that there must be.
    min_pixels: int = count(20, "[1, 1000000]")
    # An object's weight is guessed by this density, kg/m³, …
    density: float = number(500.0, "(0, 25000]")
    # … and by at most this thickness, m. Of training objects high in a heap,
    # plain and packaged alike in number, half weigh more than is guessed.
    thickness: float = number(0.015, "(0, 1]")
    # Least distance of the pads when closed, m.
    min_width: float = number(0.002, "[0, 0.1]")
    # Free space that must be left beside the widest object, m.
    min_clearance: float = number(0.0025, "[0, 0.1]")
    # Rims of a pair may be this far aside of its axis, m, …
    max_offset: float = number(0.004, "[0, 0.1]")
    # … and differ this much in height, m.
    max_step: float = number(0.012, "[0, 1]")
    # How far below the lower rim the fingertips go, where nothing stops them
    # earlier, m.
    insertion: float = number(0.008, "[0, 0.1]")
    # Largest angle between approach and straight down, rad.
    max_tilt: float = number(0.79, "[0, 1.5708]")
    # Places on the object where the cup is laid, about, and how many of those
    # where it seals are tried.
    suction_samples: int = count(250, "[1, 100000]")
    suction_places: int = count(15, "[1, 100000]")
    # Turns of the cup about its axis that are tried.
    suction_turns: int = count(6, "[1, 360]")
    # Approaches of the jaw that are compared with the free space, and those of
    # them that are judged, at most.
    max_candidates: int = count(1500, "[1, 1000000]")
    max_checks: int = count(150, "[1, 100000]")
    # A grasp with this much free space around the gripper loses nothing, m.
    full_clearance: float = number(0.008, "(0, 1]")
    # The best are judged again under this many perturbations; the share that
    # holds multiplies their quality. 0 leaves it out.
    rehearsals: int = count(12, "[0, 1000]")
    # How many of them.
    finalists: int = count(8, "[1, 1000]")
    # What a rehearsal perturbs by.
    perturbation: PerturbationConfig = field(default_factory=PerturbationConfig)
    # Grasps are alike if they are this near to each other, m and rad.
    same_position: float = number(0.005, "[0, 1]")
    same_angle: float = number(0.175, "[0, 3.1416]")
    # An excluded grasp excludes those this near. It is more than for models,
    # since what was guessed wrong of the object there, its weight, its middle,
    # what holds it down, is as wrong a little beside.
    excluded_position: float = number(0.010, "[0, 1]")
    excluded_angle: float = number(0.5, "[0, 3.1416]")
    # How execution is judged.
    judgement: JudgementConfig = field(default_factory=JudgementConfig)


class DepthGraspPlanner:
    """Plans from what a camera sees, without a model of any object.

    Jaw grasps are pairs of rims: pixels beside which the depth drops, whose
    walls, judged by the surface inside the rims, are antipodal (Mahler et al.
    2017, Dex-Net 2.0). Suction grasps are places where the lip of the cup lies
    evenly on the object (Mahler et al. 2018, Dex-Net 3.0). Space that the
    camera has not seen to be free is taken as full; so is what is beyond the
    bin's walls. The floor is known.

    Quality is made as that of the planner that has models: 1 − weight / largest
    weight that can be held, times factors in [½, 1] for alignment and touched
    share of the pads, or for evenness under the lip and distance from edges;
    and for free space around the gripper. What the best are worth under
    perturbation, Dex-Net 2.0's robustness, multiplies it. Here the weight is a
    guess. Of grasps of equal quality that nearest to the object's middle is the
    best.

    The result depends on the arguments and the seed alone.
    """

    def __init__(
        self,
        *,
        parameters: GripperParameters | None = None,
        config: DepthPlannerConfig | None = None,
        seed: int = 0,
    ) -> None:
        """Builds the planner.

        Args:
            parameters: of the gripper.
            config: of the search.
            seed: of the perturbations that grasps are rehearsed with.
        """
        self.config = config or DepthPlannerConfig()
        self._rules = GraspJudge(
            (), parameters=parameters, config=self.config.judgement
        )
        self.parameters = self._rules.parameters
        self._seed = seed
        self._shapes = {
            kind: ApproachShape(
                kind,
                self._rules.gripper,
                approach_distance=self.config.judgement.approach_distance,
                cup_standoff=self.config.judgement.cup_standoff,
            )
            for kind in (GraspKind.JAW, GraspKind.SUCTION)
        }

    def plan(
        self,
        object_name: str,
        mask: np.ndarray,
        depth: np.ndarray,
        camera: PinholeCamera,
        *,
        excluded: Sequence[Grasp] = (),
    ) -> GraspPlan:
        """Plans a grasp.

        Args:
            object_name: what the grasp says it is of.
            mask: (H, W) bool, the object's pixels.
            depth: (H, W) z-depth, m; 0, inf and NaN are no reading.
            camera: of both.
            excluded: grasps not to be returned again, nor any like them, by
                their poses in the world: a segmenter's names change from image
                to image, and where the object was moved, its grasps were, too.

        Returns:
            The grasp; its pose is where the gripper is expected to stop. Since
            the object's frame is unknown, ``X_OG`` is ``X_WG``. Its kind is
            NONE if nothing was found.

        Raises:
            ValueError: images of another shape than the camera's.
        """
        found = self.find_grasps(
            object_name, mask, depth, camera, excluded=excluded
        )
        return GraspPlan(found[0] if found else Grasp())

    def find_grasps(
        self,
        object_name: str,
        mask: np.ndarray,
        depth: np.ndarray,
        camera: PinholeCamera,
        *,
        excluded: Sequence[Grasp] = (),
    ) -> list[Grasp]:
        """Returns the best grasps, the first being that of :meth:`plan`.

        They are distinct, and at most ``finalists`` many.

        Args:
            object_name: as for :meth:`plan`, and so are the others.
            mask: see there.
            depth: see there.
            camera: see there.
            excluded: see there.

        Raises:
            ValueError: images of another shape than the camera's.
        """
        surface = observe(
            depth, mask, camera, min_pixels=self.config.min_pixels
        )
        if surface is None:
            return []
        rims = find_rims(surface, friction=self.parameters.friction)
        judge = DepthJudge(
            surface,
            rims,
            rules=self._rules,
            shapes=self._shapes,
            weight=guess_weight(
                surface,
                density=self.config.density,
                thickness=self.config.thickness,
            ),
        )
        seen = SeenObject(judge.center, camera)
        found = [
            *self._jaws(object_name, rims, seen, judge),
            *self._cups(object_name, surface, seen, judge),
        ]
        found = _best_first(found, seen)
        barred = [replace(grasp, X_OG=grasp.X_WG) for grasp in excluded]
        chosen: list[Grasp] = []
        for grasp in found:
            if len(chosen) == self.config.finalists:
                break
            excluded_or_alike = is_among(
                barred,
                grasp.kind,
                grasp.X_OG,
                position=self.config.excluded_position,
                angle=self.config.excluded_angle,
            ) or is_among(
                chosen,
                grasp.kind,
                grasp.X_OG,
                position=self.config.same_position,
                angle=self.config.same_angle,
            )
            if not excluded_or_alike:
                chosen.append(grasp)
        chosen = self._rehearsed(chosen, judge)
        return _best_first(chosen, seen)

    def _jaws(
        self, name: str, rims: Rims, seen: SeenObject, judge: DepthJudge
    ) -> list[Grasp]:
        config, parameters = self.config, self.parameters
        pairs = pair_rims(
            rims,
            friction=parameters.friction,
            min_width=config.min_width,
            max_width=parameters.opening - 2 * config.min_clearance,
            max_offset=config.max_offset,
            max_step=config.max_step,
        )
        candidates = jaw_poses(
            distinct_pairs(pairs, seen),
            seen,
            self._rules,
            friction=parameters.friction,
            max_tilt=config.max_tilt,
            insertion=config.insertion,
        )
        order = in_groups(candidates.score, candidates.group)
        candidates = candidates.take(order[: config.max_candidates])
        # The best that are free, no more of them than are wanted.
        X_WG, room = np.zeros((0, 4, 4)), np.zeros(0)
        while (
            len(room) < len(candidates)
            and np.count_nonzero(room >= 0) < config.max_checks
        ):
            part = slice(len(room), len(room) + config.max_checks)
            stopped = judge.stop_jaw(
                candidates.X_WG[part], candidates.width[part]
            )
            X_WG = np.concatenate([X_WG, stopped[0]])
            room = np.concatenate([room, stopped[1]])
        free = np.flatnonzero(room >= 0)[: config.max_checks]
        judged = judge.jaw(
            X_WG[free],
            candidates.width[free],
            room[free],
            friction=np.full(len(free), parameters.friction),
        )
        return self._grasps(
            name, GraspKind.JAW, judged, candidates.robustness[free]
        )

    def _cups(
        self,
        name: str,
        surface: DepthSurface,
        seen: SeenObject,
        judge: DepthJudge,
    ) -> list[Grasp]:
        config, parameters = self.config, self.parameters
        points = find_seals(
            surface,
            count=config.suction_samples,
            radius=parameters.cup_radius,
            tolerance=config.judgement.seal_tolerance,
            max_normal_angle=config.judgement.seal_angle,
        )
        candidates = cup_poses(
            points,
            seen,
            seal_tolerance=config.judgement.seal_tolerance,
            max_tilt=config.max_tilt,
            turns=config.suction_turns,
        )
        order = by_score(candidates.score)
        count = config.suction_places * config.suction_turns
        candidates = candidates.take(order[:count])
        judged = judge.suction(
            candidates.X_WG,
            friction=np.full(len(candidates), parameters.friction),
        )
        return self._grasps(
            name, GraspKind.SUCTION, judged, candidates.robustness
        )

    def _grasps(
        self,
        name: str,
        kind: GraspKind,
        judged: DepthJudgement,
        robustness: np.ndarray,
    ) -> list[Grasp]:
        space = np.clip(judged.room / self.config.full_clearance, 0.0, 1.0)
        quality = judged.quality * robustness * (0.5 + 0.5 * space)
        return [
            Grasp(
                kind=kind,
                object=name,
                X_WG=judged.X_WG[i],
                X_OG=judged.X_WG[i],
                width=float(judged.width[i]),
                quality=float(quality[i]),
            )
            for i in np.flatnonzero(quality > 0)
        ]

    def _rehearsed(
        self, grasps: Sequence[Grasp], judge: DepthJudge
    ) -> list[Grasp]:
        """Multiplies qualities by the share of rehearsals that hold."""
        config = self.config
        count = config.rehearsals
        if not count:
            return list(grasps)
        # All grasps meet the same errors, none of which is the execution's.
        rng = stream(self._seed, "rehearsal")
        drawn = [
            perturb(Grasp(), rng, config.perturbation) for _ in range(count)
        ]
        error = np.array([X for X, _ in drawn])
        friction = np.array([mu for _, mu in drawn])
        overtravel = config.judgement.overtravel
        result = []
        for kind in (GraspKind.JAW, GraspKind.SUCTION):
            those = [grasp for grasp in grasps if grasp.kind is kind]
            if not those:
                continue
            X_WG = np.array([grasp.X_WG for grasp in those])[:, None]
            X_WG = np.tile(X_WG, (1, count, 1, 1))
            X_WG[..., :3, :3] = error[:, :3, :3] @ X_WG[..., :3, :3]
            X_WG[..., :3, 3] += error[:, :3, 3]
            X_WG = X_WG.reshape(-1, 4, 4)
            mu = np.tile(friction, len(those))
            if kind is GraspKind.JAW:
                width = np.repeat([grasp.width for grasp in those], count)
                X_WG, room = judge.stop_jaw(X_WG, width, overtravel=overtravel)
                judged = judge.jaw(X_WG, width, room, friction=mu)
            else:
                judged = judge.suction(X_WG, friction=mu, overtravel=overtravel)
            held = (judged.quality > 0).reshape(-1, count).sum(axis=1)
            # Laplace's rule, as in the planner that has models.
            share = (held + 1) / (count + 1)
            result += [
                replace(grasp, quality=grasp.quality * float(part))
                for grasp, part in zip(those, share, strict=True)
            ]
        return result


def _best_first(grasps: Sequence[Grasp], seen: SeenObject) -> list[Grasp]:
    """Orders by quality; of equal ones the nearest to the middle is first."""
    if not grasps:
        return []
    ranks = quality_ranks(np.array([grasp.quality for grasp in grasps]))
    lever = seen.lever(np.array([grasp.X_WG[:3, 3] for grasp in grasps]))
    return [grasps[i] for i in np.lexsort((np.round(lever, 4), ranks))]
