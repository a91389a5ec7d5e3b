"""Adds Drake's RgbdSensor to a diagram, and tells what it is."""

import contextlib
import importlib
from collections.abc import Sequence

import numpy as np
from pydrake.common.value import Value
from pydrake.geometry import (
    LightParameter,
    MakeRenderEngineVtk,
    RenderEngine,
    RenderEngineVtkParams,
    SceneGraph,
)
from pydrake.math import RigidTransform
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantValueSource
from pydrake.systems.sensors import CameraConfig, RgbdSensor

from xray_drake.cell.cameras import check_renderer, pinhole_camera


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
