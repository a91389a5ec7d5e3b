"""Contact sheets: many objects in one picture, each in a tile of its own.

Rays are cast at the surfaces themselves, so no graphics card, no screen and no
simulator is needed; a tile of 160 pixels takes some 50 ms.
"""

from collections.abc import Callable, Sequence

import cv2
import numpy as np
import trimesh

from xray_drake.scene.object_model import ObjectModel, shaded

BACKGROUND = np.array([0.97, 0.97, 0.965])
INK = (60, 60, 60)

CAPTION_HEIGHT = 30
"""Pixels under each tile: the name, and the longest side in mm."""

SUPERSAMPLING = 2

_AZIMUTH, _ELEVATION = np.deg2rad(-55), np.deg2rad(32)
_LIGHT = np.array([0.25, -0.55, 0.8]) / np.linalg.norm([0.25, -0.55, 0.8])


def object_picture(model: ObjectModel, size: int) -> np.ndarray:
    """Draws one object from the front, above and the side, filling the tile.

    Args:
        model: drawn with its body z-axis up, on a ground that takes a shadow.
        size: width and height of the picture, pixels.

    Returns:
        (size, size, 3) uint8 RGB.
    """
    mesh = shaded(model.visual)
    n = size * SUPERSAMPLING
    low, high = mesh.bounds
    center = (low + high) / 2
    toward = np.array(
        [
            np.cos(_ELEVATION) * np.cos(_AZIMUTH),
            np.cos(_ELEVATION) * np.sin(_AZIMUTH),
            np.sin(_ELEVATION),
        ]
    )
    right = np.cross((0, 0, 1), toward)
    right /= np.linalg.norm(right)
    up = np.cross(toward, right)
    seen = (np.asarray(mesh.vertices) - center) @ np.stack([right, up]).T
    middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
    half = 0.56 * np.ptp(seen, axis=0).max()
    steps = (np.arange(n) + 0.5) / n * 2 - 1
    u, v = np.meshgrid(middle[0] + half * steps, middle[1] - half * steps)
    radius = float(np.linalg.norm(high - low))
    starts = (
        center
        + radius * toward
        + u.reshape(-1, 1) * right
        + v.reshape(-1, 1) * up
    )
    picture = np.tile(BACKGROUND, (n * n, 1))
    caster = mesh.ray

    # The ground, and the shadow on it.
    down = (starts[:, 2] - low[2]) / toward[2]
    ground = starts - down[:, None] * toward
    dark = caster.intersects_any(
        ground + 1e-6 * radius * _LIGHT, np.tile(_LIGHT, (n * n, 1))
    )
    shadow = cv2.GaussianBlur(
        dark.reshape(n, n).astype(np.float32), (0, 0), 0.012 * n
    )
    picture *= 1 - 0.28 * shadow.reshape(-1, 1)

    faces = caster.intersects_first(starts, np.tile(-toward, (n * n, 1)))
    hit = faces >= 0
    flat = np.asarray(mesh.face_normals)[faces[hit]]
    triangles = np.asarray(mesh.triangles)[faces[hit]]
    away = np.einsum("ij,ij->i", triangles[:, 0] - starts[hit], flat)
    away = away / np.minimum(flat @ -toward, -1e-9)
    points = starts[hit] - away[:, None] * toward
    normals = _smooth_normals(mesh, faces[hit], triangles, points)
    lit = np.maximum(normals @ _LIGHT, 0)
    hidden = caster.intersects_any(
        points + 1e-3 * radius * (flat + 0.1 * toward),
        np.tile(_LIGHT, (len(points), 1)),
    )
    lit[hidden] *= 0.35
    facing = np.maximum(normals @ toward, 0)
    brightness = 0.34 + 0.5 * lit + 0.24 * facing
    picture[hit] = np.clip(
        brightness[:, None] * np.array(model.color[:3]), 0, 1
    )
    return cv2.resize(
        np.rint(picture.reshape(n, n, 3) * 255).astype(np.uint8),
        (size, size),
        interpolation=cv2.INTER_AREA,
    )


def contact_sheet(
    models: Sequence[ObjectModel | None],
    *,
    columns: int = 8,
    size: int = 160,
    progress: Callable[[], None] | None = None,
) -> np.ndarray:
    """Draws objects row by row, with their names and longest sides.

    Args:
        models: at least one; ``None`` leaves a place empty.
        columns: tiles in a row.
        size: width and height of a tile, pixels.
        progress: called before each tile.

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
        if progress is not None:
            progress()
        if model is None:
            continue
        y, x = i // columns * pitch, i % columns * size
        sheet[y : y + size, x : x + size] = object_picture(model, size)
        longest = f"{1000 * float(model.extents.max()):.0f} mm"
        _write(sheet, model.name, x, y + size + 10, size)
        _write(sheet, longest, x, y + size + 23, size)
    return sheet


def _smooth_normals(
    mesh: trimesh.Trimesh,
    faces: np.ndarray,
    triangles: np.ndarray,
    points: np.ndarray,
) -> np.ndarray:
    """Returns (n, 3) normals that vary over the faces like Drake's do."""
    if not len(faces):
        return np.zeros((0, 3))
    weights = trimesh.triangles.points_to_barycentric(triangles, points)
    corners = np.asarray(mesh.vertex_normals)[np.asarray(mesh.faces)[faces]]
    normals = np.einsum("ij,ijk->ik", np.clip(weights, 0, 1), corners)
    return normals / np.maximum(
        np.linalg.norm(normals, axis=1, keepdims=True), 1e-12
    )


def _write(
    sheet: np.ndarray, text: str, x: int, baseline: int, width: int
) -> None:
    """Writes a line of text in the middle of a tile."""
    font, scale = cv2.FONT_HERSHEY_SIMPLEX, 0.36
    (wide, _), _ = cv2.getTextSize(text, font, scale, 1)
    if wide > width - 4:
        scale *= (width - 4) / wide
        (wide, _), _ = cv2.getTextSize(text, font, scale, 1)
    place = (x + (width - wide) // 2, baseline)
    cv2.putText(sheet, text, place, font, scale, INK, 1, cv2.LINE_AA)
