"""Whether a gripper at a given pose lifts an object: contacts and weight."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from xray_drake.configuration import number
from xray_drake.grasping.collision import GraspScene
from xray_drake.grasping.gripper_geometry import (
    GripperGeometry,
    GripperParameters,
    load_gripper_geometry,
)
from xray_drake.grasping.sampling import cast_rays, seal_cups
from xray_drake.grasping.wrench import (
    PadContact,
    holding_quality,
    jaw_holding_force,
    suction_holding_force,
)
from xray_drake.scene.object_model import ObjectModel

GRAVITY = 9.81
"""m/s²."""

DOWN = np.array([0.0, 0.0, -1.0])
"""Direction of gravity in the world."""


@dataclass
class JudgementConfig:
    """How execution is judged."""

    # Free space between each pad and the object while the jaw descends, m.
    clearance: float = number(0.005, "[0, 0.1]")
    # The gripper stops at contact at most this far before the given pose, m;
    # if it would have to stop earlier, the grasp fails.
    max_retreat: float = number(0.006, "[0, 0.1]")
    # In execution it is commanded this far beyond the given pose, m, because
    # it stops at contact anyway.
    overtravel: float = number(0.002, "[0, 0.1]")
    # Distance that the fingertips keep from the bin's floor, m.
    floor_clearance: float = number(0.0005, "[0, 0.1]")
    # Length of the straight approach that must be free, m.
    approach_distance: float = number(0.10, "(0, 1]")
    # The rigid part of the cup ends this far before its lip, m.
    cup_standoff: float = number(0.002, "[0, 0.1]")
    # A cup seals where the surface is this near the lip's plane, m, …
    seal_tolerance: float = number(0.0025, "(0, 0.1]")
    # … and its normals deviate by no more than this, rad. Both together let
    # the cup seal on cylinders of 25 mm radius, as bellows cups do.
    seal_angle: float = number(0.70, "(0, 1.5708]")


@dataclass(frozen=True, eq=False)
class JudgedGrasp:
    """What would come of a grasp.

    Attributes:
        quality: in [0, 1]; 0 where the object is not lifted.
        reason: why not, one line; empty where it is.
        X_WG: (4, 4) pose at which the gripper stops.
        width: distance of the pads when closed, m; 0 for suction.
        holding: the largest weight that the contacts hold, N; 0 where it did
            not come to that.
    """

    quality: float
    reason: str
    X_WG: np.ndarray
    width: float = 0.0
    holding: float = 0.0


def _moved(X: np.ndarray, distance: float) -> np.ndarray:
    """Returns the pose moved along its own z axis."""
    moved = np.array(X)
    moved[:3, 3] += distance * X[:3, 2]
    return moved


class GraspJudge:
    """Judges grasps on a heap at rest, quasi-statically.

    The gripper comes along its approach and *stops at contact*, as a guarded
    descent does: where it would go below the floor or into something, it stays
    short of the pose, by up to ``max_retreat``. The jaw then closes until both
    pads touch, and the contacts are recomputed from the object's surface; or
    the cup meets the surface, its bellows taking up ±``bellows_travel``, and
    seals or not. The contacts must then resist the object's weight.

    What rests on the object is ignored.
    """

    def __init__(
        self,
        objects: Sequence[ObjectModel],
        *,
        parameters: GripperParameters | None = None,
        config: JudgementConfig | None = None,
        gripper: GripperGeometry | None = None,
    ) -> None:
        """Builds the collision scene of these objects."""
        self.parameters = parameters or GripperParameters()
        self.config = config or JudgementConfig()
        self.gripper = gripper or load_gripper_geometry()
        self._objects = {model.name: model for model in objects}
        self.scene = GraspScene(
            objects,
            gripper=self.gripper,
            approach_distance=self.config.approach_distance,
            cup_standoff=self.config.cup_standoff,
        )
        tip = self.gripper.tip_length
        p = self.parameters
        x = (np.arange(3) - 1) * p.pad_width / 3
        z = tip - p.pad_height * (np.arange(6) + 0.5) / 6
        grid_x, grid_z = np.meshgrid(x, z, indexing="ij")
        self._pad = np.stack([grid_x.ravel(), grid_z.ravel()], axis=-1)
        fingers = self.gripper.closing != 0
        self._tip_y = float(
            np.ptp(
                [
                    self.gripper.lower[fingers][0, 1],
                    self.gripper.upper[fingers][0, 1],
                ]
            )
        )

    def opening(self, width: np.ndarray) -> np.ndarray:
        """Returns the (...) openings with which the jaw descends, m.

        Args:
            width: (...) distances of the contacts, m.
        """
        return np.minimum(
            width + 2 * self.config.clearance, self.parameters.opening
        )

    def floor_retreat(
        self, X_WG: np.ndarray, opening: np.ndarray | float
    ) -> np.ndarray:
        """Returns how far short of a pose the fingertips meet the floor, m.

        Negative where they would have to go further to meet it.

        Args:
            X_WG: (..., 4, 4) commanded poses of the jaw.
            opening: (...) distance of the pads, m.

        Returns:
            (...) array; inf where the approach does not descend.
        """
        half_x = 0.5 * self.parameters.pad_width
        half_y = 0.5 * np.asarray(opening) + self._tip_y
        lowest = (
            X_WG[..., 2, 3]
            + X_WG[..., 2, 2] * self.gripper.tip_length
            - np.abs(X_WG[..., 2, 0]) * half_x
            - np.abs(X_WG[..., 2, 1]) * half_y
        )
        descent = -X_WG[..., 2, 2]
        need = self.config.floor_clearance - lowest
        return np.where(descent > 0.1, need / np.maximum(descent, 0.1), np.inf)

    def jaw(
        self,
        name: str,
        poses: Mapping[str, np.ndarray],
        X_WG: np.ndarray,
        *,
        opening: float,
        friction: float,
        overtravel: float = 0.0,
    ) -> JudgedGrasp:
        """Judges a jaw grasp; ``scene.set_poses(poses)`` must have been called.

        Args:
            name: of the object.
            poses: 4×4 X_WO of the objects.
            X_WG: 4×4 pose of the jaw frame.
            opening: distance of the pads during the descent, m.
            friction: Coulomb coefficient between pads and object.
            overtravel: how far beyond X_WG the gripper is commanded, m.
        """
        retreat, hit = self._stop_jaw(X_WG, opening, -overtravel)
        if hit:
            return JudgedGrasp(0.0, f"jaw hits {hit}", X_WG)
        X_WG = _moved(X_WG, -retreat)

        model = self._objects[name]
        X_OG = np.linalg.inv(poses[name]) @ X_WG
        touched = self._close_pads(model, X_OG, opening)
        if touched is None:
            return JudgedGrasp(0.0, "a pad misses the object", X_WG)
        contacts, width, coverage = touched
        with self.scene.without(name):
            if self.scene.jaw_collides(X_WG, width):
                hit = ", ".join(self.scene.hit())
                return JudgedGrasp(0.0, f"jaw closes on {hit}", X_WG, width)

        weight = GRAVITY * model.mass
        gravity = poses[name][:3, :3].T @ DOWN
        # Two cones of force: no grasp holds more than this.
        bound = 2 * self.parameters.force * np.sqrt(1 + friction**2)
        holding = 0.0
        if weight < bound:
            holding = jaw_holding_force(
                contacts,
                model.p_OCom,
                gravity,
                friction=friction,
                force=self.parameters.force,
            )
        held = holding_quality(holding, weight)
        if held == 0.0:
            return JudgedGrasp(
                0.0,
                f"holds {holding:.2f} N, weighs {weight:.2f} N",
                X_WG,
                width,
                holding,
            )
        y = X_OG[:3, 1]
        cosine = min(-contacts[0].normal @ y, contacts[1].normal @ y)
        alignment = max(
            0.0,
            1.0 - np.arccos(min(1.0, cosine)) / np.arctan(max(friction, 1e-6)),
        )
        quality = held * (0.5 + 0.5 * alignment) * (0.5 + 0.5 * coverage)
        return JudgedGrasp(float(quality), "", X_WG, width, holding)

    def _stop_jaw(
        self, X_WG: np.ndarray, opening: float, start: float
    ) -> tuple[float, str]:
        """Returns how far short of the pose the jaw stops, at least ``start``.

        And what it hits if it would have to stop earlier than is allowed.
        """
        low = max(start, float(self.floor_retreat(X_WG, opening)))
        high = self.config.max_retreat
        if low > high:
            return high, "floor"
        if not self.scene.jaw_collides(_moved(X_WG, -low), opening):
            return low, ""
        if self.scene.jaw_collides(_moved(X_WG, -high), opening):
            return high, ", ".join(self.scene.hit()) or "bin"
        while high - low > 0.0005:
            middle = 0.5 * (low + high)
            if self.scene.jaw_collides(_moved(X_WG, -middle), opening):
                low = middle
            else:
                high = middle
        return high, ""

    def _close_pads(
        self, model: ObjectModel, X_OG: np.ndarray, opening: float
    ) -> tuple[tuple[PadContact, PadContact], float, float] | None:
        """Closes the pads until each touches the object.

        Returns:
            The contacts in O (the pad on the +y side first), the distance of
            the closed pads, m, and the touched share of the pad touched less;
            None if a pad finds nothing.
        """
        n = len(self._pad)
        origins = np.zeros((2 * n, 3))
        origins[:, [0, 2]] = np.tile(self._pad, (2, 1))
        origins[:n, 1], origins[n:, 1] = 0.5 * opening, -0.5 * opening
        sign = np.repeat([-1.0, 1.0], n)
        R, p = X_OG[:3, :3], X_OG[:3, 3]
        directions = sign[:, None] * R[:, 1]
        origins = origins @ R.T + p
        distance, face = cast_rays(model.visual, origins, directions)
        distance[distance > opening] = np.inf

        contacts, travel, coverage = [], 0.0, 1.0
        for side in (slice(0, n), slice(n, 2 * n)):
            d = distance[side]
            if not np.isfinite(d).any():
                return None
            touch = d <= d.min() + self.parameters.pad_compliance
            points = origins[side][touch] + (
                d[touch, None] * directions[side][touch]
            )
            normal = -model.visual.face_normals[face[side][touch]].mean(axis=0)
            area = (
                self.parameters.pad_width
                * self.parameters.pad_height
                * touch.mean()
            )
            contacts.append(
                PadContact(
                    point=points.mean(axis=0),
                    normal=normal / np.linalg.norm(normal),
                    torsion_radius=2 / 3 * np.sqrt(area / np.pi),
                )
            )
            travel += float(d.min())
            coverage = min(coverage, float(touch.mean()))
        width = max(0.0, opening - travel)
        return (contacts[0], contacts[1]), width, coverage

    def suction(
        self,
        name: str,
        poses: Mapping[str, np.ndarray],
        X_WG: np.ndarray,
        *,
        friction: float,
        overtravel: float = 0.0,
    ) -> JudgedGrasp:
        """Judges a suction grasp; ``scene.set_poses(poses)`` comes before.

        Args:
            name: of the object.
            poses: 4×4 X_WO of the objects.
            X_WG: 4×4 pose of the cup frame.
            friction: Coulomb coefficient between lip and object.
            overtravel: how far beyond X_WG the gripper is commanded, m.
        """
        p, config = self.parameters, self.config
        model = self._objects[name]
        X_OG = np.linalg.inv(poses[name]) @ X_WG
        seal = seal_cups(
            model.visual,
            X_OG[None],
            radius=p.cup_radius,
            tolerance=config.seal_tolerance,
            max_normal_angle=config.seal_angle,
        )
        if not seal.closed[0]:
            return JudgedGrasp(0.0, "cup does not seal", X_WG)
        nearest = float(seal.nearest[0])
        if nearest > overtravel + p.bellows_travel:
            return JudgedGrasp(0.0, "cup does not reach the object", X_WG)
        if nearest < -config.max_retreat - p.bellows_travel:
            return JudgedGrasp(0.0, "cup is stopped too early", X_WG)
        if seal.spread[0] > 2 * p.bellows_travel:
            return JudgedGrasp(0.0, "cup is too oblique", X_WG)

        X_WG = _moved(X_WG, nearest)
        if self.scene.suction_collides(X_WG):
            hit = ", ".join(self.scene.hit())
            return JudgedGrasp(0.0, f"suction tool hits {hit}", X_WG)

        z = seal.normal[0]
        x = X_OG[:3, 0] - (X_OG[:3, 0] @ z) * z
        x = x / np.linalg.norm(x)
        R_OC = np.stack([x, np.cross(z, x), z], axis=-1)
        gravity = poses[name][:3, :3].T @ DOWN
        holding = float(
            suction_holding_force(
                R_OC.T @ (model.p_OCom - seal.center[0]),
                R_OC.T @ gravity,
                friction=friction,
                vacuum_force=p.vacuum_force,
                cup_radius=p.cup_radius,
                elasticity=p.cup_elasticity,
            )
        )
        weight = GRAVITY * model.mass
        held = holding_quality(holding, weight)
        if held == 0.0:
            return JudgedGrasp(
                0.0,
                f"holds {holding:.2f} N, weighs {weight:.2f} N",
                X_WG,
                holding=holding,
            )
        evenness = 1.0 - float(seal.unevenness[0]) / config.seal_tolerance
        quality = held * (0.5 + 0.5 * evenness)
        return JudgedGrasp(quality, "", X_WG, holding=holding)
