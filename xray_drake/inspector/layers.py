"""Draws snapshots into Meshcat, as layers that can be switched on and off."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform, RollPitchYaw

from xray_drake.drawing.colors import heat, instance_colors
from xray_drake.drawing.meshcat_layers import (
    draw_grasp,
    draw_lines,
    draw_masks,
    draw_occupancy,
    draw_outline,
    draw_points,
    draw_text,
    set_layer_opacity,
)
from xray_drake.drawing.primitives import Lines, Points, frustum_lines
from xray_drake.geometry.readings import has_reading
from xray_drake.inspector.snapshot import Snapshot, ranking_lines

ROOT = "/inspect"

_TARGET_COLOR = (0.9, 0.05, 0.05)
_TARGET_LINE = 2
"""Half the width of the target's outline, pixels."""

_CAMERA_COLOR = (0.1, 0.3, 0.8)
_CANDIDATE_ROD = 0.001
"""Radius, m: thinner than the grasp that was chosen."""

_TEXT = 0.0115
"""Height of a line, m."""
_TEXT_COLOR = (0.15, 0.17, 0.2)

_POINT, _POINT_STEP = 0.002, 2
"""Size, m; of so many rows and columns one is drawn."""


@dataclass(frozen=True)
class Layer:
    """Something that is drawn of a snapshot.

    Attributes:
        name: at ``/inspect/NAME`` in Meshcat.
        draw: draws a snapshot's at a path.
        opacity: at first, in [0, 1]; 0 is off.
        translucent: it can be between on and off.
    """

    name: str
    draw: Callable[[Meshcat, str, Snapshot], None]
    opacity: float = 0.0
    translucent: bool = False


def mask_colors(shot: Snapshot) -> np.ndarray:
    """Returns (n, 3) RGB in [0, 1], one for each instance; the target is red.

    An instance that is called the same has the same colour in all snapshots of
    a search.
    """
    known = [name for name in shot.poses if name != shot.target]
    names = shot.instances.names
    order = known + [n for n in names if n not in known and n != shot.target]
    palette = instance_colors(len(order) + 2) / 255
    index = {name: k + 2 for k, name in enumerate(order)} | {shot.target: 1}
    return palette[[index[name] for name in names]].reshape(-1, 3)


def score_colors(shot: Snapshot) -> np.ndarray:
    """Returns (n, 3) RGB in [0, 1], one for each instance: its score as heat.

    NaN where an instance was no candidate.
    """
    scores = shot.relative_scores()
    names = shot.instances.names
    shares = np.array([scores.get(name, np.nan) for name in names])
    known = np.isfinite(shares)[:, None]
    return np.where(known, heat(np.nan_to_num(shares)), np.nan)


def seen_points(shot: Snapshot) -> Points:
    """Returns what perception sees as points in the world, in its colours."""
    drawn = np.zeros(shot.camera.shape, bool)
    drawn[::_POINT_STEP, ::_POINT_STEP] = True
    drawn &= has_reading(shot.seen_depth)
    return Points(
        shot.camera.unproject(shot.seen_depth)[drawn],
        shot.color[drawn] / 255,
        _POINT,
    )


def _draw_occupancy(meshcat: Meshcat, path: str, shot: Snapshot) -> None:
    values = shot.occupancy.supported()
    draw_occupancy(meshcat, path, values, shot.depth, shot.camera)


def _draw_instances(
    meshcat: Meshcat,
    path: str,
    shot: Snapshot,
    colors: Callable[[Snapshot], np.ndarray] = mask_colors,
) -> None:
    labels = shot.instances.labels
    draw_masks(meshcat, path, labels, colors(shot), shot.depth, shot.camera)


def _draw_silhouette(meshcat: Meshcat, path: str, shot: Snapshot) -> None:
    mask = shot.target_amodal
    # Flat, over all that covers it: on the heap it would climb up and down.
    covered = shot.depth[mask & has_reading(shot.depth)]
    flat = np.full_like(shot.depth, covered.min(initial=np.inf))
    draw_outline(
        meshcat,
        path,
        mask,
        flat,
        shot.camera,
        color=_TARGET_COLOR,
        width=_TARGET_LINE,
    )


def _draw_chosen(meshcat: Meshcat, path: str, shot: Snapshot) -> None:
    meshcat.Delete(path)
    outline = f"{path}/outline"
    draw_outline(meshcat, outline, shot.chosen, shot.depth, shot.camera)
    draw_grasp(
        meshcat, f"{path}/gripper", shot.action.grasp, gripper=shot.gripper
    )


def _draw_candidates(meshcat: Meshcat, path: str, shot: Snapshot) -> None:
    meshcat.Delete(path)
    for name, grasp in shot.grasps.items():
        if name != shot.action.grasp.object:
            r, g, b = heat(np.array(grasp.quality)).tolist()
            draw_grasp(
                meshcat,
                f"{path}/{name}",
                grasp,
                color=(r, g, b),
                radius=_CANDIDATE_ROD,
                gripper=shot.gripper,
            )


def _draw_camera(meshcat: Meshcat, path: str, shot: Snapshot) -> None:
    height = float(shot.camera.X_WC[2, 3])
    lines = Lines(frustum_lines(shot.camera, height), _CAMERA_COLOR)
    draw_lines(meshcat, path, lines)


def _draw_points(meshcat: Meshcat, path: str, shot: Snapshot) -> None:
    draw_points(meshcat, path, seen_points(shot))


