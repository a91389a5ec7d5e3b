"""The overhead camera: the nominal one, cameras drawn around it, and its lens.

Cameras are Drake's ``CameraConfig``; what perception and planning need of one
is its :class:`~xray_drake.geometry.camera.PinholeCamera`.
"""

import copy
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.common.schema import Rotation, Transform
from pydrake.geometry import Rgba
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.systems.sensors import CameraConfig

from xray_drake.configuration import in_order, number
from xray_drake.faults import BREAKDOWNS
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.floor_grid import Floor

PIXEL_CENTER = 0.5
"""In the images that RenderEngineVtk draws, pixel i spans [i, i + 1] of the
config's coordinates: its centre is at i + 0.5. (Measured on Drake 1.51.1 and
1.58.0: masks lie half a pixel up and left of what the config's principal point
says of pixels with centres at integers.)"""

_LOOKS = 48
"""Rows and columns of pixels that are asked for what they see."""


def nominal_camera() -> CameraConfig:
    """Returns the overhead camera of PROTOCOL.md.

    Nominal Photoneo PhoXi S intrinsics scaled to 512×384, 0.8 m above the
    floor, straight down, image x along world x.
    """
    return CameraConfig(
        name="overhead",
        width=512,
        height=384,
        focal=CameraConfig.FocalLength(x=552.5, y=552.5),
        center_x=255.5,
        center_y=191.5,
        X_PB=Transform(
            base_frame="world",
            translation=[0.0, 0.0, 0.8],
            rotation=Rotation(value=Rotation.Rpy(deg=[180.0, 0.0, 0.0])),
        ),
        z_near=0.1,
        z_far=3.0,
        clipping_near=0.05,
        clipping_far=5.0,
        renderer_class="RenderEngineVtk",
        label=True,
        background=Rgba(0.25, 0.27, 0.30),
    )


_USUAL_DISTANCE = 0.8
"""Of the nominal camera from the middle of the floor, m."""

LENS = ("focal", "center_x", "center_y")
"""Of a ``CameraConfig``; what is not given of them follows its size."""


def sized(
    tree: Mapping[str, Any], usual: CameraConfig | None = None
) -> dict[str, Any]:
    """Gives a camera of another size the lens of the usual one, scaled.

    Its view is as wide, its pixels are square.

    Args:
        tree: keys and values of a ``CameraConfig``; it is left as it is.
        usual: the camera that it replaces; by default the nominal one.

    Returns:
        The same, where a size is given with what is missing of the lens.
    """
    nominal = usual or nominal_camera()
    width = tree.get("width", nominal.width)
    height = tree.get("height", nominal.height)
    given = "width" in tree or "height" in tree
    if not (given and isinstance(width, int) and isinstance(height, int)):
        return dict(tree)
    center = nominal.principal_point()
    focal = nominal.focal_x() * width / nominal.width
    return {
        "focal": {"x": focal, "y": focal},
        "center_x": float(center[0]) * width / nominal.width,
        "center_y": float(center[1]) * height / nominal.height,
        **tree,
    }


def pinhole_camera(config: CameraConfig) -> PinholeCamera:
    """Returns the camera that a config describes.

    Its pixel centres are at integers, so its principal point is half a pixel
    less than the config's.

    Raises:
        ValueError: the camera is not fixed to the world.
    """
    frame = config.X_PB.base_frame
    if frame not in (None, "", "world"):
        raise ValueError(
            f"camera {config.name!r} is fixed to {frame!r}: only cameras "
            "fixed to the world are supported"
        )
    color, _ = config.MakeCameras()
    X_WB = RigidTransform(config.X_PB.GetDeterministicValue())
    X_BC = color.core().sensor_pose_in_camera_body()
    K = np.array(color.core().intrinsics().intrinsic_matrix())
    K[:2, 2] -= PIXEL_CENTER
    return PinholeCamera(
        width=config.width,
        height=config.height,
        intrinsics=K,
        X_WC=(X_WB @ X_BC).GetAsMatrix4(),
    )


@dataclass
class CameraSampling:
    """How cameras are drawn around the cell's (PROTOCOL.md, "Scene").

    All are uniform; the position is on a part of a sphere about the middle of
    the bin's floor, and the camera looks there. The numbers are those for the
    nominal camera: with a camera farther away, of a longer focal length or of
    larger images, distances, focal lengths and shifts grow with it.
    """

    # Draw them at all; otherwise the nominal camera is used.
    enabled: bool = False
    # Distance from the middle of the floor, m.
    least_radius: float = number(0.7, "(0, 10]")
    most_radius: float = number(0.9, "(0, 10]")
    # Angle from the vertical, degrees.
    most_angle: float = number(10.0, "[0, 80]")
    # Turn about the viewing axis, degrees to either side.
    roll: float = number(10.0, "[0, 180]")
    # Focal length of both axes, pixels.
    least_focal: float = number(535.0, "(0, 100000]")
    most_focal: float = number(560.0, "(0, 100000]")
    # Shift of the principal point from the nominal one in u and v, pixels to
    # either side.
    center_shift: float = number(3.0, "[0, 10000]")

    def complaints(self) -> Iterator[str]:
        """Yields what is wrong between its fields."""
        yield from in_order(self, "least_radius", "most_radius")
        yield from in_order(self, "least_focal", "most_focal")


