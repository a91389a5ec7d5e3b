"""Images and other files that a mesh file names."""

from pathlib import Path

import numpy as np
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import SimpleMaterial


def find_file(folder: Path, name: str) -> Path | None:
    r"""Finds a file that another one names.

    Windows' separators and another case count, and a path of the machine that
    wrote the file is looked for by its last part.
    """
    named = name.strip().strip('"').replace("\\", "/")
    if not named:
        return None
    for candidate in (named, named.rsplit("/", 1)[-1]):
        path = _find(folder, candidate)
        if path is not None:
            return path
    return None


def _find(folder: Path, name: str) -> Path | None:
    try:
        if (folder / name).is_file():
            return folder / name
        directory = (folder / name).parent
        last = name.rsplit("/", 1)[-1].lower()
        if not directory.is_dir():
            return None
        same = [
            path for path in directory.iterdir() if path.name.lower() == last
        ]
    except (OSError, ValueError):
        return None
    return min((path for path in same if path.is_file()), default=None)


def opened_image(path: Path | None) -> Image.Image | None:
    """Returns an RGB image; ``None`` without one, or if it is damaged."""
    if path is None:
        return None
    try:
        with Image.open(path) as image:
            return image.convert("RGB")
    except (OSError, ValueError):
        return None


def image_of(mesh: trimesh.Trimesh) -> Image.Image | None:
    """Returns the image of a mesh's material, where it has one."""
    material = getattr(mesh.visual, "material", None)
    image = getattr(material, "image", None)
    return image or getattr(material, "baseColorTexture", None)


def with_image(
    vertices: np.ndarray,
    faces: np.ndarray,
    uv: np.ndarray,
    image: Image.Image | None,
    diffuse: np.ndarray | None = None,
) -> trimesh.Trimesh:
    """Returns a surface with an image on it, or a colour where it has none."""
    material = SimpleMaterial(image=image, diffuse=diffuse)
    visual = TextureVisuals(uv=uv, material=material)
    return trimesh.Trimesh(vertices, faces, visual=visual, process=False)