def _draw_ranking(meshcat: Meshcat, path: str, shot: Snapshot) -> None:
    lines = ranking_lines(shot.action)
    x, y = np.array([-1, 1]) * shot.bin.half_size + [0.01, -0.002]
    # On the bin's far wall.
    X_WT = RigidTransform(RollPitchYaw(np.pi / 2, 0.0, 0.0), [x, y, 0.015])
    draw_text(meshcat, path, lines, X_WT, height=_TEXT, color=_TEXT_COLOR)


LAYERS = (
    Layer("occupancy", _draw_occupancy, 0.75, translucent=True),
    Layer("instances", _draw_instances, translucent=True),
    Layer(
        "scores",
        partial(_draw_instances, colors=score_colors),
        translucent=True,
    ),
    Layer("silhouette", _draw_silhouette, 1.0),
    Layer("grasp", _draw_chosen, 1.0),
    Layer("candidates", _draw_candidates),
    Layer("ranking", _draw_ranking, 1.0),
    Layer("camera", _draw_camera),
    Layer("points", _draw_points),
)
"""What there is to see of a decision:

- ``occupancy``: the distribution, over the heap;
- ``instances``: the modal masks in colours, the target's red;
- ``scores``: the same, coloured by the policy's score, dark (least) to yellow;
- ``silhouette``: the outline of the target's true amodal mask;
- ``grasp``: what is grasped next, and how;
- ``candidates``: the best grasp on each other candidate, coloured by quality;
- ``ranking``: the candidates' scores, and why some were passed over;
- ``camera``: its frustum, down to the floor;
- ``points``: the depth image as perception has it.
"""


SEARCH_LAYERS = tuple(
    layer for layer in LAYERS if layer.name in ("occupancy", "grasp", "ranking")
)
"""What is seen of a search while it goes on: nothing that only truth knows."""


class SnapshotLayers:
    """The layers of some snapshots in Meshcat.

    Layer L of step k is at ``/inspect/L/step_k``. It is drawn when it is first
    seen, and from then on only shown and hidden: going back costs nothing.
    Each step has a path of its own, too, since Meshcat's recordings animate
    visibility but not geometry.
    """

    def __init__(
        self,
        meshcat: Meshcat,
        snapshots: Sequence[Snapshot] = (),
        layers: Sequence[Layer] = LAYERS,
    ) -> None:
        """Draws nothing yet; deletes the layers of an earlier search.

        Args:
            meshcat: where.
            snapshots: of one search, in order.
            layers: what is drawn of them.
        """
        self._meshcat = meshcat
        self._layers = {layer.name: layer for layer in layers}
        self._snapshots = {shot.step: shot for shot in snapshots}
        self._opacity = {layer.name: layer.opacity for layer in layers}
        self._drawn: dict[str, float] = {}
        self._step = 0
        meshcat.Delete(ROOT)
        for name in self._layers:
            self._switch(name)

    @property
    def step(self) -> int:
        """The decision on show; 0 for none."""
        return self._step

    def add(self, shot: Snapshot) -> None:
        """Adds the snapshot of one more step; it is not yet shown."""
        self._snapshots[shot.step] = shot

    def show(self, step: int, *, time: float | None = None) -> None:
        """Shows a decision in place of the one before.

        Args:
            step: of the snapshot; where there is none, all layers are empty.
            time: in a recording, s.
        """
        if step != self._step:
            for path in self.paths(self._step):
                if path in self._drawn:
                    self._set_visible(path, False, time)
        self._step = step
        for name, path in zip(self._layers, self.paths(step), strict=True):
            if step in self._snapshots and self._opacity[name] > 0:
                if path not in self._drawn and time is not None:
                    self._set_visible(path, False, 0.0)
                self._draw(name, step)
                self._set_visible(path, True, time)

    def set_opacity(self, name: str, opacity: float) -> None:
        """Switches a layer on or off, or makes it translucent.

        Args:
            name: of the layer.
            opacity: in [0, 1]; 0 is off.

        Raises:
            ValueError: there is no such layer.
        """
        if name not in self._layers:
            raise ValueError(f"no layer {name!r}: {', '.join(self._layers)}")
        self._opacity[name] = opacity
        self._switch(name)
        self.show(self._step)

    def opacity(self, name: str) -> float:
        """Returns a layer's opacity; 0 is off."""
        return self._opacity[name]

    def draw_all(self) -> None:
        """Draws all layers of all steps; what is switched off stays so."""
        for step in self._snapshots:
            for name, path in zip(self._layers, self.paths(step), strict=True):
                self._draw(name, step)
                self._set_visible(path, step == self._step)

    def paths(self, step: int) -> list[str]:
        """Returns where the layers of a step are."""
        return [f"{ROOT}/{name}/step_{step:02d}" for name in self._layers]

    def _set_visible(
        self, path: str, visible: bool, time: float | None = None
    ) -> None:
        self._meshcat.SetProperty(
            path, "visible", visible, time_in_recording=time
        )

    def _switch(self, name: str) -> None:
        self._set_visible(f"{ROOT}/{name}", self._opacity[name] > 0)

    def _draw(self, name: str, step: int) -> None:
        layer, path = self._layers[name], f"{ROOT}/{name}/step_{step:02d}"
        opacity = self._opacity[name] or layer.opacity or 1.0
        if path not in self._drawn:
            layer.draw(self._meshcat, path, self._snapshots[step])
        if layer.translucent and self._drawn.get(path) != opacity:
            set_layer_opacity(self._meshcat, path, opacity)
        self._drawn[path] = opacity
