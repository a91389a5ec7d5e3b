"""Whether a gripper would lift an object of which only a depth image is known.

The counterpart of :mod:`xray_drake.grasping.judgement`, for many poses at once.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from xray_drake.grasping.depth_approach import ApproachShape
from xray_drake.grasping.depth_free_space import FreeSpace
from xray_drake.grasping.depth_jaw import Rims, close_pads, wall_points
from xray_drake.grasping.depth_suction import seal_on_depth
from xray_drake.grasping.depth_surface import DepthSurface
from xray_drake.grasping.judgement import DOWN, GRAVITY, GraspJudge
from xray_drake.grasping.wrench import suction_holding_force
from xray_drake.messages import GraspKind

_STOPS = (0.0, 0.33, 0.67, 1.0)
"""Where the jaw may stop, as shares of how far short it may stay."""

_BORDER_STEP = 0.002
"""What is nearer to the camera by this than the border is another object, m."""

_LEAST_TOUCH = 0.02
"""Share of a pad that touches at least, however little is seen of the wall."""


@dataclass(frozen=True, eq=False)
class DepthJudgement:
    """What would come of grasps.

    Attributes:
        quality: (n,) in [0, 1]; 0 where the object is not lifted.
        X_WG: (n, 4, 4) poses at which the gripper stops.
        width: (n,) distances of the closed pads, m; 0 for suction.
        room: (n,) free space around the gripper, m; −1 where it hits something.
    """

    quality: np.ndarray
    X_WG: np.ndarray
    width: np.ndarray
    room: np.ndarray


def _moved(X: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Returns (n, 4, 4) poses moved along their own z axes by (n,) m."""
    X = np.array(X)
    X[:, :3, 3] += distance[:, None] * X[:, :3, 2]
    return X


