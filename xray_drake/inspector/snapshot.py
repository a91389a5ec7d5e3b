"""What is shown of one decision of a search: data alone."""

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from pydrake.systems.framework import Context

from xray_drake.cell.bin import Bin
from xray_drake.cell.gripper import GripperSpec
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.silhouette import project_mesh_mask
from xray_drake.messages import (
    Grasp,
    InstanceMasks,
    OccupancyDistribution,
    SearchAction,
)
from xray_drake.perception.ground_truth import target_instance
from xray_drake.policy.system import SearchPolicy
from xray_drake.search.diagram import SearchDiagram
from xray_drake.search.monitor import Observer
from xray_drake.search.record import ActionRecord

_LINE_LENGTH = 72
"""Characters."""

Poses = Mapping[str, np.ndarray]
"""Object name to its 4×4 X_WO, m."""


@dataclass(frozen=True, eq=False)
class Snapshot:
    """A heap at rest, what was seen of it, and what the policy decided.

    Attributes:
        action: the decision, with ranking, scores and grasp.
        poses: of all objects, the removed ones included.
        camera: of all images.
        bin: in which the heap lies.
        gripper: that grasps.
        color: (H, W, 3) uint8 RGB.
        depth: (H, W) float32 z-depth as it is, m.
        seen_depth: the same as perception has it, with noise where there is.
        instances: modal masks.
        occupancy: where the target can be.
        target: what the target is called among ``instances``; empty where it
            is not seen.
        target_amodal: (H, W) bool, the target as if it lay alone: the truth.
        grasps: candidate to the best grasp on it: that of ``action``, and those
            of the candidates that were ranked highest.
        poses_after: of all objects when the action had ended; None where it was
            not executed.
        record: of the action, when it had ended.
    """

    action: SearchAction
    poses: Poses
    camera: PinholeCamera
    bin: Bin
    gripper: GripperSpec
    color: np.ndarray
    depth: np.ndarray
    seen_depth: np.ndarray
    instances: InstanceMasks
    occupancy: OccupancyDistribution
    target: str
    target_amodal: np.ndarray
    grasps: Mapping[str, Grasp] = field(default_factory=dict)
    poses_after: Poses | None = None
    record: ActionRecord | None = None

    @property
    def chosen(self) -> np.ndarray:
        """The (H, W) bool mask of what is grasped next; blank for nothing."""
        name = self.action.grasp.object
        if name not in self.instances.names:
            return np.zeros(self.depth.shape, bool)
        return self.instances.mask(name)

    @property
    def step(self) -> int:
        """Number of the decision, from 1."""
        return self.action.number

    def relative_scores(self) -> dict[str, float]:
        """Returns the candidates' scores, scaled from 0 (least) to 1 (most).

        Where all are equal, all are 1.
        """
        action = self.action
        if not action.ranking:
            return {}
        scores = np.array([c.score for c in action.ranking], float)
        low, high = scores.min(), scores.max()
        shares = (scores - low) / (high - low) if high > low else scores**0
        names = [candidate.name for candidate in action.ranking]
        return dict(zip(names, shares.tolist(), strict=True))


def ranking_lines(action: SearchAction, *, most: int = 6) -> tuple[str, ...]:
    """Tells a ranking: places, scores, and why candidates were passed over.

    Args:
        action: the decision.
        most: candidates; of those after the one grasped none needs be told.

    Returns:
        A line or, where the reason is long, several for each candidate.
    """
    lines: list[str] = []
    for place, candidate in enumerate(action.ranking[:most], 1):
        line = f"{place}. {candidate.name}, score {candidate.score:.4g}"
        if candidate.passed_over:
            line += f": {candidate.passed_over}"
        elif candidate.name == action.grasp.object:
            line += f": by {action.grasp.kind.value}"
        lines += textwrap.wrap(line, _LINE_LENGTH, subsequent_indent="    ")
    more = len(action.ranking) - most
    return (*lines, f"and {more} more") if more > 0 else tuple(lines)


def take_snapshot(
    diagram: SearchDiagram,
    context: Context,
    action: SearchAction,
    *,
    candidates: int = 0,
) -> Snapshot:
    """Looks at a search that has just decided.

    Args:
        diagram: the search.
        context: its root context.
        action: the decision.
        candidates: so many of the ranking are planned for; a grasp costs some
            tenths of a second.
    """
    name, target = diagram.scenario.camera.name, diagram.heap.target

    def look(port: str) -> Any:
        return diagram.GetOutputPort(port).Eval(context)

    noisy = diagram.HasSubsystemNamed("depth_sensor")
    seen = "depth_sensor.depth_image" if noisy else f"{name}.depth_image"
    camera: PinholeCamera = look(f"{name}.camera")
    poses = _poses(diagram, context)
    instances: InstanceMasks = look("instance_segmenter.instances")
    policy = diagram.GetSubsystemByName("search_policy")
    grasps: dict[str, Grasp] = {}
    if candidates and isinstance(policy, SearchPolicy):
        grasps = policy.grasps(
            policy.GetMyContextFromRoot(context),
            [c.name for c in action.ranking[:candidates]],
        )
    if action.grasp:
        grasps[action.grasp.object] = action.grasp
    return Snapshot(
        action=action,
        poses=poses,
        camera=camera,
        bin=diagram.scenario.cell.bin,
        gripper=diagram.scenario.cell.gripper.spec,
        color=np.array(look(f"{name}.color_image").data[:, :, :3]),
        depth=np.array(look(f"{name}.depth_image").data[:, :, 0]),
        seen_depth=np.array(look(seen).data[:, :, 0]),
        instances=instances,
        occupancy=look("occupancy_inference.occupancy"),
        target=target_instance(instances, look("target_detector.target_mask")),
        target_amodal=project_mesh_mask(
            target.visual.vertices,
            target.visual.faces,
            poses[target.name],
            camera,
        ),
        grasps=grasps,
    )


def _poses(diagram: SearchDiagram, context: Context) -> Poses:
    body_poses = diagram.GetOutputPort("cheat.body_poses").Eval(context)
    return {
        name: body_poses[int(item.body.index())].GetAsMatrix4()
        for name, item in diagram.station.objects.items()
    }


class SnapshotRecorder(Observer):
    """An observer that takes a snapshot of each decision.

    Attributes:
        snapshots: so far.
    """

    def __init__(self, *, candidates: int = 0) -> None:
        """Begins without snapshots.

        Args:
            candidates: see :func:`take_snapshot`.
        """
        self.snapshots: list[Snapshot] = []
        self._candidates = candidates

    def decided(
        self, diagram: SearchDiagram, context: Context, action: SearchAction
    ) -> None:
        """Takes one."""
        self.snapshots.append(
            take_snapshot(diagram, context, action, candidates=self._candidates)
        )

    def ended(
        self, diagram: SearchDiagram, context: Context, record: ActionRecord
    ) -> None:
        """Adds how the action ended, and where the objects are then."""
        self.snapshots[-1] = replace(
            self.snapshots[-1],
            poses_after=_poses(diagram, context),
            record=record,
        )
