"""Contact sheets: many objects in one picture, each in a tile of its own."""

from collections.abc import Callable, Sequence

import cv2
import numpy as np
from pydrake.common.schema import Transform
from pydrake.geometry import LightParameter
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraConfig

from xray_drake.scene.cameras import add_camera, make_renderer
from xray_drake.scene.object_model import ObjectModel
from xray_drake.scene.plant import add_object, add_plant, default_plant_config

BACKGROUND = np.array([0.97, 0.97, 0.965])
INK = (60, 60, 60)

CAPTION_HEIGHT = 30
"""Pixels under each tile: the name, and the longest side in mm."""

SUPERSAMPLING = 2

_R_WC = RollPitchYaw(np.deg2rad([-122, 0, 35])).ToRotationMatrix()
"""The camera looks from the front, the side and above."""

_FAR = 20.0
"""Distance of the camera, in diagonals of the object: it sees hardly any
perspective."""


_LIGHTS = [
    LightParameter(
        type="directional",
        frame="world",
        direction=[-0.2, 0.4, -0.9],
        intensity=0.7,
    ),
    LightParameter(type="point", frame="camera", intensity=0.55),
]


def object_picture(model: ObjectModel, size: int) -> np.ndarray:
    """Renders one object from the front, above and the side, filling the tile.

    Args:
        model: drawn with its body z-axis up.
        size: width and height of the picture, pixels.

    Returns:
        (size, size, 3) uint8 RGB.
    """
    n = size * SUPERSAMPLING
    low, high = model.visual.bounds
    diagonal = float(np.linalg.norm(high - low))
    seen = np.asarray(model.visual.vertices) @ _R_WC.matrix()
    near, far = seen.min(axis=0), seen.max(axis=0)
    p_C = [*((near + far) / 2)[:2], near[2] - _FAR * diagonal]
    half = 0.56 * (far - near)[:2].max()
    camera = CameraConfig(
        width=n,
        height=n,
        focal=CameraConfig.FocalLength(x=n / 2 * _FAR * diagonal / half),
        X_PB=Transform(RigidTransform(_R_WC, _R_WC @ p_C)),
    )
    builder = DiagramBuilder()
    plant, scene_graph = add_plant(builder, default_plant_config())
    add_object(plant, model, collides=False)
    plant.Finalize()
    renderer = make_renderer(BACKGROUND, _LIGHTS)
    scene_graph.AddRenderer(camera.renderer_name, renderer)
    sensor, _ = add_camera(builder, scene_graph, camera)
    context = builder.Build().CreateDefaultContext()
    image = sensor.color_image_output_port().Eval(
        sensor.GetMyContextFromRoot(context)
    )
    return cv2.resize(
        image.data[..., :3], (size, size), interpolation=cv2.INTER_AREA
    )


def contact_sheet(
    models: Sequence[ObjectModel | None],
    *,
    columns: int = 8,
    size: int = 160,
    progress: Callable[[int, int], None] | None = None,
) -> np.ndarray:
    """Draws objects row by row, with their names and longest sides.

    Args:
        models: at least one; ``None`` leaves a place empty.
        columns: tiles in a row.
        size: width and height of a tile, pixels.
        progress: told how many tiles are done, of how many.

    Returns:
        (height, width, 3) uint8 RGB.

    Raises:
        ValueError: no models.
    """
    if not models:
        raise ValueError("a contact sheet needs at least one object")
    columns = min(columns, len(models))
    rows = -(-len(models) // columns)
    pitch = size + CAPTION_HEIGHT
    sheet = np.full((rows * pitch, columns * size, 3), 255 * BACKGROUND)
    sheet = np.rint(sheet).astype(np.uint8)
    for i, model in enumerate(models):
        y, x = i // columns * pitch, i % columns * size
        if model is not None:
            sheet[y : y + size, x : x + size] = object_picture(model, size)
            longest = f"{1000 * float(model.extents.max()):.0f} mm"
            _write(sheet, model.name, x, y + size + 10, size)
            _write(sheet, longest, x, y + size + 23, size)
        if progress is not None:
            progress(i + 1, len(models))
    return sheet


def _write(
    sheet: np.ndarray, text: str, x: int, baseline: int, width: int
) -> None:
    """Writes a line of text in the middle of a tile."""
    font, scale = cv2.FONT_HERSHEY_SIMPLEX, 0.36
    (wide, _), _ = cv2.getTextSize(text, font, scale, 1)
    scale *= min(1.0, (width - 4) / wide)
    place = (x + (width - min(wide, width - 4)) // 2, baseline)
    cv2.putText(sheet, text, place, font, scale, INK, 1, cv2.LINE_AA)
