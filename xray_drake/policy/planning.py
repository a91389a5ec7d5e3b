"""Planning grasps at one look: from models and poses, or from depth."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.readings import has_reading
from xray_drake.grasping.planner import GraspPlanner
from xray_drake.messages import Grasp, GraspPlan, InstanceMasks, Message
from xray_drake.policy.removal import Removal

PLACE_RADIUS = 0.04
"""What is seen this near to a grasp, across the view, is its place, m."""

PLACE_CHANGE = 0.003
"""A reading that differs by more has changed, m: more than a sensor's noise,
less than the thinnest target."""

PLACE_SHARE = 0.05
"""A place has changed if this share of it has: a square of 16 mm."""


class SeenGraspPlanner(Protocol):
    """Anything that plans a grasp on an object of which only an image is known.

    The counterpart of :class:`~xray_drake.grasping.planner.GraspPlanner`.
    """

    def plan(
        self,
        object_name: str,
        mask: np.ndarray,
        depth: np.ndarray,
        camera: PinholeCamera,
        *,
        excluded: Sequence[Grasp] = (),
    ) -> GraspPlan:
        """Returns the best grasp found, or why there is none.

        Args:
            object_name: what the grasp is called to be of.
            mask: (H, W) bool, what is seen of the object.
            depth: (H, W) z-depth, m; 0 where there is no reading.
            camera: of both images.
            excluded: grasps by their poses in the world, whatever object they
                are called of.
        """


@dataclass(frozen=True, eq=False)
class FailedGrasp(Message):
    """A grasp that failed, and where.

    Attributes:
        grasp: as planned.
        place: (n, 3) points seen around it when it was planned, in the world,
            m; none where planning reads no images.
    """

    grasp: Grasp
    place: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))

    def __post_init__(self) -> None:
        place = np.array(self.place, dtype=float)
        place.setflags(write=False)
        object.__setattr__(self, "place", place)


class ModelPlanning:
    """Plans on models at their poses, each object once.

    An object keeps its name and its shape: what failed on it is excluded for
    good, wherever it lies.
    """

    def __init__(
        self,
        planner: GraspPlanner,
        poses: Mapping[str, np.ndarray],
        failed: Sequence[FailedGrasp],
    ) -> None:
        """Takes what is known of the heap.

        Args:
            planner: finds grasps.
            poses: object name to its 4×4 X_WO.
            failed: all grasps that failed before.
        """
        self._planner = planner
        self._poses = poses
        self._failed = [f.grasp for f in failed]
        self._known: dict[tuple[str, frozenset[str]], GraspPlan] = {}

    def __call__(
        self, name: str, *, without: Collection[str] = ()
    ) -> GraspPlan:
        """Plans a grasp; see :class:`xray_drake.policy.ranking.Planning`."""
        key = name, frozenset(without)
        if key not in self._known:
            self._known[key] = self._planner.plan(
                name,
                {n: X for n, X in self._poses.items() if n not in key[1]},
                excluded=[g for g in self._failed if g.object == name],
            )
        return self._known[key]


class DepthPlanning:
    """Plans on what is seen, each instance once.

    The name of an instance means nothing in the next image. So what failed is
    excluded by its place, on whatever is seen there, until the place has
    changed (:func:`still_there`). Objects are thought away as a
    :class:`~xray_drake.policy.removal.Removal` does.
    """

    def __init__(
        self,
        planner: SeenGraspPlanner,
        instances: InstanceMasks,
        depth: np.ndarray,
        camera: PinholeCamera,
        failed: Sequence[FailedGrasp],
    ) -> None:
        """Takes what is seen.

        Args:
            planner: finds grasps.
            instances: masks of what may be grasped.
            depth: (H, W) float32 z-depth, m; 0, inf and NaN are no reading.
            camera: of both.
            failed: the grasps that failed and whose place has not changed.
        """
        self._planner = planner
        self._instances = instances
        self._depth = depth
        self._camera = camera
        self._failed = [f.grasp for f in failed]
        self._known: dict[tuple[str, frozenset[str]], GraspPlan] = {}

    def __call__(
        self, name: str, *, without: Collection[str] = ()
    ) -> GraspPlan:
        """Plans a grasp; see :class:`xray_drake.policy.ranking.Planning`."""
        key = name, frozenset(without)
        if key not in self._known:
            depth = self._depth
            for other in sorted(key[1]):
                removal = Removal(depth, self._camera)
                depth, _ = removal.without(self._instances.mask(other))
            self._known[key] = self._planner.plan(
                name,
                self._instances.mask(name),
                depth,
                self._camera,
                excluded=self._failed,
            )
        return self._known[key]


def place_of(
    grasp: Grasp, depth: np.ndarray, camera: PinholeCamera
) -> np.ndarray:
    """Returns the (n, 3) points seen around a grasp, in the world, m.

    Args:
        grasp: its origin is the middle; one of kind NONE has no place.
        depth: (H, W) z-depth, m; 0, inf and NaN are no reading.
        camera: of the image.
    """
    if not grasp:
        return np.zeros((0, 3))
    read = has_reading(depth)
    points = camera.unproject(np.where(read, depth, 1.0).astype(float))
    R, p = camera.X_WC[:3, :3], grasp.X_WG[:3, 3]
    across = (points - p) @ R[:, :2]
    return points[read & (np.hypot(*np.moveaxis(across, -1, 0)) < PLACE_RADIUS)]


def still_there(
    failed: FailedGrasp, depth: np.ndarray, camera: PinholeCamera
) -> bool:
    """Says whether the heap around a grasp looks as it did when it failed.

    The points of its place are looked for in the image. Those without a
    reading say nothing.

    Args:
        failed: the grasp and its place.
        depth: (H, W) z-depth, m; 0, inf and NaN are no reading.
        camera: of the image.
    """
    if len(failed.place) == 0:
        return True
    u, v, z = camera.project(failed.place).T
    column = np.rint(np.nan_to_num(u, nan=-1.0)).astype(int)
    row = np.rint(np.nan_to_num(v, nan=-1.0)).astype(int)
    height, width = depth.shape
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    now = depth[row[inside], column[inside]]
    read = has_reading(now)
    if not read.any():
        return False
    changed = np.abs(now[read] - z[inside][read]) > PLACE_CHANGE
    return bool(changed.mean() < PLACE_SHARE)
