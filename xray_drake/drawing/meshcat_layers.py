"""Draws layers, outlines and grasps into Drake's Meshcat."""

import itertools

import numpy as np
from pydrake.geometry import Capsule, Cylinder, Meshcat, MeshcatParams, Rgba
from pydrake.math import RigidTransform, RotationMatrix

from xray_drake.drawing.layers import heat_layer, mask_outline, surface_depth
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.messages import Grasp, GraspKind

_CHOSEN = Rgba(1.0, 0.0, 0.7, 1.0)

_SRGB_GAMMA = 2.2
"""Meshcat takes vertex colours as linear light, unlike all its others."""

_OUTLINE_LIFT = 0.002
"""How far an outline hovers over the layer of colours, m."""

_ROD_RADIUS = 0.002
"""m."""


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
        camera_in_world=[0.06, -0.33, 0.47], target_in_world=[0.08, 0.03, 0.0]
    )
    for path in ("/Grid", "/Axes"):
        meshcat.SetProperty(path, "visible", False)
    meshcat.SetProperty("/Background", "top_color", [0.93, 0.95, 0.97])
    meshcat.SetProperty("/Background", "bottom_color", [0.99, 0.99, 0.99])


def set_opacity(meshcat: Meshcat, name: str, opacity: float) -> None:
    """Makes an object of the plant translucent: an x-ray view.

    Args:
        meshcat: shows the station, which has been published.
        name: of the object, which is its model instance's and its body's.
        opacity: in [0, 1]; 1 as it was.

    Raises:
        ValueError: no such object is shown.
    """
    path = f"visualizer/{name}/{name}/{name}/visual"
    if not meshcat.HasPath(path):
        raise ValueError(
            f"Meshcat shows no object {name!r}: publish the diagram first "
            "(ForcedPublish), and see diagram.station.objects for the names"
        )
    meshcat.SetProperty(path, "modulated_opacity", opacity)


def draw_occupancy(
    meshcat: Meshcat,
    path: str,
    values: np.ndarray,
    depth: np.ndarray,
    camera: PinholeCamera,
    *,
    opacity: float = 0.8,
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
        meshcat.SetTriangleColorMesh(path, vertices, faces, colors**_SRGB_GAMMA)
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
    vertices, faces = mask_outline(
        mask, surface_depth(depth, camera) - _OUTLINE_LIFT, camera
    )
    if faces.shape[1]:
        meshcat.SetTriangleMesh(path, vertices, faces, _CHOSEN)


def draw_grasp(meshcat: Meshcat, path: str, grasp: Grasp) -> None:
    """Draws a grasp: the jaw as a fork, the cup as a disc on a stem."""
    meshcat.Delete(path)
    if not grasp:
        return
    X = grasp.X_WG
    length = 0.06
    if grasp.kind is GraspKind.SUCTION:
        points = np.array([[0, 0, -length], [0, 0, 0]], dtype=float)
        meshcat.SetObject(f"{path}/cup", Cylinder(0.015, 0.003), _CHOSEN)
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
    # Not lines: browsers draw them one pixel wide.
    points = points @ X[:3, :3].T + X[:3, 3]
    for index, (a, b) in enumerate(itertools.pairwise(points)):
        along = b - a
        rod = f"{path}/rod_{index}"
        meshcat.SetObject(
            rod, Capsule(_ROD_RADIUS, np.linalg.norm(along)), _CHOSEN
        )
        meshcat.SetTransform(
            rod,
            RigidTransform(
                RotationMatrix.MakeFromOneVector(along, 2), (a + b) / 2
            ),
        )
