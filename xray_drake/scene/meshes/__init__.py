"""Imports objects from folders of mesh files."""

from xray_drake.scene.meshes.importer import (
    MAX_PIECES,
    MAX_VERTICES,
    MeshImport,
    import_meshes,
    load_meshes,
)
from xray_drake.scene.meshes.losses import Losses, LossLimits

__all__ = [
    "MAX_PIECES",
    "MAX_VERTICES",
    "LossLimits",
    "Losses",
    "MeshImport",
    "import_meshes",
    "load_meshes",
]
