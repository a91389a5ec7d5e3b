"""Draws layers, outlines and grasps into Drake's Meshcat."""

import itertools

import numpy as np
from pydrake.geometry import Capsule, Cylinder, Meshcat, MeshcatParams, Rgba
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.perception import BaseField, Fields, PointCloud

from xray_drake.cell.gripper import GripperSpec, load_gripper
from xray_drake.drawing.colors import heat
from xray_drake.drawing.layers import color_layer, mask_outline, surface_depth
from xray_drake.drawing.primitives import Lines, Points
from xray_drake.drawing.text import text_mesh
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.messages import Grasp, GraspKind

CHOSEN = (1.0, 0.0, 0.7)
"""RGB of what is grasped next."""

_SRGB_GAMMA = 2.2
"""Meshcat takes colours of vertices and points as linear light, unlike all its
others."""

_OUTLINE_LIFT = 0.002
"""How far an outline hovers over the layer of colours, m."""

_MASK_GAP = 0.0015
"""How far masks hover over the objects, m."""

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


def look_at_bin(meshcat: Meshcat, *, from_afar: bool = False) -> None:
    """Sets the camera, and hides what hides the heap.

    Args:
        meshcat: whose camera.
        from_afar: the gripper over the bin and the whole tote are in view, too.
    """
    eye, middle = [0.06, -0.33, 0.47], [0.08, 0.03, 0.0]
    if from_afar:
        eye, middle = [0.27, -0.64, 0.60], [0.26, 0.06, 0.11]
    meshcat.SetCameraPose(camera_in_world=eye, target_in_world=middle)
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
    colors = np.where(values[..., None] > 0, heat(values), np.nan)
    layer = color_layer(colors, surface_depth(depth, camera), camera)
    _draw_colors(meshcat, path, layer, opacity)


def draw_masks(
    meshcat: Meshcat,
    path: str,
    labels: np.ndarray,
    colors: np.ndarray,
    depth: np.ndarray,
    camera: PinholeCamera,
    *,
    opacity: float = 0.8,
) -> None:
    """Draws instance masks as a translucent layer on the heap.

    Args:
        meshcat: where.
        path: of the layer; what was there is replaced.
        labels: (H, W) int; what is below 0 is not drawn.
        colors: (n, 3) RGB in [0, 1] of each label; NaN is not drawn.
        depth: (H, W) z-depth, m.
        camera: of both images.
        opacity: in [0, 1].
    """
    # Each mask lies on its own object alone, so it need not hover high.
    surface = surface_depth(depth, camera, reach=0, gap=_MASK_GAP)
    painted = np.vstack([colors, np.full(3, np.nan)])[labels]
    layer = color_layer(painted, surface, camera, labels=labels)
    _draw_colors(meshcat, path, layer, opacity)


def set_layer_opacity(meshcat: Meshcat, path: str, opacity: float) -> None:
    """Makes a layer of colours more or less translucent.

    Args:
        meshcat: where.
        path: of the layer.
        opacity: in [0, 1].
    """
    meshcat.SetProperty(f"{path}/<object>", "modulated_opacity", opacity)


def _draw_colors(
    meshcat: Meshcat,
    path: str,
    layer: tuple[np.ndarray, np.ndarray, np.ndarray],
    opacity: float,
) -> None:
    meshcat.Delete(path)
    vertices, faces, colors = layer
    if faces.shape[1]:
        meshcat.SetTriangleColorMesh(path, vertices, faces, colors**_SRGB_GAMMA)
        set_layer_opacity(meshcat, path, opacity)


def draw_outline(
    meshcat: Meshcat,
    path: str,
    mask: np.ndarray,
    depth: np.ndarray,
    camera: PinholeCamera,
    *,
    color: tuple[float, float, float] = CHOSEN,
    width: int = 1,
) -> None:
    """Draws the outline of a mask on the heap; see :func:`draw_occupancy`.

    Args:
        meshcat: where.
        path: of the layer; what was there is replaced.
        mask: (H, W) bool.
        depth: (H, W) z-depth, m.
        camera: of both images.
        color: RGB in [0, 1].
        width: of the band on either side of the mask's edge, pixels.
    """
    meshcat.Delete(path)
    vertices, faces = mask_outline(
        mask, surface_depth(depth, camera) - _OUTLINE_LIFT, camera, width=width
    )
    if faces.shape[1]:
        meshcat.SetTriangleMesh(path, vertices, faces, Rgba(*color))


def draw_points(meshcat: Meshcat, path: str, points: Points) -> None:
    """Draws points; what was at the path is replaced."""
    meshcat.Delete(path)
    if not len(points.positions):
        return
    cloud = PointCloud(
        len(points.positions), Fields(BaseField.kXYZs | BaseField.kRGBs)
    )
    cloud.mutable_xyzs()[:] = points.positions.T
    cloud.mutable_rgbs()[:] = np.rint(
        255 * points.colors.T**_SRGB_GAMMA
    ).astype(np.uint8)
    meshcat.SetObject(path, cloud, points.size)


def draw_lines(meshcat: Meshcat, path: str, lines: Lines) -> None:
    """Draws lines, one pixel wide; what was at the path is replaced."""
    meshcat.SetLineSegments(
        path, lines.ends[:, 0].T, lines.ends[:, 1].T, 2.0, Rgba(*lines.color)
    )


def draw_text(
    meshcat: Meshcat,
    path: str,
    lines: tuple[str, ...],
    X_WT: RigidTransform,
    *,
    height: float,
    color: tuple[float, float, float],
) -> None:
    """Draws lines of text; what was at the path is replaced.

    Args:
        meshcat: where.
        path: of the text.
        lines: one below the other.
        X_WT: pose of the text's lower left corner, x along the lines, y up.
        height: of a line, m.
        color: RGB in [0, 1].
    """
    meshcat.Delete(path)
    vertices, faces = text_mesh(lines, height)
    if faces.shape[1]:
        meshcat.SetTriangleMesh(path, vertices, faces, Rgba(*color))
        meshcat.SetTransform(path, X_WT)


def draw_grasp(
    meshcat: Meshcat,
    path: str,
    grasp: Grasp,
    *,
    color: tuple[float, float, float] = CHOSEN,
    radius: float = _ROD_RADIUS,
    gripper: GripperSpec | None = None,
) -> None:
    """Draws a grasp: the jaw as a fork, the cup as a disc on a stem.

    Args:
        meshcat: where.
        path: of the layer; what was there is replaced.
        grasp: of kind NONE, nothing is drawn.
        color: RGB in [0, 1].
        radius: of the rods, m.
        gripper: whose cup it is; by default the nominal cell's.
    """
    meshcat.Delete(path)
    if not grasp:
        return
    X, rgba = grasp.X_WG, Rgba(*color)
    length = 0.06
    if grasp.kind is GraspKind.SUCTION:
        points = np.array([[0, 0, -length], [0, 0, 0]], dtype=float)
        lip = (gripper or load_gripper()).cup_radius
        meshcat.SetObject(f"{path}/cup", Cylinder(lip, 0.003), rgba)
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
        meshcat.SetObject(rod, Capsule(radius, np.linalg.norm(along)), rgba)
        meshcat.SetTransform(
            rod,
            RigidTransform(
                RotationMatrix.MakeFromOneVector(along, 2), (a + b) / 2
            ),
        )
