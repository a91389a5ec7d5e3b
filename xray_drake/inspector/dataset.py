"""Shows samples of a dataset in Meshcat, Drake's or the one from PyPI."""

from typing import Protocol

import numpy as np

from xray_drake.dataset.sample import Sample
from xray_drake.drawing.colors import heat, instance_colors
from xray_drake.drawing.primitives import (
    Lines,
    Points,
    box_lines,
    frustum_lines,
)

_FRUSTUM = 0.1
"""Depth at which the camera's frustum ends, m."""

_CAMERA_COLOR = (0.1, 0.3, 0.8)
_TARGET_COLOR = (1.0, 0.0, 0.7)
_OCCUPANCY_LIFT = 0.001
"""How far the distribution hovers over the floor, m."""

_SCENE_POINT, _OCCUPANCY_POINT = 0.0015, 0.002
"""Size of the points, m."""

_SCENE_STEP = 2
"""Of so many rows and columns one is drawn: the heap is see-through."""

_EYE, _LOOK_AT = (0.06, -0.33, 0.47), (0.08, 0.03, 0.0)
"""Of the browser's camera in the world, m; as in ``look_at_bin``."""


class Viewer(Protocol):
    """A Meshcat of either kind."""

    @property
    def url(self) -> str:
        """Where a browser finds it."""
        ...

    def show(self, path: str, layer: Points | Lines) -> None:
        """Replaces what is at the path."""
        ...


def sample_layers(sample: Sample) -> dict[str, Points | Lines]:
    """Returns what is drawn of a sample.

    Returns:
        - ``scene``: the depth image, coloured by instance, the target's
          pixels and some of the others;
        - ``occupancy``: the distribution on the bin floor, under the heap;
        - ``camera``: its frustum;
        - ``target``: the bounding box where the target is.
    """
    camera = sample.camera
    drawn = np.array(sample.target_modal)
    drawn[::_SCENE_STEP, ::_SCENE_STEP] = True
    drawn &= sample.depth > 0
    colors = instance_colors(int(sample.instances.max()) + 1) / 255
    floor = camera.plane_depth(_OCCUPANCY_LIFT)
    likely = (sample.occupancy > 0) & np.isfinite(floor)
    return {
        "scene": Points(
            camera.unproject(sample.depth)[drawn],
            colors[sample.instances[drawn]],
            _SCENE_POINT,
        ),
        "occupancy": Points(
            camera.unproject(floor)[likely],
            heat(sample.occupancy[likely]),
            _OCCUPANCY_POINT,
        ),
        "camera": Lines(frustum_lines(camera, _FRUSTUM), _CAMERA_COLOR),
        "target": Lines(
            box_lines(sample.X_WT, sample.target_size), _TARGET_COLOR
        ),
    }


def show_sample(viewer: Viewer, sample: Sample) -> None:
    """Replaces what the viewer shows by a sample."""
    for name, layer in sample_layers(sample).items():
        viewer.show(f"sample/{name}", layer)


def start_viewer() -> Viewer:
    """Starts Drake's Meshcat, or where Drake is missing the one from PyPI.

    Raises:
        RuntimeError: there is neither.
    """
    try:
        return DrakeViewer()
    except ImportError:
        pass
    try:
        return PyPIViewer()
    except ImportError as error:
        raise RuntimeError(
            "there is no Meshcat: install one with 'pip install meshcat'"
        ) from error


class DrakeViewer:
    """Drake's Meshcat; only this machine can reach it."""

    def __init__(self) -> None:
        from xray_drake.drawing.meshcat_layers import (
            look_at_bin,
            start_meshcat,
        )

        self.meshcat = start_meshcat()
        look_at_bin(self.meshcat)

    @property
    def url(self) -> str:
        """Where a browser finds it."""
        return self.meshcat.web_url()

    def show(self, path: str, layer: Points | Lines) -> None:
        """Replaces what is at the path."""
        from xray_drake.drawing.meshcat_layers import draw_lines, draw_points

        if isinstance(layer, Lines):
            draw_lines(self.meshcat, path, layer)
        else:
            draw_points(self.meshcat, path, layer)


class PyPIViewer:
    """The ``meshcat`` package; its server listens on all interfaces."""

    def __init__(self) -> None:
        import meshcat

        self.meshcat = meshcat.Visualizer()
        for path in ("/Grid", "/Axes"):
            self.meshcat[path].set_property("visible", False)
        center = np.eye(4)
        center[:3, 3] = _LOOK_AT
        self.meshcat["/Cameras/default"].set_transform(center)
        x, y, z = np.subtract(_EYE, _LOOK_AT).tolist()
        self.meshcat["/Cameras/default/rotated/<object>"].set_property(
            "position", [x, z, -y]
        )
        for key in ("top_color", "bottom_color"):
            self.meshcat["/Background"].set_property(key, [0.95, 0.96, 0.97])

    @property
    def url(self) -> str:
        """Where a browser finds it."""
        return self.meshcat.url()

    def show(self, path: str, layer: Points | Lines) -> None:
        """Replaces what is at the path."""
        from meshcat import geometry

        node = self.meshcat[path]
        if isinstance(layer, Lines):
            color = int.from_bytes(
                bytes(round(255 * value) for value in layer.color), "big"
            )
            node.set_object(
                geometry.LineSegments(
                    geometry.PointsGeometry(
                        layer.ends.reshape(-1, 3).T.astype(np.float32)
                    ),
                    geometry.LineBasicMaterial(color=color),
                )
            )
            return
        node.delete()
        if len(layer.positions):
            node.set_object(
                geometry.PointCloud(
                    layer.positions.T.astype(np.float32),
                    layer.colors.T.astype(np.float32),
                    size=layer.size,
                )
            )
