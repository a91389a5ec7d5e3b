"""Splits solids into few convex pieces without filling what is hollow."""

from collections.abc import Sequence

import fast_simplification
import manifold3d
import numpy as np
import trimesh

from xray_drake.scene.meshes.closing import closed_solid
from xray_drake.scene.meshes.losses import (
    Losses,
    LossLimits,
    measure_losses,
)
from xray_drake.scene.meshes.pieces import (
    grown_to,
    hull_vertices,
    hull_volume,
    merged_pieces,
    simplified_hull,
)
from xray_drake.scene.meshes.solids import (
    SMALLEST_PIECE,
    parts,
    solid,
    surface,
    union,
)

COACD_FACES = 800
"""CoACD's time grows with the faces; the pieces hardly differ."""

COACD_THRESHOLD = 0.08
"""Fine enough that the walls of a cup come apart; then pieces are merged."""

COACD_FINER = 0.04
"""For chains and lids, of which few pieces lose too much; takes seconds."""

CONVEX_ENOUGH = 0.97
"""A solid that fills this much of its hull is one piece."""

FEW_PIECES = 8
"""As many are tried first: contact costs follow them."""

SLABS = (0.0, 0.03, 0.05, 0.08, 0.12, 0.18, 0.25)
"""Floors tried under the staves of a barrel, as shares of its height."""

_GENTLE = 3
"""How eagerly edges collapse, 0 to 10; the default, 7, tears thin walls."""


def convex_pieces(
    mesh: trimesh.Trimesh,
    convex: Sequence[np.ndarray],
    max_pieces: int,
    max_vertices: int,
    limits: LossLimits,
) -> tuple[list[np.ndarray], Losses]:
    """Splits a closed mesh into convex pieces.

    CoACD, whose many fine pieces are merged by least added volume, competes
    with cutting like a barrel: an end and staves about a principal axis, which
    suits cups and bowls. The one that differs by less volume is taken. Where
    few pieces lose too much, twice as many are made.

    Args:
        mesh: closed, m.
        convex: (n, 3) vertices of the convex bodies that it is made of, if it
            is; they take the place of CoACD's pieces.
        max_pieces: how many pieces there may be.
        max_vertices: how many vertices each may have.
        limits: what the pieces should not lose.

    Returns:
        (n, 3) vertices of each piece, m, and what they lose.
    """
    whole = solid(mesh)
    filled = whole.volume() / whole.hull().volume()
    if max_pieces == 1 or filled > CONVEX_ENOUGH:
        vertices = np.asarray(mesh.vertices, dtype=float)
        pieces = simplified_pieces([hull_vertices(vertices)], max_vertices)
        return pieces, measure_losses(mesh, pieces)
    fine = list(convex) or coacd_pieces(mesh)
    count = min(FEW_PIECES, max_pieces)
    while True:
        candidates = [
            simplified_pieces(merged_pieces(fine, count), max_vertices)
        ]
        if not convex and filled < 0.7 and count >= 4:
            staves = staves_and_floor(mesh, count)
            candidates.append(simplified_pieces(staves, max_vertices))
        pieces = min(candidates, key=lambda made: _difference(whole, made))
        losses = measure_losses(mesh, pieces)
        if count == max_pieces or not limits.exceeded(losses):
            return pieces, losses
        if count == FEW_PIECES and not convex:
            fine = coacd_pieces(mesh, COACD_FINER)
        count = min(2 * count, max_pieces)


def simplified_pieces(
    pieces: list[np.ndarray], max_vertices: int
) -> list[np.ndarray]:
    """Gives each piece few vertices and, where it can, its volume back.

    Args:
        pieces: (n, 3) vertices of each convex piece, m.
        max_vertices: of a piece.

    Returns:
        The same, each of at most (``max_vertices``, 3).
    """
    return [
        grown_to(simplified_hull(piece, max_vertices), hull_volume(piece))
        if len(piece) > max_vertices
        else piece
        for piece in pieces
    ]


