"""Evidence of depth: nothing is known but an image, and which pixels to grasp.

Space that the camera has not seen to be free is taken as full; so is what is
beyond the bin's walls. The floor is known.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np

from xray_drake.cell.bin import Bin
from xray_drake.cell.gripper import GripperSpec
from xray_drake.configuration import count, number
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.grasping.candidates import (
    AntipodalPairs,
    Failures,
    GraspCandidates,
    by_score,
    cup_poses,
    in_groups,
    is_among,
    jaw_poses,
    moved,
)
from xray_drake.grasping.config import GraspPlannerConfig
from xray_drake.grasping.evidence.approach_shape import ApproachShape
from xray_drake.grasping.evidence.depth_suction import (
    seal_on_depth,
    seals_seen,
)
from xray_drake.grasping.evidence.depth_surface import DepthSurface, observe
from xray_drake.grasping.evidence.free_space import FreeSpace
from xray_drake.grasping.evidence.protocol import Approach, Squeeze
from xray_drake.grasping.evidence.rims import (
    close_pads,
    find_rims,
    pair_rims,
    wall_points,
)
from xray_drake.grasping.judgement import DOWN, GRAVITY, GripperModel
from xray_drake.grasping.seal import Seal
from xray_drake.messages import Grasp, GraspKind

_STOPS = (0.0, 0.33, 0.67, 1.0)
"""Where the jaw may stop, as shares of how far short it may stay."""

_BORDER_STEP = 0.002
"""What is nearer to the camera by this than the border is another object, m."""

_LEAST_TOUCH = 0.02
"""Share of a pad that touches at least, however little is seen of the wall."""

_CELL = 0.005
"""Pairs whose middles fall in one cell of this size, m, are alike."""

_EQUAL_ANGLE = 0.005
"""Pairs whose angles are in one step of this size are as well aligned, rad."""

_NO_SPACE = "no space for the gripper"


@dataclass
class DepthPlannerConfig(GraspPlannerConfig):
    """How grasps are looked for in a depth image."""

    # How far below the lower rim the fingertips go, where nothing stops them
    # earlier, m.
    insertion: float = number(0.008, "[0, 0.1]")
    # Largest angle between approach and straight down, rad.
    max_tilt: float = number(0.79, "[0, 1.5708]")
    suction_samples: int = count(250, "[1, 100000]")
    suction_turns: int = count(6, "[1, 360]")
    # Approaches of the jaw that are compared with the free space, and those of
    # them that are judged, at most.
    max_candidates: int = count(1500, "[1, 1000000]")
    max_checks: int = count(150, "[1, 100000]")
    rehearsals: int = count(12, "[0, 1000]")
    finalists: int = count(8, "[1, 1000]")
    # Readings of the object that there must be.
    min_pixels: int = count(20, "[1, 1000000]")
    # An object's weight is guessed by this density, kg/m³, …
    density: float = number(500.0, "(0, 25000]")
    # … and by at most this thickness, m. Of training objects high in a heap,
    # plain and packaged alike in number, half weigh more than is guessed.
    thickness: float = number(0.015, "(0, 1]")
    # Least distance of the pads when closed, m.
    min_width: float = number(0.002, "[0, 0.1]")
    # Rims of a pair may be this far aside of its axis, m, …
    max_offset: float = number(0.004, "[0, 0.1]")
    # … and differ this much in height, m.
    max_step: float = number(0.012, "[0, 1]")
    # How many of the places where the cup seals are tried.
    suction_places: int = count(15, "[1, 100000]")
    # An excluded grasp excludes those this near. It is more than for models,
    # since what was guessed wrong of the object there, its weight, its middle,
    # what holds it down, is as wrong a little beside.
    excluded_position: float = number(0.010, "[0, 1]")
    excluded_angle: float = number(0.5, "[0, 3.1416]")


class SeenObject(NamedTuple):
    """An object in an image.

    Attributes:
        mask: (H, W) bool, the object's pixels.
        depth: (H, W) z-depth, m; 0, inf and NaN are no reading.
        camera: of both.
    """

    mask: np.ndarray
    depth: np.ndarray
    camera: PinholeCamera


class DepthEvidence:
    """What a depth image tells, without a model of any object.

    Jaw grasps are pairs of rims: pixels beside which the depth drops, whose
    walls, judged by the surface inside the rims, are antipodal (Mahler et al.
    2017, Dex-Net 2.0). Suction grasps are places where the lip of the cup lies
    evenly on the object (Mahler et al. 2018, Dex-Net 3.0). The weight is a
    guess. Of grasps of equal quality that nearest to the object's middle is the
    best.
    """

    exhaustive = True

    def __init__(
        self,
        *,
        bin_: Bin | None = None,
        gripper: GripperSpec | None = None,
        config: DepthPlannerConfig | None = None,
        seed: int = 0,
    ) -> None:
        """Prepares what is the same for all images.

        Args:
            bin_: in which the heap lies; by default the nominal cell's.
            gripper: that grasps; by default the nominal cell's.
            config: of the search.
            seed: of the perturbations that grasps are rehearsed with.
        """
        self.bin = bin_ or Bin()
        self.config = config or DepthPlannerConfig()
        self.gripper = GripperModel(gripper, self.config.judgement)
        self.seed = seed
        self.shapes = {
            kind: ApproachShape(
                kind,
                self.gripper.geometry,
                approach_distance=self.config.judgement.approach_distance,
                cup_standoff=self.config.judgement.cup_standoff,
            )
            for kind in self.gripper.geometry.kinds
        }

    def look(
        self, object_name: str, known: SeenObject
    ) -> "SeenEvidence | None":
        """Takes an object out of an image.

        Args:
            object_name: of no account.
            known: the object.

        Returns:
            None where there are fewer readings than ``min_pixels``.

        Raises:
            ValueError: images of another shape than the camera's.
        """
        surface = observe(
            known.depth,
            known.mask,
            known.camera,
            min_pixels=self.config.min_pixels,
        )
        return None if surface is None else SeenEvidence(self, surface)


class SeenEvidence:
    """An :class:`ObjectEvidence`: the object in one depth image."""

    def __init__(self, evidence: DepthEvidence, surface: DepthSurface) -> None:
        """Prepares the image."""
        self._evidence = evidence
        self._config = evidence.config
        self._gripper = evidence.gripper
        self._surface = surface
        self.friction = evidence.gripper.spec.friction
        self._rims = find_rims(surface, friction=self.friction)
        self._walls, self._normals = wall_points(self._rims)
        camera, shapes = surface.whole_camera, evidence.shapes
        self._X_WC = camera.X_WC
        self._space = FreeSpace(surface.whole, camera, shapes, evidence.bin)
        others = np.where(_own_pixels(surface), np.inf, surface.whole)
        self._others = FreeSpace(
            others, camera, shapes, evidence.bin, levels=(0.0,)
        )
        self.X_OW = np.eye(4)
        self.enough = np.inf
        self.center = surface.object_points.mean(axis=0)
        self.weight = guess_weight(
            surface,
            density=self._config.density,
            thickness=self._config.thickness,
        )

    def candidates(
        self, excluded: Sequence[Grasp], failures: Failures
    ) -> Iterator[GraspCandidates]:
        """Yields all jaws, then all cups; see the protocol.

        Excluded ones are among them: to judge them costs little.
        """
        yield self._jaws(failures)
        if self._gripper.spec.has_cup:
            yield self._cups(failures)

    def _cups(self, failures: Failures) -> GraspCandidates:
        """Returns the best places where the cup seals."""
        points, leaky = seals_seen(
            self._surface,
            self._gripper.lip,
            count=self._config.suction_samples,
        )
        failures[GraspKind.SUCTION, "cup does not seal"] += leaky
        cups = cup_poses(
            points,
            self.center,
            self._gripper,
            failures,
            max_tilt=self._config.max_tilt,
            turns=self._config.suction_turns,
            ahead=self._X_WC[:3, 0],
        )
        # Of equal places each comes in all its turns before the next.
        turns = self._config.suction_turns
        cups = cups.take(np.arange(len(cups)).reshape(turns, -1).T.ravel())
        most = self._config.suction_places * turns
        return cups.take(by_score(cups.score)[:most])

    def _jaws(self, failures: Failures) -> GraspCandidates:
        """Returns the best that are free, no more of them than are wanted."""
        config, gripper = self._config, self._gripper
        pairs, wide = pair_rims(
            self._rims,
            friction=self.friction,
            min_width=config.min_width,
            max_width=gripper.spec.opening - 2 * config.min_clearance,
            max_offset=config.max_offset,
            max_step=config.max_step,
        )
        failures[GraspKind.JAW, "too wide"] += wide
        pairs = self._distinct(pairs)
        jaws, pair = jaw_poses(
            pairs,
            self.center,
            gripper,
            failures,
            friction=self.friction,
            max_tilt=config.max_tilt,
        )
        half = 0.5 * (pairs.first - pairs.second)[pair]
        below = np.abs(np.einsum("ni,ni->n", half, jaws.X_WG[:, :3, 2]))
        ahead = below + config.insertion - gripper.geometry.tip_length
        order = in_groups(jaws.score, jaws.group)[: config.max_candidates]
        jaws = replace(jaws, X_WG=moved(jaws.X_WG, ahead)).take(order)
        X_WG, space = np.zeros((0, 4, 4)), np.zeros(0)
        while (
            len(space) < len(jaws)
            and np.count_nonzero(space >= 0) < config.max_checks
        ):
            part = slice(len(space), len(space) + config.max_checks)
            opening = gripper.opening(jaws.width[part])
            stop = self.stop_jaw(jaws.X_WG[part], opening, 0.0)
            X_WG = np.concatenate([X_WG, stop.X_WG])
            space = np.concatenate([space, stop.space])
        failures[GraspKind.JAW, _NO_SPACE] += int(np.count_nonzero(space < 0))
        jaws = jaws.take(slice(len(space)))
        jaws = replace(jaws, X_WG=X_WG, space=space, stopped=True)
        return jaws.take(np.flatnonzero(space >= 0)[: config.max_checks])

    def _distinct(self, pairs: AntipodalPairs) -> AntipodalPairs:
        """Returns the best aligned of all pairs that are alike.

        They are in the camera's frame, so that they turn as scene and camera
        do.
        """
        order = np.argsort(np.floor(pairs.angle / _EQUAL_ANGLE), kind="stable")
        pairs = pairs.take(order)
        if not len(pairs):
            return pairs
        R, p = self._X_WC[:3, :3], self._X_WC[:3, 3]
        cell = np.column_stack(
            [
                np.round((pairs.middle - p) @ R / _CELL),
                np.round(3 * pairs.axis @ R),
            ]
        )
        first = np.unique(cell, axis=0, return_index=True)[1]
        return replace(pairs, cell=cell).take(first)

    def excludes(
        self, excluded: Sequence[Grasp], kind: GraspKind, X_WG: np.ndarray
    ) -> bool:
        """Says so by the pose in the world; see the protocol.

        A segmenter's names change from image to image, and where the object
        was moved, its grasps were, too.
        """
        return is_among(
            [replace(grasp, X_OG=grasp.X_WG) for grasp in excluded],
            kind,
            X_WG,
            position=self._config.excluded_position,
            angle=self._config.excluded_angle,
        )

    def preference(self, X_WG: np.ndarray) -> np.ndarray:
        """The nearest to the object's middle is the best."""
        lever = np.linalg.norm((X_WG[:, :3, 3] - self.center)[:, :2], axis=1)
        return np.round(lever, 4)

    def stop_jaw(
        self, X_WG: np.ndarray, opening: np.ndarray, overtravel: float
    ) -> Approach:
        """Stops it where all of it is in seen free space; see the protocol."""
        longest = self._gripper.config.max_retreat
        floor = self._gripper.floor_retreat(X_WG, opening)
        floor = np.maximum(floor, -overtravel)
        space = np.full(len(X_WG), -1.0)
        stop = np.full(len(X_WG), longest)
        # Where the tips hit something even there, they do farther on, too.
        able = np.flatnonzero(floor <= longest)
        able = able[
            self._space.tips_are_free(
                GraspKind.JAW, moved(X_WG[able], -stop[able]), opening[able]
            )
        ]
        for share in _STOPS:
            todo = able[space[able] < 0]
            stop[todo] = floor[todo] + share * (longest - floor[todo])
            space[todo] = self._space.room(
                GraspKind.JAW, moved(X_WG[todo], -stop[todo]), opening[todo]
            )
        return _approach(moved(X_WG, -stop), space)

    def close_pads(
        self, X_WG: np.ndarray, opening: np.ndarray, friction: np.ndarray
    ) -> Squeeze:
        """Closes them on the walls that go on below the object's rims.

        Two soft fingers across the weight hold 2 μ F / (1 + ℓ / b): ℓ is the
        horizontal distance of the weight from the closing axis, b the radius
        at which friction under a pad resists twist (Prattichizzo & Trinkle
        2008, soft finger). The pads hold at all if the walls' normals are
        within the friction cone about the axis (Dex-Net 2.0, antipodality).
        """
        p = self._gripper.spec
        met = close_pads(
            self._walls, self._normals, X_WG, opening, self._gripper
        )
        touched = np.maximum(met.coverage, _LEAST_TOUCH)
        twist = 2 / 3 * np.sqrt(p.pad_width * p.pad_height * touched / np.pi)
        arm = np.cross(self.center - met.middle, DOWN)
        lever = np.abs(np.einsum("ni,ni->n", arm, X_WG[:, :3, 1]))
        aligned = met.angle < np.arctan(np.maximum(friction, 1e-6))
        good = met.found & aligned
        shut = self._others.room(GraspKind.JAW, X_WG[good], met.width[good])
        reason = np.where(
            met.found, "walls are too oblique", "a pad misses the object"
        ).astype(object)
        reason[good] = np.where(shut >= 0, "", "jaw closes on something else")
        return Squeeze(
            width=met.width,
            angle=met.angle,
            coverage=met.coverage,
            holding=2 * friction * p.force / (1 + lever / twist),
            reason=reason,
        )

    def lay_cup(self, X_WG: np.ndarray) -> Seal:
        """Lays the lip on the surface that is seen; see the protocol."""
        return seal_on_depth(self._surface, X_WG, self._gripper.lip)

    def cup_space(self, X_WG: np.ndarray) -> Approach:
        """Compares it with seen free space; see the protocol."""
        nothing = np.zeros(len(X_WG))
        space = self._space.room(GraspKind.SUCTION, X_WG, nothing)
        return _approach(X_WG, space)


