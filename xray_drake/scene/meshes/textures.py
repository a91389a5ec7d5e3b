"""Textures of mesh files, off red."""

from dataclasses import replace

import cv2
import numpy as np
import trimesh

from xray_drake.scene.meshes.formats.images import image_of
from xray_drake.scene.object_model import TexturedMesh

LARGEST_TEXTURE = 512
"""Pixels a side; an object covers fewer in the station's images."""

RED_HUE = 25.0
"""° either side of red that belong to targets."""

RED_SATURATION = 0.25
"""Colours less saturated are grey to a red detector."""

HUE_SHIFTS = (120.0, 180.0, 240.0, 60.0, 300.0)
"""°, tried in turn on what is red."""

_SAMPLES = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4]]) / [
    [3],
    [6],
    [6],
    [6],
]
"""Barycentric coordinates of the points of a triangle whose colours count."""


def read_texture(mesh: trimesh.Trimesh) -> TexturedMesh | None:
    """Returns a mesh with its texture, never red in the mean.

    Args:
        mesh: as read.

    Returns:
        Vertices in the mesh's frame; ``None`` if it has no image or no texture
        coordinates.
    """
    uv, image = getattr(mesh.visual, "uv", None), _image(mesh)
    if uv is None or image is None or len(uv) != len(mesh.vertices):
        return None
    if not np.isfinite(uv).all():
        return None
    textured = TexturedMesh(
        vertices=np.asarray(mesh.vertices, dtype=np.float32),
        faces=np.asarray(mesh.faces, dtype=np.int32),
        uv=np.asarray(uv, dtype=np.float32),
        image=image,
    )
    return off_red(textured)


def mean_color(textured: TexturedMesh) -> np.ndarray:
    """Returns the (3,) mean red, green, blue in [0, 1] over the surface."""
    corners = textured.vertices[textured.faces].astype(float)
    areas = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]),
        axis=1,
    )
    height, width = textured.image.shape[:2]
    places = np.einsum("sk,fkx->fsx", _SAMPLES, textured.uv[textured.faces])
    u, v = np.moveaxis(places % 1, 2, 0)
    columns = np.minimum((u * width).astype(int), width - 1)
    rows = np.minimum(((1 - v) * height).astype(int), height - 1)
    colors = textured.image[rows, columns].mean(axis=1) / 255
    return np.average(colors, axis=0, weights=np.maximum(areas, 1e-15))


def is_red(color: np.ndarray) -> bool:
    """Says whether a colour would pass for a target's.

    Args:
        color: (3,) red, green, blue in [0, 1].
    """
    hue, saturation, _ = _hsv(np.asarray(color, dtype=np.float32)[None, None])[
        0, 0
    ]
    off = min(hue, 360 - hue)
    return bool(off < RED_HUE and saturation > RED_SATURATION)


def off_red(textured: TexturedMesh) -> TexturedMesh:
    """Turns the hues of a texture whose mean is red; others stay as they are.

    Targets are the only red things in a heap.
    """
    if not is_red(mean_color(textured)):
        return textured
    for shift in HUE_SHIFTS:
        shifted = replace(textured, image=hue_shifted(textured.image, shift))
        if not is_red(mean_color(shifted)):
            return shifted
    return shifted


def hue_shifted(image: np.ndarray, degrees: float) -> np.ndarray:
    """Turns the hue of an (h, w, 3) uint8 RGB image."""
    hsv = _hsv(image.astype(np.float32) / 255)
    hsv[..., 0] = (hsv[..., 0] + degrees) % 360
    rgb = cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)
    return np.rint(rgb * 255).clip(0, 255).astype(np.uint8)


def _hsv(rgb: np.ndarray) -> np.ndarray:
    """Hue in [0, 360), saturation and value in [0, 1]; float32."""
    return cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV)


def _image(mesh: trimesh.Trimesh) -> np.ndarray | None:
    """Returns a mesh's image, (h, w, 3) uint8 RGB of moderate size."""
    image = image_of(mesh)
    if image is None:
        return None
    pixels = np.asarray(image.convert("RGB"))
    shrink = LARGEST_TEXTURE / max(pixels.shape[:2])
    if shrink < 1:
        size = [max(round(side * shrink), 1) for side in pixels.shape[1::-1]]
        pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(pixels)
