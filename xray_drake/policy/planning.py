"""Planning grasps at one look: from models and poses, or from depth."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.readings import has_reading
from xray_drake.grasping.evidence.depth import SeenObject
from xray_drake.grasping.planner import GraspPlanner
from xray_drake.messages import (
    Grasp,
    GraspPlan,
    InstanceMasks,
    Message,
    freeze_arrays,
)
from xray_drake.policy.ranking import Planning
from xray_drake.policy.removal import Removal

PLACE_RADIUS = 0.04
"""What is seen this near to a grasp, across the view, is its place, m."""

PLACE_CHANGE = 0.003
"""A reading that differs by more has changed, m: more than a sensor's noise,
less than the thinnest target."""

PLACE_SHARE = 0.05
"""A place has changed if this share of it has: a square of 16 mm."""


Poses = Mapping[str, np.ndarray]
"""Object name to its 4×4 X_WO, m."""


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
        freeze_arrays(self, place=float)


def _each_once(
    plan: Callable[[str, Collection[str]], GraspPlan],
) -> Planning:
    """Returns a planning that remembers what it has planned."""
    known: dict[tuple[str, frozenset[str]], GraspPlan] = {}

    def planned(name: str, *, without: Collection[str] = ()) -> GraspPlan:
        key = name, frozenset(without)
        if key not in known:
            known[key] = plan(*key)
        return known[key]

    return planned


def planning_on_models(
    planner: GraspPlanner[Poses], poses: Poses, failed: Sequence[FailedGrasp]
) -> Planning:
    """Returns what plans on models at their poses, each object once.

    An object keeps its name and its shape: what failed on it is excluded for
    good, wherever it lies.

    Args:
        planner: finds grasps.
        poses: object name to its 4×4 X_WO.
        failed: all grasps that failed before.
    """

    def plan(name: str, without: Collection[str]) -> GraspPlan:
        return planner.plan(
            name,
            {n: X for n, X in poses.items() if n not in without},
            excluded=[f.grasp for f in failed if f.grasp.object == name],
        )

    return _each_once(plan)


def planning_on_images(
    planner: GraspPlanner[SeenObject],
    instances: InstanceMasks,
    depth: np.ndarray,
    camera: PinholeCamera,
    failed: Sequence[FailedGrasp],
) -> Planning:
    """Returns what plans on what is seen, each instance once.

    The name of an instance means nothing in the next image. So what failed is
    excluded by its place, on whatever is seen there, until the place has
    changed (:func:`still_there`). Objects are removed hypothetically as a
    :class:`~xray_drake.policy.removal.Removal` does.

    Args:
        planner: finds grasps.
        instances: masks of what may be grasped.
        depth: (H, W) float32 z-depth, m; 0, inf and NaN are no reading.
        camera: of both.
        failed: the grasps that failed and whose place has not changed.
    """

    def plan(name: str, without: Collection[str]) -> GraspPlan:
        image = depth
        for other in sorted(without):
            removal = Removal(image, camera)
            image, _ = removal.without(instances.mask(other))
        seen = SeenObject(instances.mask(name), image, camera)
        return planner.plan(name, seen, excluded=[f.grasp for f in failed])

    return _each_once(plan)


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