def _approach(X_WG: np.ndarray, space: np.ndarray) -> Approach:
    return Approach(X_WG, space, np.where(space < 0, _NO_SPACE, ""))


def _own_pixels(surface: DepthSurface) -> np.ndarray:
    """Returns the (H, W) bool pixels that show the object, or might.

    A mask may miss half a pixel of the object's border, and pads that close on
    the object come that near. What stands higher beside it is not its border.
    """
    mask, depth = surface.whole_mask, surface.whole
    kernel = np.ones((3, 3), np.uint8)
    beside = cv2.dilate(mask.astype(np.uint8), kernel) > 0
    own = np.where(mask, depth, np.inf).astype(np.float32)
    return beside & (depth > cv2.erode(own, kernel) - _BORDER_STEP)


def guess_weight(
    surface: DepthSurface, *, density: float, thickness: float
) -> float:
    """Guesses what an object weighs by the area that it shows, N.

    As if it stood on the floor, but no thicker than it is wide, nor than a
    given thickness: what lies high in a heap lies on others.

    Args:
        surface: what is seen.
        density: of the object, kg/m³.
        thickness: that it has at most, m.
    """
    side = surface.depth[surface.mask] / surface.camera.intrinsics[0, 0]
    area = float((side**2).sum())
    most = min(float(np.sqrt(area)), thickness)
    height = np.clip(surface.object_points[:, 2], min(0.002, most), most)
    return GRAVITY * density * area * float(height.mean())
