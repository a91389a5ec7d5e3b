"""Reads OBJ, PLY, STL, OFF and GLB files into triangles and colours."""

from collections.abc import Callable
from pathlib import Path

from xray_drake.scene.meshes.formats.file_mesh import FileMesh
from xray_drake.scene.meshes.formats.glb import read_glb
from xray_drake.scene.meshes.formats.obj import obj_side_files, read_obj
from xray_drake.scene.meshes.formats.off import read_off
from xray_drake.scene.meshes.formats.ply import ply_side_files, read_ply
from xray_drake.scene.meshes.formats.stl import read_stl

__all__ = ["FORMATS", "FileMesh", "read_file", "side_files"]

_READERS: dict[str, Callable[[Path], FileMesh]] = {
    ".obj": read_obj,
    ".glb": read_glb,
    ".ply": read_ply,
    ".stl": read_stl,
    ".off": read_off,
}

FORMATS = tuple(_READERS)
"""What is read; of one mesh in several formats the first is taken."""


def read_file(path: Path) -> FileMesh:
    """Reads a mesh file.

    Raises:
        ValueError: it cannot be read; the message says why in one line.
    """
    try:
        return _READERS[path.suffix.lower()](path)
    except MemoryError:
        raise
    except Exception as error:
        # The format's libraries throw all kinds.
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"cannot be read ({reason[:200]})") from error


def side_files(path: Path) -> list[Path]:
    """Returns the files a mesh refers to, such as materials and textures."""
    suffix = path.suffix.lower()
    try:
        if suffix == ".obj":
            return obj_side_files(path)
        if suffix == ".ply":
            return ply_side_files(path)
    except ValueError:
        pass
    return []
