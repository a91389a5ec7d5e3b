"""Binary glTF, by trimesh."""

from pathlib import Path

import numpy as np
import trimesh
from trimesh.visual import ColorVisuals, TextureVisuals

from xray_drake.scene.meshes.formats.file_mesh import (
    FileMesh,
    in_one,
    mean_over_surface,
)
from xray_drake.scene.meshes.formats.images import image_of


def read_glb(path: Path) -> FileMesh:
    """Reads a GLB file; each mesh of a node is a group, put in its place."""
    scene = trimesh.load_scene(path, process=False)
    nodes = [mesh for mesh in scene.dump() if isinstance(mesh, trimesh.Trimesh)]
    if not nodes:
        return FileMesh(
            np.zeros((0, 3)), np.zeros((0, 3), np.int64), np.zeros(0, np.int64)
        )
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in nodes)])
    vertices = np.concatenate([np.asarray(mesh.vertices) for mesh in nodes])
    triangles = np.concatenate(
        [mesh.faces + start for mesh, start in zip(nodes, starts, strict=False)]
    )
    groups = np.repeat(
        np.arange(len(nodes)), [len(mesh.faces) for mesh in nodes]
    )
    textured = any(image_of(mesh) is not None for mesh in nodes)
    colors = [
        np.broadcast_to(one, (len(mesh.faces), 3))
        for mesh in nodes
        if (one := _color(mesh)) is not None
    ]
    every = np.concatenate(colors) if len(colors) == len(nodes) else None
    return FileMesh(
        vertices,
        triangles,
        groups,
        visual=in_one(nodes) if textured else None,
        color=mean_over_surface(vertices, triangles, every),
    )


def _color(mesh: trimesh.Trimesh) -> np.ndarray | None:
    """Returns (m, 3) or (3,) colours of a mesh in [0, 1], if it has any."""
    visual = mesh.visual
    if isinstance(visual, ColorVisuals):
        if not visual.defined:
            return None
        return np.asarray(visual.face_colors)[:, :3] / 255
    if isinstance(visual, TextureVisuals) and visual.material is not None:
        return np.asarray(visual.material.main_color)[:3] / 255
    return None
