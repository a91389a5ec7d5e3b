"""Gives Drake a mesh with its texture."""

import cv2
import numpy as np
import trimesh
from pydrake.common import MemoryFile
from pydrake.geometry import InMemoryMesh

from xray_drake.scene.object_model import TexturedMesh


def drake_mesh(textured: TexturedMesh, label: str) -> InMemoryMesh:
    """Returns an OBJ file with material and texture that Drake renders.

    Args:
        textured: the mesh.
        label: how Drake calls it in messages.
    """
    mesh = trimesh.Trimesh(textured.vertices, textured.faces, process=False)
    lines = ["mtllib material.mtl", "usemtl textured"]
    lines += [f"v {x:.6g} {y:.6g} {z:.6g}" for x, y, z in textured.vertices]
    lines += [f"vt {u:.6g} {v:.6g}" for u, v in textured.uv]
    lines += [f"vn {x:.4g} {y:.4g} {z:.4g}" for x, y, z in mesh.vertex_normals]
    lines += [
        f"f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}" for a, b, c in mesh.faces + 1
    ]
    encoded = _png(textured.image)
    return InMemoryMesh(
        mesh_file=MemoryFile(
            contents="\n".join(lines) + "\n",
            extension=".obj",
            filename_hint=label,
        ),
        supporting_files={
            "material.mtl": MemoryFile(
                contents="newmtl textured\nKd 1 1 1\nmap_Kd texture.png\n",
                extension=".mtl",
                filename_hint=f"{label} material",
            ),
            "texture.png": MemoryFile(
                contents=encoded,
                extension=".png",
                filename_hint=f"{label} texture",
            ),
        },
    )


def _png(image: np.ndarray) -> bytes:
    _, encoded = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    return encoded.tobytes()
