"""Reads OBJ, PLY, STL, OFF and GLB files into triangles and colours."""

from xray_drake.scene.meshes.formats.file_mesh import FileMesh
from xray_drake.scene.meshes.formats.reader import (
    FORMATS,
    read_file,
    side_files,
)

__all__ = ["FORMATS", "FileMesh", "read_file", "side_files"]
