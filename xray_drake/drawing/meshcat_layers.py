"""Draws layers, outlines and grasps into Drake's Meshcat."""

import numpy as np
from pydrake.geometry import Cylinder, Meshcat, MeshcatParams, Rgba
from pydrake.math import RigidTransform

from xray_drake.drawing.layers import heat_layer, mask_outline, surface_depth
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.messages import Grasp, GraspKind

_YELLOW = Rgba(1.0, 0.9, 0.1, 1.0)
_CYAN = Rgba(0.0, 0.85, 0.9, 0.9)


def start_meshcat(port: int | None = None) -> Meshcat:
    """Starts a Meshcat that only this machine can reach.

    Args:
        port: to listen on; by default the first that is free from 7000.

    Raises:
        RuntimeError: the port is taken.
    """
    params = MeshcatParams(host="localhost", show_stats_plot=False)
    if port is not None:
        params.port = port
    return Meshcat(params)


def look_at_bin(meshcat: Meshcat) -> None:
    """Sets the camera, and hides what hides the heap."""
    meshcat.SetCameraPose(
        camera_in_world=[0.15, -0.75, 0.65], target_in_world=[0.1, 0.0, 0.0]
    )
    for path in ("/Grid", "/Axes"):
        meshcat.SetProperty(path, "visible", False)
    meshcat.SetProperty("/Background", "top_color", [0.93, 0.95, 0.97])
    meshcat.SetProperty("/Background", "bottom_color", [0.99, 0.99, 0.99])


def draw_occupancy(
    meshcat: Meshcat,
    path: str,
    values: np.ndarray,
    depth: np.ndarray,
    camera: PinholeCamera,
    *,
    opacity: float = 0.6,
) -> None:
    """Draws a distribution as a translucent layer on the heap.

    Args:
        meshcat: where.
        path: of the layer; what was there is replaced.
        values: (H, W) in [0, 1].
        depth: (H, W) z-depth, m.
        camera: of both images.
        opacity: in [0, 1].
    """
    meshcat.Delete(path)
    vertices, faces, colors = heat_layer(
        values, surface_depth(depth, camera), camera
    )
    if faces.shape[1]:
        meshcat.SetTriangleColorMesh(path, vertices, faces, colors)
        meshcat.SetProperty(f"{path}/<object>", "modulated_opacity", opacity)


def draw_outline(
    meshcat: Meshcat,
    path: str,
    mask: np.ndarray,
    depth: np.ndarray,
    camera: PinholeCamera,
) -> None:
    """Draws the outline of a mask on the heap; see :func:`draw_occupancy`."""
    meshcat.Delete(path)
    starts, ends = mask_outline(mask, surface_depth(depth, camera), camera)
    if starts.shape[1]:
        meshcat.SetLineSegments(path, starts, ends, 4.0, _YELLOW)


def draw_grasp(meshcat: Meshcat, path: str, grasp: Grasp) -> None:
    """Draws a grasp: the jaw as a fork, the cup as a disc on a stem."""
    meshcat.Delete(path)
    if not grasp:
        return
    X = grasp.X_WG
    length = 0.06
    if grasp.kind is GraspKind.SUCTION:
        points = np.array([[0, 0, -length], [0, 0, 0]], dtype=float)
        meshcat.SetObject(f"{path}/cup", Cylinder(0.015, 0.003), _CYAN)
        meshcat.SetTransform(f"{path}/cup", RigidTransform(X))
    else:
        half = grasp.width / 2
        points = np.array(
            [
                [0, -half, 0],
                [0, -half, -length],
                [0, half, -length],
                [0, half, 0],
            ]
        )
    line = (points @ X[:3, :3].T + X[:3, 3]).T
    meshcat.SetLine(f"{path}/line", line, 6.0, _CYAN)
