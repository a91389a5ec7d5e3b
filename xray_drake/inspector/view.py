"""A replayed search in Meshcat: heap, layers and caption of each step."""

from dataclasses import replace

from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform, RollPitchYaw

from xray_drake.drawing.meshcat_layers import (
    draw_text,
    look_at_bin,
    set_opacity,
)
from xray_drake.inspector.layers import ROOT, SnapshotLayers
from xray_drake.inspector.replay import Replay
from xray_drake.inspector.snapshot import Poses
from xray_drake.messages import Outcome
from xray_drake.scene.heap import Heap
from xray_drake.station.heap_station import build_heap_station
from xray_drake.station.scenario import Scenario

CAPTION = f"{ROOT}/caption"

_LINE = 0.016
"""Height of a line of the caption, m."""

_X_W_CAPTION = RigidTransform(RollPitchYaw(0.9, 0.0, 0.0), [-0.25, 0.23, 0.13])
"""Behind the bin, turned to who looks into it."""

_CAPTION_COLOR = (0.15, 0.17, 0.2)

STEP_TIME = 3.0
"""A step in a recording, s."""

_LAYERS_TIME = 2.4
"""So long of it the heap rests under its layers; then it moves on, s."""


def look_at_heap(meshcat: Meshcat) -> None:
    """Sets the camera; nearer than for a search, whose tote one wants to see.

    The controls cover the right of the page, so the heap is left of its middle.
    """
    look_at_bin(meshcat)
    meshcat.SetCameraPose(
        camera_in_world=[0.05, -0.20, 0.32], target_in_world=[0.06, 0.035, 0.02]
    )


VISUALIZER = "visualizer"
"""Where Drake's MeshcatVisualizer draws the station."""


class HeapStage:
    """Bin, tote and objects in Meshcat, without a simulation.

    A station of its own: what is shown does not disturb what is simulated.
    """

    def __init__(
        self, scenario: Scenario, heap: Heap, meshcat: Meshcat
    ) -> None:
        """Draws the heap; replaces what another stage drew.

        Args:
            scenario: of the station.
            heap: what lies in the bin.
            meshcat: where.
        """
        self._meshcat = meshcat
        meshcat.Delete(VISUALIZER)
        # No gripper is to be seen, so none need be in the plant.
        gripper = replace(scenario.gripper, execution="quasi_static")
        self._station, self._parts = build_heap_station(
            replace(scenario, gripper=gripper), heap, meshcat=meshcat
        )
        self._context = self._station.CreateDefaultContext()
        position = self._station.GetInputPort("gripper.position")
        drawn = [0.0] * position.size()
        drawn[0] = 1.0  # of the quaternion
        position.FixValue(self._context, drawn)
        self._station.ForcedPublish(self._context)
        meshcat.SetProperty(f"{VISUALIZER}/drawn", "visible", False)
        self._occluders = [model.name for model in heap.objects]

    def show(self, poses: Poses, *, time: float = 0.0) -> None:
        """Puts the objects where they were.

        Args:
            poses: of all objects.
            time: in a recording, s.
        """
        plant = self._parts.plant
        context = plant.GetMyMutableContextFromRoot(self._context)
        for name, X_WO in poses.items():
            joint = self._parts.objects[name].joint
            joint.SetPose(context, RigidTransform(X_WO))
        self._context.SetTime(time)
        self._station.ForcedPublish(self._context)

    def set_opacity(self, opacity: float) -> None:
        """Makes all but the target translucent: an x-ray view.

        Args:
            opacity: in [0, 1].
        """
        for name in self._occluders:
            set_opacity(self._meshcat, name, opacity)


