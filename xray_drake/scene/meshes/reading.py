"""Reads mesh files and says whether they can be objects of a heap."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from xray_drake.scene.meshes.formats import FileMesh, read_file
from xray_drake.scene.meshes.pieces import hull_volume

SMALLEST = 0.005
LARGEST = 0.5
"""m. The longest side of the bounding box must lie between these; the bin's
floor is no longer."""

FLATTEST = 1e-6
"""A hull of less volume than this share of the cubed longest side is flat."""


def read_mesh(path: Path, scale: float) -> FileMesh:
    """Reads a file; the nodes of a scene are put together.

    Args:
        path: OBJ, GLB, PLY, STL or OFF.
        scale: metres per unit of the file.

    Returns:
        What the file says, in metres.

    Raises:
        ValueError: it cannot be used; the message says why in one line.
    """
    file = read_file(path)
    vertices = file.vertices * scale
    used = vertices[np.unique(file.triangles)]
    if len(used) == 0:
        raise ValueError("it has no faces")
    if not np.isfinite(used).all():
        raise ValueError("a vertex is not finite")
    longest = float(np.ptp(used, axis=0).max())
    if not SMALLEST <= longest <= LARGEST:
        raise ValueError(
            f"its longest side is {longest:.4g} m, not {SMALLEST} to "
            f"{LARGEST} m; if it is not in metres, give a scale"
        )
    if hull_volume(used - used.mean(axis=0)) < FLATTEST * longest**3:
        raise ValueError("it is flat")
    if file.visual is not None:
        file.visual.apply_scale(scale)
    return replace(file, vertices=vertices)