class DepthJudge:
    """Judges grasps on one object in one depth image.

    The gripper comes along its approach and stops at contact, as it does for
    ``GraspJudge``. The jaw then closes on the walls that go on below the
    object's rims, or the cup is laid on the surface that is seen. The contacts
    must resist the object's weight, which is guessed.

    Attributes:
        center: (3,) middle of what is seen of the object, in the world, m.
        weight: of the object as guessed, N.
    """

    def __init__(
        self,
        surface: DepthSurface,
        rims: Rims,
        *,
        rules: GraspJudge,
        shapes: Mapping[GraspKind, ApproachShape],
        weight: float,
    ) -> None:
        """Prepares the image.

        Args:
            surface: what is seen.
            rims: of the object.
            rules: knows gripper, floor and how execution is judged; it needs
                no objects.
            shapes: of each kind of approach.
            weight: of the object as guessed, N; see :func:`guess_weight`.
        """
        self._surface = surface
        self._rules = rules
        self._walls, self._normals = wall_points(rims)
        camera = surface.whole_camera
        self._space = FreeSpace(surface.whole, camera, shapes)
        others = np.where(_own_pixels(surface), np.inf, surface.whole)
        self._others = FreeSpace(others, camera, shapes, levels=(0.0,))
        points = surface.object_points
        self.center = points.mean(axis=0)
        self.weight = weight

    def stop_jaw(
        self, X_WG: np.ndarray, width: np.ndarray, *, overtravel: float = 0.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Lets the jaw come until it would touch something.

        Args:
            X_WG: (n, 4, 4) poses of the jaw.
            width: (n,) distances of the contacts as planned, m.
            overtravel: how far beyond X_WG the gripper is commanded, m.

        Returns:
            (n, 4, 4) poses where it stops and (n,) free space there, m; −1
            where it would have to stop too early.
        """
        longest = self._rules.config.max_retreat
        opening = self._rules.opening(width)
        floor = self._rules.floor_retreat(X_WG, opening)
        floor = np.maximum(floor, -overtravel)
        room = np.full(len(X_WG), -1.0)
        stop = np.full(len(X_WG), longest)
        # Where the tips hit something even there, they do farther on, too.
        able = np.flatnonzero(floor <= longest)
        able = able[
            self._space.tips_are_free(
                GraspKind.JAW, _moved(X_WG[able], -stop[able]), opening[able]
            )
        ]
        for share in _STOPS:
            todo = able[room[able] < 0]
            stop[todo] = floor[todo] + share * (longest - floor[todo])
            room[todo] = self._space.room(
                GraspKind.JAW, _moved(X_WG[todo], -stop[todo]), opening[todo]
            )
        return _moved(X_WG, -stop), room

    def jaw(
        self,
        X_WG: np.ndarray,
        width: np.ndarray,
        room: np.ndarray,
        *,
        friction: np.ndarray,
    ) -> DepthJudgement:
        """Judges jaws that have stopped.

        Two soft fingers across the weight hold 2 μ F / (1 + ℓ / b): ℓ is the
        horizontal distance of the weight from the closing axis, b the radius
        at which friction under a pad resists twist (Prattichizzo & Trinkle
        2008, soft finger). The pads hold at all if the walls' normals are
        within the friction cone about the axis (Dex-Net 2.0, antipodality).

        Args:
            X_WG: (n, 4, 4) poses where they have.
            width: (n,) distances of the contacts as planned, m.
            room: (n,) free space around them, m; −1 for none.
            friction: (n,) Coulomb coefficients.
        """
        rules, p = self._rules, self._rules.parameters
        squeeze = close_pads(
            self._walls,
            self._normals,
            X_WG,
            rules.opening(width),
            pad_width=p.pad_width,
            pad_height=p.pad_height,
            tip=rules.gripper.tip_length,
            compliance=p.pad_compliance,
        )
        alignment = 1 - squeeze.angle / np.arctan(np.maximum(friction, 1e-6))
        touched = np.maximum(squeeze.coverage, _LEAST_TOUCH)
        area = p.pad_width * p.pad_height * touched
        twist = 2 / 3 * np.sqrt(area / np.pi)
        arm = np.cross(self.center - squeeze.middle, DOWN)
        lever = np.abs(np.einsum("ni,ni->n", arm, X_WG[:, :3, 1]))
        holding = 2 * friction * p.force / (1 + lever / twist)
        held = self._held(holding)
        good = (room >= 0) & squeeze.found & (alignment > 0) & (held > 0)
        shut = self._others.room(GraspKind.JAW, X_WG[good], squeeze.width[good])
        good[good] = shut >= 0
        quality = (
            held * (0.5 + 0.5 * alignment) * (0.5 + 0.5 * squeeze.coverage)
        )
        return DepthJudgement(
            quality=np.where(good, quality, 0.0),
            X_WG=X_WG,
            width=squeeze.width,
            room=room,
        )

    def suction(
        self,
        X_WG: np.ndarray,
        *,
        friction: np.ndarray,
        overtravel: float = 0.0,
    ) -> DepthJudgement:
        """Judges suction grasps; the counterpart of ``GraspJudge.suction``.

        Args:
            X_WG: (n, 4, 4) poses of the cup.
            friction: (n,) Coulomb coefficients.
            overtravel: how far beyond X_WG the gripper is commanded, m.
        """
        p, config = self._rules.parameters, self._rules.config
        seal = seal_on_depth(
            self._surface,
            X_WG,
            radius=p.cup_radius,
            tolerance=config.seal_tolerance,
            max_normal_angle=config.seal_angle,
        )
        good = (
            seal.closed
            & (seal.nearest <= overtravel + p.bellows_travel)
            & (seal.nearest >= -config.max_retreat - p.bellows_travel)
            & (seal.spread <= 2 * p.bellows_travel)
        )
        X_WG = _moved(X_WG, np.where(good, seal.nearest, 0.0))

        z = seal.normal
        x = X_WG[:, :3, 0]
        x = x - np.einsum("ni,ni->n", x, z)[:, None] * z
        x = x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-9)
        R_WC = np.stack([x, np.cross(z, x), z], axis=-1)
        each: Any = friction  # one for each cup, where the function has one
        held = self._held(
            suction_holding_force(
                np.einsum("nji,nj->ni", R_WC, self.center - seal.center),
                np.einsum("nji,j->ni", R_WC, DOWN),
                friction=each,
                vacuum_force=p.vacuum_force,
                cup_radius=p.cup_radius,
                elasticity=p.cup_elasticity,
            )
        )
        good &= held > 0
        room = np.full(len(X_WG), -1.0)
        nothing = np.zeros(np.count_nonzero(good))
        room[good] = self._space.room(GraspKind.SUCTION, X_WG[good], nothing)
        evenness = 1 - seal.unevenness / config.seal_tolerance
        quality = held * (0.5 + 0.5 * evenness)
        return DepthJudgement(
            quality=np.where(room >= 0, quality, 0.0),
            X_WG=X_WG,
            width=np.zeros(len(X_WG)),
            room=room,
        )

    def _held(self, holding: np.ndarray) -> np.ndarray:
        """Returns 1 − weight / holding force, 0 where that is too small."""
        return np.maximum(0.0, 1 - self.weight / np.maximum(holding, 1e-9))


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
