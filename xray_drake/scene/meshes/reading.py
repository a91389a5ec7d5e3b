"""Reads mesh files and closes their surfaces."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import QhullError

from xray_drake.scene.meshes.pieces import hull_vertices, hull_volume
from xray_drake.scene.meshes.solids import solid

SMALLEST = 0.005
LARGEST = 0.25
"""m. The longest side of the bounding box must lie between these."""

FLATTEST = 1e-6
"""A hull of less volume than this share of the cubed longest side is flat."""

MOST_FILLED = 0.2
"""Holes are filled while that makes at most this share of the surface."""

CONVEX_GROUP = 0.97
"""A group that fills this much of its hull is a convex piece."""


@dataclass(frozen=True, eq=False)
class RawMesh:
    """A file as it was read, in metres.

    Attributes:
        mesh: with its texture or colours, where it has them.
        groups: (n, 3) hull vertices of each OBJ group where there are several
            and all are closed and convex; else empty.
    """

    mesh: trimesh.Trimesh
    groups: tuple[np.ndarray, ...]


def read_mesh(path: Path, scale: float) -> RawMesh:
    """Reads a file; the nodes of a scene are put together.

    Args:
        path: OBJ, GLB, PLY, STL or OFF.
        scale: metres per unit of the file.

    Raises:
        ValueError: it cannot be used; the message says why in one line.
    """
    try:
        mesh = trimesh.load_mesh(path, process=False)
        mesh.apply_scale(scale)
        used = np.asarray(mesh.vertices)[np.unique(mesh.faces)]
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"cannot be read ({reason[:200]})") from error
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
    if hull_volume(used) < FLATTEST * longest**3:
        raise ValueError("it is flat")
    groups = _groups(path, scale) if path.suffix.lower() == ".obj" else ()
    return RawMesh(mesh, groups)


def closed_surface(mesh: trimesh.Trimesh) -> trimesh.Trimesh | None:
    """Closes a surface by merging, turning and filling.

    Vertices at one place are merged, degenerate and double faces dropped,
    edges of more than two faces cut out, faces turned outward, and each hole
    filled with a fan about its middle.

    Returns:
        A closed mesh without texture; ``None`` if it is still not one.

    Raises:
        ValueError: filling its holes would make more than a fifth of the
            surface, so its inside is not defined.
    """
    made = trimesh.Trimesh(
        np.asarray(mesh.vertices, dtype=float),
        np.asarray(mesh.faces),
        process=False,
    )
    made.merge_vertices()
    made.update_faces(made.nondegenerate_faces() & made.unique_faces())
    if not made.is_winding_consistent:
        made.fix_normals()
    for _ in range(3):
        if made.is_watertight:
            break
        _drop_overused_edges(made)
        made = _filled(made)
    made.remove_unreferenced_vertices()
    if not made.is_winding_consistent:
        made.fix_normals()
    if made.volume < 0:
        made.invert()
    return made if _is_solid(made) else None


def convex_components(mesh: trimesh.Trimesh) -> list[np.ndarray]:
    """Returns the connected parts' hulls if all are convex, else [].

    Each as its (n, 3) vertices, in the mesh's unit.
    """
    parts = mesh.split(only_watertight=False)
    if not 2 <= len(parts) <= 64:
        return []
    hulls = [_convex_hull(part) for part in parts]
    return (
        [hull for hull in hulls if hull is not None]
        if all(hull is not None for hull in hulls)
        else []
    )


def _is_solid(mesh: trimesh.Trimesh) -> bool:
    if not mesh.is_volume:
        return False
    try:
        return solid(mesh).volume() > 0
    except ValueError:
        return False


def _drop_overused_edges(mesh: trimesh.Trimesh) -> None:
    _, inverse, counts = np.unique(
        mesh.edges_sorted, axis=0, return_inverse=True, return_counts=True
    )
    overused = (counts[inverse.ravel()] > 2).reshape(-1, 3).any(axis=1)
    if overused.any():
        mesh.update_faces(~overused)


def _filled(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Fills each hole with a fan.

    Raises:
        ValueError: that makes too much of the surface.
    """
    loops = _boundary_loops(mesh)
    if not loops:
        return mesh
    vertices, faces = [np.asarray(mesh.vertices)], [np.asarray(mesh.faces)]
    count = len(mesh.vertices)
    for loop in loops:
        there = np.roll(loop, -1)
        if len(loop) == 3:
            faces.append(loop[None, ::-1])
            continue
        middle = np.full(len(loop), count)
        faces.append(np.stack([there, loop, middle], axis=1))
        vertices.append(mesh.vertices[loop].mean(axis=0, keepdims=True))
        count += 1
    filled = trimesh.Trimesh(
        np.concatenate(vertices), np.concatenate(faces), process=False
    )
    share = 1 - mesh.area / filled.area
    if share > MOST_FILLED:
        raise ValueError(
            f"it is not closed: filling its holes would make {share:.0%} of "
            f"its surface (at most {MOST_FILLED:.0%})"
        )
    return filled


def _boundary_loops(mesh: trimesh.Trimesh) -> list[np.ndarray]:
    """Follows the edges of one face each around the holes."""
    _, inverse, counts = np.unique(
        mesh.edges_sorted, axis=0, return_inverse=True, return_counts=True
    )
    ends: dict[int, list[int]] = {}
    for start, end in mesh.edges[counts[inverse.ravel()] == 1]:
        ends.setdefault(int(start), []).append(int(end))
    loops = []
    for start in sorted(ends):
        while ends[start]:
            loop, at = [start], ends[start].pop()
            while at != start and ends.get(at):
                loop.append(at)
                at = ends[at].pop()
            if at == start and len(loop) >= 3:
                loops.append(np.array(loop))
    return loops


def _groups(path: Path, scale: float) -> tuple[np.ndarray, ...]:
    """Reads the convex pieces of an OBJ file that consists of them.

    Groups are read here, since a loader that merges vertices would join pieces
    that touch.
    """
    vertices: list[list[str]] = []
    groups: list[list[list[int]]] = [[]]
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == "v":
            vertices.append(words[1:4])
        elif words[0] in ("o", "g"):
            groups.append([])
        elif words[0] == "f":
            corners = [int(word.split("/")[0]) for word in words[1:]]
            groups[-1].append(
                [k - 1 if k > 0 else len(vertices) + k for k in corners]
            )
    groups = [faces for faces in groups if faces]
    if not 2 <= len(groups) <= 256:
        return ()
    points = scale * np.array(vertices, dtype=float)
    pieces = []
    for faces in groups:
        triangles = [
            (face[0], face[k], face[k + 1])
            for face in faces
            for k in range(1, len(face) - 1)
        ]
        piece = _convex_hull(trimesh.Trimesh(points, triangles))
        if piece is None:
            return ()
        pieces.append(piece)
    return tuple(pieces)


def _convex_hull(mesh: trimesh.Trimesh) -> np.ndarray | None:
    """Returns the (n, 3) hull vertices of a closed convex mesh."""
    if not mesh.is_watertight:
        return None
    try:
        vertices = hull_vertices(
            np.asarray(mesh.vertices)[np.unique(mesh.faces)]
        )
    except QhullError:
        return None
    close = abs(mesh.volume) >= CONVEX_GROUP * hull_volume(vertices)
    return vertices if close else None