def sample_camera(
    nominal: CameraConfig, sampling: CameraSampling, rng: np.random.Generator
) -> CameraConfig:
    """Draws a camera.

    Args:
        nominal: gives all that is not drawn.
        sampling: the ranges.
        rng: source of randomness.

    Returns:
        A config of its own; where sampling is off, a copy of the nominal one.
    """
    config = copy.deepcopy(nominal)
    if not sampling.enabled:
        return config
    radius = rng.uniform(sampling.least_radius, sampling.most_radius)
    angle = np.deg2rad(rng.uniform(0, sampling.most_angle))
    azimuth = rng.uniform(0, 2 * np.pi)
    roll = np.deg2rad(rng.uniform(-sampling.roll, sampling.roll))
    focal = rng.uniform(sampling.least_focal, sampling.most_focal)
    shift = rng.uniform(-sampling.center_shift, sampling.center_shift, 2)
    # As the nominal one looks, then tilted in the direction of the azimuth,
    # which leaves image x where it was, nearly, then rolled.
    X_WN = RigidTransform(nominal.X_PB.GetDeterministicValue())
    R_WN = RotationMatrix(RollPitchYaw(np.pi, 0, 0))
    if not (X_WN.rotation().inverse() @ R_WN).IsNearlyIdentity(1e-9):
        R_WN = X_WN.rotation()
    usual, distance = nominal_camera(), np.linalg.norm(X_WN.translation())
    axis = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    R_WC = (
        RotationMatrix(AngleAxis(angle, axis))
        @ R_WN
        @ RotationMatrix.MakeZRotation(roll)
    )
    p_WC = -radius * (distance / _USUAL_DISTANCE) * R_WC.col(2)
    config.X_PB = Transform(RigidTransform(R_WC, p_WC))
    longer = nominal.focal_x() / usual.focal_x()
    config.focal = CameraConfig.FocalLength(x=longer * focal, y=longer * focal)
    center = nominal.principal_point()
    shift *= nominal.width / usual.width
    config.center_x = center[0] + shift[0]
    config.center_y = center[1] + shift[1]
    return config


def check_view(config: CameraConfig, seen: Floor) -> None:
    """Checks that a camera sees a floor, within the sensor's range.

    Args:
        config: the camera.
        seen: the inside of the bin's floor.

    Raises:
        ValueError: it does not, or its depth images are of another place than
            its colour images.
        RuntimeError: its pose is not one pose, or its lens is none.
    """
    X_BC, X_BD = (
        RigidTransform(X.GetDeterministicValue())
        for X in (config.X_BC, config.X_BD)
    )
    if not X_BC.IsNearlyEqualTo(X_BD, 1e-12):
        raise ValueError(
            "X_BD is not X_BC: depth and colour are taken to be one camera's"
        )
    camera = pinhole_camera(config)
    rows, columns = (
        np.linspace(0, side - 1, min(side, _LOOKS)) for side in camera.shape
    )
    u, v = np.meshgrid(columns, rows)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ camera.pixel_to_ray.T
    C = camera.X_WC[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = -C[2] / rays[..., 2]
        x, y = (C[i] + depth * rays[..., i] for i in (0, 1))
        floor = (
            (depth > 0)
            & (x > seen.x[0])
            & (x < seen.x[1])
            & (y > seen.y[0])
            & (y < seen.y[1])
        )
    if C[2] <= 0 or not floor.any():
        raise ValueError(
            "X_PB: the camera does not look at the bin's floor (z = 0). It "
            "looks along its z axis: straight down is "
            "rotation: !Rpy {deg: [180, 0, 0]}"
        )
    away = depth[floor]
    if away.min() > config.z_far or away.max() < config.z_near:
        raise ValueError(
            f"the bin's floor is {away.min():.3g} to {away.max():.3g} m away, "
            f"out of the sensor's range: z_near is {config.z_near}, z_far is "
            f"{config.z_far}"
        )


def camera_complaints(
    config: CameraConfig, seen: Floor | None = None
) -> Iterator[str]:
    """Yields what is wrong between the fields of a camera.

    Args:
        config: the camera.
        seen: the inside of the bin's floor, of the camera that must see it.
    """
    for said in in_order(
        config, "clipping_near", "z_near", "z_far", "clipping_far"
    ):
        yield f".{said}"
    try:
        check_renderer(config)
        if seen is None:
            pinhole_camera(config)
        else:
            check_view(config, seen)
    except (*BREAKDOWNS, ValueError) as error:
        yield f": {' '.join(str(error).split())}"


def check_renderer(config: CameraConfig) -> None:
    """Checks that a camera's render engine is one that is supported.

    Raises:
        ValueError: it is not RenderEngineVtk.
    """
    if config.renderer_class not in ("", "RenderEngineVtk"):
        raise ValueError(
            f"camera {config.name!r} asks for {config.renderer_class!r}: "
            "only RenderEngineVtk runs without a display"
        )
