"""Adds Drake's RgbdSensor to a diagram, and tells what it is."""

import contextlib
import copy
import importlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.common.schema import Rotation, Transform
from pydrake.common.value import Value
from pydrake.geometry import (
    LightParameter,
    MakeRenderEngineVtk,
    RenderEngine,
    RenderEngineVtkParams,
    Rgba,
    SceneGraph,
)
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantValueSource
from pydrake.systems.sensors import CameraConfig, RgbdSensor

from xray_drake.configuration import number
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.scene.plant import BIN_FLOOR_X, BIN_FLOOR_Y

_PIXEL_CENTER = 0.5
"""In the images that RenderEngineVtk draws, pixel i spans [i, i + 1] of the
config's coordinates: its centre is at i + 0.5. (Measured on Drake 1.51.1 and
1.58.0: masks lie half a pixel up and left of what the config's principal point
says of pixels with centres at integers.)"""


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
    K[:2, 2] -= _PIXEL_CENTER
    return PinholeCamera(
        width=config.width,
        height=config.height,
        intrinsics=K,
        X_WC=(X_WB @ X_BC).GetAsMatrix4(),
    )


@dataclass
class CameraSampling:
    """How cameras are drawn around the nominal one (PROTOCOL.md, "Scene").

    All are uniform; the position is on a part of a sphere about the middle of
    the bin's floor, and the camera looks there.
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
    # Straight down, image x along world x; then tilted in the direction of
    # the azimuth, which leaves image x close to world x, then rolled.
    axis = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    R_WC = (
        RotationMatrix(AngleAxis(angle, axis))
        @ RotationMatrix(RollPitchYaw(np.pi, 0, 0))
        @ RotationMatrix.MakeZRotation(roll)
    )
    p_WC = -radius * R_WC.col(2)
    config.X_PB = Transform(RigidTransform(R_WC, p_WC))
    config.focal = CameraConfig.FocalLength(x=focal, y=focal)
    center = nominal.principal_point()
    config.center_x = center[0] + shift[0]
    config.center_y = center[1] + shift[1]
    return config


def check_view(config: CameraConfig) -> None:
    """Checks that a camera sees the bin's floor, within the sensor's range.

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
    depth = camera.plane_depth(0.0)
    x, y, _ = np.moveaxis(camera.unproject(depth), 2, 0)
    seen = depth[
        (x > BIN_FLOOR_X[0])
        & (x < BIN_FLOOR_X[1])
        & (y > BIN_FLOOR_Y[0])
        & (y < BIN_FLOOR_Y[1])
    ]
    if camera.X_WC[2, 3] <= 0 or not seen.size:
        raise ValueError(
            "X_PB: the camera does not look at the bin's floor (z = 0). It "
            "looks along its z axis: straight down is "
            "rotation: !Rpy {deg: [180, 0, 0]}"
        )
    if seen.min() > config.z_far or seen.max() < config.z_near:
        raise ValueError(
            f"the bin's floor is {seen.min():.3g} to {seen.max():.3g} m away, "
            f"out of the sensor's range: z_near is {config.z_near}, z_far is "
            f"{config.z_far}"
        )


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


def make_renderer(
    background: np.ndarray, lights: Sequence[LightParameter]
) -> RenderEngine:
    """Returns a RenderEngineVtk.

    Torch for CUDA brings Triton, which has an LLVM of its own. Imported after
    software Mesa has loaded another LLVM it crashes the process (Triton 3.7.1,
    LLVM 15), so it is imported before, where there is one.

    Args:
        background: (3,) its colour, red, green, blue in [0, 1].
        lights: of the scene.
    """
    with contextlib.suppress(ImportError):
        importlib.import_module("triton")
    return MakeRenderEngineVtk(
        RenderEngineVtkParams(
            default_clear_color=background, lights=list(lights)
        )
    )


def add_renderer(scene_graph: SceneGraph, config: CameraConfig) -> None:
    """Adds the render engine that a camera asks for, once.

    Software Mesa serves where there is no GPU; no display is needed.

    Raises:
        ValueError: the engine is not RenderEngineVtk.
    """
    check_renderer(config)
    if not scene_graph.HasRenderer(config.renderer_name):
        color = config.background
        engine = make_renderer(
            np.array([color.r(), color.g(), color.b()]), _lights()
        )
        scene_graph.AddRenderer(config.renderer_name, engine)


def _lights() -> list[LightParameter]:
    """A headlight alone leaves the bin's walls black."""
    slanted = [
        LightParameter(
            type="directional",
            frame="world",
            direction=[x, y, -1.0],
            intensity=0.28,
        )
        for x, y in ((0.8, 0.5), (-0.8, 0.5), (0.0, -0.9))
    ]
    return [
        LightParameter(type="directional", frame="camera", intensity=0.4),
        *slanted,
    ]


def add_camera(
    builder: DiagramBuilder, scene_graph: SceneGraph, config: CameraConfig
) -> tuple[RgbdSensor, ConstantValueSource]:
    """Adds a camera fixed to the world.

    ``ApplyCameraConfig`` is not used: it renders every period, whether
    anybody looks or not.

    Returns:
        The sensor, whose images are rendered when they are asked for, and a
        source of its :class:`PinholeCamera`.
    """
    add_renderer(scene_graph, config)
    color, depth = config.MakeCameras()
    sensor = builder.AddSystem(
        RgbdSensor(
            parent_id=scene_graph.world_frame_id(),
            X_PB=RigidTransform(config.X_PB.GetDeterministicValue()),
            color_camera=color,
            depth_camera=depth,
        )
    )
    sensor.set_name(config.name)
    builder.Connect(
        scene_graph.get_query_output_port(), sensor.query_object_input_port()
    )
    model = builder.AddSystem(
        ConstantValueSource(Value(pinhole_camera(config)))
    )
    model.set_name(f"{config.name}_camera")
    return sensor, model
