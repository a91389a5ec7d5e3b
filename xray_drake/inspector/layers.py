"""Draws snapshots into Meshcat, as layers that can be switched on and off."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Meshcat

from xray_drake.drawing.colors import heat
from xray_drake.drawing.meshcat_layers import (
    draw_grasp,
    draw_lines,
    draw_masks,
    draw_occupancy,
    draw_outline,
    draw_points,
    set_layer_opacity,
)
from xray_drake.drawing.primitives import Lines, Points, frustum_lines
from xray_drake.drawing.sample_figure import instance_colors
from xray_drake.geometry.readings import has_reading
from xray_drake.inspector.snapshot import Snapshot

ROOT = "/inspect"

_TARGET_COLOR = (0.9, 0.05, 0.05)
_TARGET_LINE = 2
"""Half the width of the target's outline, pixels."""

_CAMERA_COLOR = (0.1, 0.3, 0.8)
_CANDIDATE_ROD = 0.001
"""Radius, m: thinner than the grasp that was chosen."""

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


def _draw_occupancy(meshcat: Meshcat, path: str, shot: Snapshot) -> None:
    values = shot.occupancy.supported()
    draw_occupancy(meshcat, path, values, shot.depth, shot.camera)


def _draw_instances(meshcat: Meshcat, path: str, shot: Snapshot) -> None:
    draw_masks(
        meshcat,
        path,
        shot.instances.labels,
        mask_colors(shot),
        shot.depth,
        shot.camera,
    )


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


def _draw_scores(meshcat: Meshcat, path: str, shot: Snapshot) -> None:
    draw_masks(
        meshcat,
        path,
        shot.instances.labels,
        score_colors(shot),
        shot.depth,
        shot.camera,
    )


def score_colors(shot: Snapshot) -> np.ndarray:
    """Returns (n, 3) RGB in [0, 1], one for each instance: its score as heat.

    NaN where an instance was no candidate.
    """
    scores = shot.relative_scores()
    colors = np.full((len(shot.instances.names), 3), np.nan)
    for index, name in enumerate(shot.instances.names):
        if name in scores:
            colors[index] = heat(np.array(scores[name]))
    return colors


def _draw_silhouette(meshcat: Meshcat, path: str, shot: Snapshot) -> None:
    mask = shot.target_amodal
    # Flat, over all that covers it: on the heap it would climb up and down.
    covered = shot.depth[mask & has_reading(shot.depth)]
    draw_outline(
        meshcat,
        path,
        mask,
        np.full_like(shot.depth, covered.min() if covered.size else np.inf),
        shot.camera,
        color=_TARGET_COLOR,
        width=_TARGET_LINE,
    )


def _draw_chosen(meshcat: Meshcat, path: str, shot: Snapshot) -> None:
    meshcat.Delete(path)
    grasp = shot.action.grasp
    if grasp.object in shot.instances.names:
        mask = shot.instances.mask(grasp.object)
        draw_outline(meshcat, f"{path}/outline", mask, shot.depth, shot.camera)
    draw_grasp(meshcat, f"{path}/gripper", grasp)


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
            )


def _draw_camera(meshcat: Meshcat, path: str, shot: Snapshot) -> None:
    height = float(shot.camera.X_WC[2, 3])
    lines = Lines(frustum_lines(shot.camera, height), _CAMERA_COLOR)
    draw_lines(meshcat, path, lines)


def _draw_points(meshcat: Meshcat, path: str, shot: Snapshot) -> None:
    draw_points(meshcat, path, seen_points(shot))


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


LAYERS = (
    Layer("occupancy", _draw_occupancy, 0.75, translucent=True),
    Layer("instances", _draw_instances, translucent=True),
    Layer("scores", _draw_scores, translucent=True),
    Layer("silhouette", _draw_silhouette, 1.0),
    Layer("grasp", _draw_chosen, 1.0),
    Layer("candidates", _draw_candidates),
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
- ``camera``: its frustum, down to the floor;
- ``points``: the depth image as perception has it.
"""


class SnapshotLayers:
    """The layers of some snapshots in Meshcat.

    Layer L of step k is at ``/inspect/L/step_k``. It is drawn when it is first
    seen, and from then on only shown and hidden: going back costs nothing.
    """

    def __init__(self, meshcat: Meshcat, snapshots: Sequence[Snapshot]) -> None:
        """Draws nothing yet; deletes the layers of an earlier search.

        Args:
            meshcat: where.
            snapshots: of one search, in order.
        """
        self._meshcat = meshcat
        self._snapshots = {shot.step: shot for shot in snapshots}
        self._opacity = {layer.name: layer.opacity for layer in LAYERS}
        self._drawn: dict[str, float] = {}
        self._step = 0
        meshcat.Delete(ROOT)
        for layer in LAYERS:
            self._switch(layer)

    @property
    def step(self) -> int:
        """The decision on show; 0 for none."""
        return self._step

    def show(self, step: int) -> None:
        """Shows a decision in place of the one before.

        Args:
            step: of the snapshot; where there is none, all layers are empty.
        """
        for layer in LAYERS:
            before = _path(layer, self._step)
            if self._step != step and before in self._drawn:
                self._meshcat.SetProperty(before, "visible", False)
        self._step = step
        for layer in LAYERS:
            if step in self._snapshots and self._opacity[layer.name] > 0:
                self._draw(layer, step)
                self._meshcat.SetProperty(_path(layer, step), "visible", True)

    def set_opacity(self, name: str, opacity: float) -> None:
        """Switches a layer on or off, or makes it translucent.

        Args:
            name: of the layer.
            opacity: in [0, 1]; 0 is off.

        Raises:
            ValueError: there is no such layer.
        """
        known = {layer.name: layer for layer in LAYERS}
        if name not in known:
            raise ValueError(f"no layer {name!r}: {', '.join(known)}")
        layer = known[name]
        self._opacity[name] = opacity
        self._switch(layer)
        self.show(self._step)

    def opacity(self, name: str) -> float:
        """Returns a layer's opacity; 0 is off."""
        return self._opacity[name]

    def draw_all(self) -> None:
        """Draws all layers of all steps; what is switched off stays so."""
        for layer in LAYERS:
            for step in self._snapshots:
                self._draw(layer, step)
                self._meshcat.SetProperty(
                    _path(layer, step), "visible", step == self._step
                )

    def paths(self, step: int) -> list[str]:
        """Returns where the layers of a step are."""
        return [_path(layer, step) for layer in LAYERS]

    def _switch(self, layer: Layer) -> None:
        self._meshcat.SetProperty(
            f"{ROOT}/{layer.name}", "visible", self._opacity[layer.name] > 0
        )

    def _draw(self, layer: Layer, step: int) -> None:
        path, opacity = _path(layer, step), self._opacity[layer.name]
        opacity = opacity if opacity > 0 else layer.opacity or 1.0
        if path not in self._drawn:
            layer.draw(self._meshcat, path, self._snapshots[step])
        if layer.translucent and self._drawn.get(path) != opacity:
            set_layer_opacity(self._meshcat, path, opacity)
        self._drawn[path] = opacity


def _path(layer: Layer, step: int) -> str:
    return f"{ROOT}/{layer.name}/step_{step:02d}"