def coacd_pieces(
    mesh: trimesh.Trimesh, threshold: float = COACD_THRESHOLD
) -> list[np.ndarray]:
    """Splits a mesh into many fine convex pieces with CoACD.

    Args:
        mesh: closed, m.
        threshold: CoACD's, of the concavity that pieces may keep.

    Returns:
        (n, 3) vertices of each piece, m.
    """
    import coacd  # What only runs scenarios needs none of it.

    coacd.set_log_level("error")
    coarse = decimated(mesh, COACD_FACES)
    found = coacd.run_coacd(
        coacd.Mesh(coarse.vertices, coarse.faces),
        threshold=threshold,
        preprocess_mode="off",
        resolution=500,
        mcts_nodes=10,
        mcts_iterations=20,
        mcts_max_depth=2,
        merge=False,
        seed=0,
    )
    pieces = [np.asarray(vertices, dtype=float) for vertices, _ in found]
    return [
        hull_vertices(piece)
        for piece in pieces
        if len(piece) >= 4 and hull_volume(piece) > SMALLEST_PIECE
    ]


def decimated(mesh: trimesh.Trimesh, faces: int) -> trimesh.Trimesh:
    """Returns a mesh of about so many faces; closed if it was closed."""
    if len(mesh.faces) <= faces:
        return mesh
    vertices, triangles = fast_simplification.simplify(
        np.asarray(mesh.vertices, dtype=np.float32),
        np.asarray(mesh.faces, dtype=np.int32),
        target_count=faces,
        agg=_GENTLE,
    )
    coarse = trimesh.Trimesh(vertices, triangles)
    if not mesh.is_volume or coarse.is_volume:
        return coarse
    try:
        groups = np.zeros(len(coarse.faces), dtype=np.int64)
        mended = closed_solid(coarse.vertices, coarse.faces, groups)
        if not mended.repairs:
            return mended.mesh
    except ValueError:
        pass
    whole = solid(mesh)
    tolerance = mesh.scale * 1e-3
    for _ in range(6):
        whole = whole.simplify(tolerance)
        if whole.num_tri() <= 2 * faces:
            break
        tolerance *= 1.5
    return surface(whole)


def staves_and_floor(mesh: trimesh.Trimesh, count: int) -> list[np.ndarray]:
    """Cuts a solid like a barrel: a flat end and staves around an axis.

    The axis is one of the three principal axes through the middle of the
    bounding box about them, the end is above, below or missing, whichever
    leaves the pieces the least volume.

    Args:
        mesh: closed, m.
        count: number of pieces, at least 4.

    Returns:
        (n, 3) hull vertices of each piece, at most ``count``.
    """
    coarse = decimated(mesh, 2000)
    best: tuple[float, list[np.ndarray]] = (np.inf, [])
    for R_AO in _frames(coarse):
        X_AO = np.eye(4)
        X_AO[:3, :3] = R_AO
        turned = coarse.copy().apply_transform(X_AO)
        middle = turned.bounds.mean(axis=0)
        turned.apply_translation(-middle)
        body = solid(turned)
        height = turned.extents[2]
        for side in (1, -1):
            for slab in SLABS:
                cut = height * (0.5 - slab)
                end, rest = body.split_by_plane((0, 0, side), cut)
                pieces = [] if slab == 0 else parts(end)
                if count - len(pieces) < 3:
                    continue
                pieces += _staves(rest, count - len(pieces))
                total = sum(map(hull_volume, pieces))
                if total < best[0]:
                    best = (
                        total,
                        [(piece + middle) @ R_AO for piece in pieces],
                    )
    return best[1]


def _frames(mesh: trimesh.Trimesh) -> list[np.ndarray]:
    """Rotations that bring each principal axis to z."""
    axes = mesh.principal_inertia_vectors
    frames = []
    for k in range(3):
        R = np.roll(axes, 2 - k, axis=0)
        if np.linalg.det(R) < 0:
            R[0] *= -1
        frames.append(R)
    return frames


def _staves(body: manifold3d.Manifold, count: int) -> list[np.ndarray]:
    """Cuts into ``count`` sectors about z, at least 3: a hull of each."""
    pieces = []
    for k in range(count):
        low = 2 * np.pi * k / count
        high = low + 2 * np.pi / count
        sector = body.trim_by_plane((-np.sin(low), np.cos(low), 0), 0)
        sector = sector.trim_by_plane((np.sin(high), -np.cos(high), 0), 0)
        if sector.hull().volume() > SMALLEST_PIECE:
            points = sector.to_mesh().vert_properties[:, :3]
            pieces.append(hull_vertices(np.asarray(points, dtype=float)))
    return pieces


def _difference(whole: manifold3d.Manifold, pieces: list[np.ndarray]) -> float:
    if not pieces:
        return np.inf
    joint = union(pieces)
    common = (whole ^ joint).volume()
    return whole.volume() + joint.volume() - 2 * common