class ReplayView:
    """Shows the steps of a replay, back and forth.

    Step k is the k-th decision; where the search has ended, one more step shows
    how.

    Attributes:
        replay: of which search.
        meshcat: where it is shown.
        layers: what is drawn over the heap.
    """

    def __init__(self, replay: Replay, meshcat: Meshcat) -> None:
        """Shows the first step.

        Args:
            replay: of which search.
            meshcat: where; an earlier view's drawings are replaced.
        """
        self.replay = replay
        self.meshcat = meshcat
        self._stage = HeapStage(replay.scenario, replay.heap, meshcat)
        self.layers = SnapshotLayers(meshcat, replay.snapshots)
        self._captions: set[int] = set()
        self._step = 0
        self.show(1)

    @property
    def num_steps(self) -> int:
        """Decisions, and the end if there is one."""
        return len(self.replay.snapshots) + self.replay.ended

    @property
    def step(self) -> int:
        """The step on show, from 1."""
        return self._step

    def show(self, step: int) -> None:
        """Shows a step; only what differs from the one before is sent.

        Args:
            step: from 1 to ``num_steps``.

        Raises:
            ValueError: there is no such step.
        """
        if not 1 <= step <= self.num_steps:
            raise ValueError(
                f"there is no step {step}: this search has {self.num_steps}, "
                "from 1"
            )
        self._stage.show(self._poses(step))
        self.layers.show(step)
        self._draw_caption(step)
        if self._step and self._step != step:
            self.meshcat.SetProperty(_caption(self._step), "visible", False)
        self.meshcat.SetProperty(_caption(step), "visible", True)
        self._step = step

    def set_heap_opacity(self, opacity: float) -> None:
        """Makes the distractors translucent, so that one sees the target.

        Args:
            opacity: in [0, 1].
        """
        self._stage.set_opacity(opacity)

    def record(self) -> None:
        """Draws all steps and records them: a static page can go through them.

        A heap without a search has one step, and nothing to be recorded.
        In the recording each step lasts three seconds; at its end the objects
        move to where they lie in the next.
        """
        shown = self._step
        meshcat = self.meshcat
        self.layers.draw_all()
        for step in range(1, self.num_steps + 1):
            self._draw_caption(step)
        if self.num_steps == 1:
            return
        meshcat.StartRecording(set_visualizations_while_recording=False)
        for step in range(1, self.num_steps + 1):
            start = STEP_TIME * (step - 1)
            rests = start + _LAYERS_TIME
            for time in (start, rests):
                self._stage.show(self._poses(step), time=time)
            if step <= len(self.replay.snapshots):
                for path in self.layers.paths(step):
                    self._record_visible(path, start, rests)
            self._record_visible(_caption(step), start, start + STEP_TIME)
        meshcat.StopRecording()
        meshcat.PublishRecording()
        self._step = 0
        self.show(shown)

    def describe(self, step: int) -> tuple[str, ...]:
        """Returns what there is to say of a step, in a few lines."""
        replay = self.replay
        record = replay.record
        title = (
            f"seed {record.seed}: {record.target} under "
            f"{len(record.objects)} objects"
        )
        total = len(replay.snapshots)
        if step > total:
            actions = "action" if total == 1 else "actions"
            end = record.end.replace("_", " ")
            return title, f"end: {end} after {total} {actions}"
        action = record.actions[step - 1]
        of = f" of {total}" if replay.ended else ""
        what = f"step {step}{of}, {record.policy}: "
        if action.grasp:
            name = "the target" if action.is_target else action.object
            what += (
                f"{name} by {action.grasp.kind.value}, quality "
                f"{action.grasp.quality:.2f}, score {action.score:.4g}"
            )
            if action.outcome is not Outcome.NONE:
                what += f": {action.outcome.value}"
        else:
            what += "no grasp found"
        return (
            title,
            what,
            f"target {action.target_visible_fraction:.0%} visible, support "
            f"{action.support_before} pixels",
        )

    def _poses(self, step: int) -> dict:
        shots = self.replay.snapshots
        if step <= len(shots):
            return dict(shots[step - 1].poses)
        last = shots[-1]
        return dict(last.poses_after or last.poses)

    def _draw_caption(self, step: int) -> None:
        if step not in self._captions:
            draw_text(
                self.meshcat,
                _caption(step),
                self.describe(step),
                _X_W_CAPTION,
                height=_LINE,
                color=_CAPTION_COLOR,
            )
            self._captions.add(step)
            self.meshcat.SetProperty(_caption(step), "visible", False)

    def _record_visible(self, path: str, start: float, end: float) -> None:
        last = STEP_TIME * (self.num_steps - 1) + _LAYERS_TIME
        # At the first and last moment, too: what has fewer keys than others
        # can be left as it was when the player jumps.
        for time in sorted({0.0, start, end, last}):
            if time <= last:
                self.meshcat.SetProperty(
                    path,
                    "visible",
                    start <= time < end,
                    time_in_recording=time,
                )


def _caption(step: int) -> str:
    return f"{CAPTION}/step_{step:02d}"
