"""Samples of grasps on one object's mesh, in its body frame O."""

from dataclasses import replace
from functools import partial

import numpy as np
import trimesh

from xray_drake.grasping.candidates import AntipodalPairs, SuctionPoints
from xray_drake.grasping.judgement import Lip
from xray_drake.grasping.seal import (
    Seal,
    cup_frames,
    find_seals,
    fit_seal,
    frame_from_z,
    ring_offsets,
)

CELL = 0.01
"""Grasps whose centres fall in one cell of this size, m, are alike."""


def cast_rays(
    mesh: trimesh.Trimesh, origins: np.ndarray, directions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Casts rays at a mesh.

    Args:
        mesh: in some frame.
        origins: (n, 3) in that frame, m.
        directions: (n, 3) unit vectors.

    Returns:
        (n,) distance to the first hit, inf where there is none, m; (n,) index
        of the face hit, −1 where there is none.
    """
    distance = np.full(len(origins), np.inf)
    face = np.full(len(origins), -1)
    if len(origins) == 0:
        return distance, face
    points, ray, triangle = mesh.ray.intersects_location(
        origins, directions, multiple_hits=False
    )
    distance[ray] = np.einsum(
        "ij,ij->i", points - origins[ray], directions[ray]
    )
    face[ray] = triangle
    return distance, face


def surface_points(
    mesh: trimesh.Trimesh, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Draws points uniformly by area, and adds those facing the mesh's centre.

    The centre's six neighbours along the axes are added because a random
    sample rarely has the middle of a face, where a grasp is best.

    Returns:
        (n, 3) points, m, and (n,) the faces they lie on.
    """
    face = rng.choice(
        len(mesh.faces), size=count, p=mesh.area_faces / mesh.area
    )
    u, v = rng.random((2, count, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    a, b, c = np.moveaxis(mesh.triangles[face], 1, 0)
    points = a + u * (b - a) + v * (c - a)

    axes = np.concatenate([np.eye(3), -np.eye(3)])
    reach = 2 * float(np.linalg.norm(mesh.extents))
    origins = mesh.center_mass - reach * axes
    distance, hit = cast_rays(mesh, origins, axes)
    found = hit >= 0
    facing = origins[found] + distance[found, None] * axes[found]
    return np.concatenate([facing, points]), np.concatenate([hit[found], face])


def sample_antipodal(
    mesh: trimesh.Trimesh,
    rng: np.random.Generator,
    *,
    count: int,
    friction: float,
    max_width: float,
    min_width: float = 0.002,
) -> tuple[AntipodalPairs, int]:
    """Samples antipodal pairs (Mahler et al., Dex-Net 1.0 and 2.0).

    From each surface point a ray goes inwards, along the normal or within the
    friction cone about it, to the next surface, and to the farthest within
    reach. A pair is kept if both normals are within atan μ of its axis: the
    axis then lies in both friction cones (Prattichizzo & Trinkle 2008, force
    closure of two contacts).

    Args:
        mesh: closed surface in O, m.
        rng: random generator.
        count: surface points drawn.
        friction: Coulomb coefficient μ.
        max_width: largest distance of the contacts, m.
        min_width: smallest distance of the contacts, m.

    Returns:
        The pairs in O, and how many others are too wide.
    """
    points, faces = surface_points(mesh, count, rng)
    inward = -mesh.face_normals[faces]
    cone = np.arctan(friction)
    tilt = cone * np.sqrt(rng.random(len(points)))
    tilt[: len(points) - count // 2] = 0.0
    azimuth = 2 * np.pi * rng.random(len(points))
    local = np.stack(
        [
            np.sin(tilt) * np.cos(azimuth),
            np.sin(tilt) * np.sin(azimuth),
            np.cos(tilt),
        ],
        axis=-1,
    )
    direction = np.einsum("nij,nj->ni", frame_from_z(inward), local)

    # Forwards to the next surface; and back from beyond, for hollow objects.
    start = 1e-6
    near, near_hit = cast_rays(mesh, points + start * direction, direction)
    beyond = max_width + start
    back, far_hit = cast_rays(mesh, points + beyond * direction, -direction)
    hit = np.concatenate([near_hit, far_hit])
    distance = np.concatenate([near + start, beyond - back])
    points, inward, direction = (
        np.tile(v, (2, 1)) for v in (points, inward, direction)
    )
    cosine = np.minimum(
        np.einsum("ni,ni->n", direction, inward),
        np.einsum("ni,ni->n", direction, mesh.face_normals[hit]),
    )
    distinct = np.ones(len(hit), bool)
    distinct[len(near) :] = np.abs(near + start - (beyond - back)) > 1e-5
    antipodal = (
        (hit >= 0)
        & distinct
        & (distance >= min_width)
        & (cosine >= np.cos(cone) - 1e-9)
    )
    keep = antipodal & (distance <= max_width)
    first = points[keep]
    axis = -direction[keep]
    second = first - distance[keep, None] * axis
    place = np.round(0.5 * (first + second) / CELL)
    pairs = AntipodalPairs(
        first=first,
        second=second,
        axis=axis,
        width=np.linalg.norm(first - second, axis=-1),
        angle=np.arccos(np.clip(cosine[keep], -1.0, 1.0)),
        cell=np.column_stack([place, np.round(2 * axis)]),
    )
    return pairs, int(np.count_nonzero(antipodal & (distance > max_width)))


def seal_cups(
    mesh: trimesh.Trimesh,
    X_OC: np.ndarray,
    lip: Lip,
    *,
    reach: float = 0.02,
) -> Seal:
    """Projects cups on a surface along their axes (Dex-Net 3.0, seal test).

    The lip, a ring of half its size and the centre are projected. The cup
    seals if every ray hits, no hit of the lip is farther than ``tolerance``
    from the plane that fits them, none inside it rises more than twice as far
    into the cup, and no surface normal deviates from that plane's by more than
    ``max_normal_angle``.

    Args:
        mesh: surface in O, m.
        X_OC: (n, 4, 4) poses of cups: origin at the lip, z into the object.
        lip: of the cups.
        reach: rays start this far behind the lip, m.

    Returns:
        A Seal whose attributes have a leading axis of n.
    """
    offsets = ring_offsets(lip.radius)
    n, k = len(X_OC), len(offsets)
    p = np.zeros((k, 4))
    p[:, :2], p[:, 2], p[:, 3] = offsets, -reach, 1.0
    origins = np.einsum("nij,kj->nki", X_OC, p)[..., :3]
    axis = X_OC[:, :3, 2]
    directions = np.broadcast_to(axis[:, None], (n, k, 3))
    distance, hit = cast_rays(
        mesh, origins.reshape(-1, 3), directions.reshape(-1, 3)
    )
    distance = distance.reshape(n, k) - reach
    hit = hit.reshape(n, k)
    found = (hit >= 0).all(axis=1)
    depth = np.where(np.isfinite(distance), distance, 0.0)

    return fit_seal(
        X_OC,
        depth,
        mesh.face_normals[hit],
        np.asarray(found),
        lip,
    )


def sample_suction(
    mesh: trimesh.Trimesh,
    rng: np.random.Generator,
    lip: Lip,
    *,
    count: int,
) -> tuple[SuctionPoints, int]:
    """Samples places where a suction cup seals; see ``seal.find_seals``.

    Args:
        mesh: closed surface in O, m.
        rng: random generator.
        lip: of the cup.
        count: surface points drawn.

    Returns:
        The places in O, and at how many others it does not seal.
    """
    points, faces = surface_points(mesh, count, rng)
    found = find_seals(
        partial(seal_cups, mesh, reach=0.01),
        cup_frames(points, -mesh.face_normals[faces]),
        (np.inf, 1.0),
        lip,
    )
    found = replace(found, cell=np.round(found.point / CELL))
    return found, len(points) - len(found)
