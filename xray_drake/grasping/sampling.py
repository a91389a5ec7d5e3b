"""Grasp candidates on one object, in its body frame O."""

from dataclasses import dataclass

import numpy as np
import trimesh

RING_POINTS = 12
"""Points around the suction cup's lip."""


@dataclass(frozen=True, eq=False)
class AntipodalPairs:
    """Pairs of points that two opposite fingers can squeeze.

    Attributes:
        first: (n, 3) contact of the finger on the +axis side, in O, m.
        second: (n, 3) contact of the opposite finger, in O, m.
        axis: (n, 3) unit closing axis, from ``second`` to ``first``.
        angle: (n,) the larger of the two angles between the axis and a surface
            normal, rad.
    """

    first: np.ndarray
    second: np.ndarray
    axis: np.ndarray
    angle: np.ndarray

    @property
    def middle(self) -> np.ndarray:
        """The (n, 3) midpoints, m."""
        return 0.5 * (self.first + self.second)

    @property
    def width(self) -> np.ndarray:
        """The (n,) distances between the contacts, m."""
        return np.linalg.norm(self.first - self.second, axis=-1)

    def __len__(self) -> int:
        return len(self.first)


@dataclass(frozen=True, eq=False)
class SuctionPoints:
    """Places where a suction cup seals.

    In the object's frame O where it is sampled on a model, in the world where
    it is found in an image.

    Attributes:
        point: (n, 3) centre of the lip on the surface, m.
        approach: (n, 3) unit normal of the lip's plane, into the object.
        unevenness: (n,) largest distance of the surface under the lip from
            that plane, m.
        roomy: (n,) whether a larger cup would seal there, too.
    """

    point: np.ndarray
    approach: np.ndarray
    unevenness: np.ndarray
    roomy: np.ndarray

    def __len__(self) -> int:
        return len(self.point)


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


def ring_offsets(radius: float) -> np.ndarray:
    """Returns (n, 2) points of a cup: lip, a ring of half its size, centre.

    The first ``RING_POINTS`` are the lip.

    Args:
        radius: of the lip, m.
    """
    angle = 2 * np.pi * np.arange(RING_POINTS) / RING_POINTS
    lip = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return radius * np.concatenate([lip, 0.5 * lip[::2], np.zeros((1, 2))])


def frame_from_z(z: np.ndarray) -> np.ndarray:
    """Returns (..., 3, 3) rotations whose last column is the unit vector z."""
    helper = np.where(
        np.abs(z[..., :1]) < 0.9, np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
    )
    y = np.cross(z, helper)
    y = y / np.linalg.norm(y, axis=-1, keepdims=True)
    return np.stack([np.cross(y, z), y, z], axis=-1)


def cup_frames(point: np.ndarray, approach: np.ndarray) -> np.ndarray:
    """Returns (n, 4, 4) poses of cups at points along unit approaches."""
    X = np.tile(np.eye(4), (len(point), 1, 1))
    X[:, :3, :3] = frame_from_z(approach)
    X[:, :3, 3] = point
    return X


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
) -> AntipodalPairs:
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
    keep = (
        (hit >= 0)
        & distinct
        & (distance >= min_width)
        & (distance <= max_width)
        & (cosine >= np.cos(cone) - 1e-9)
    )
    first = points[keep]
    axis = -direction[keep]
    return AntipodalPairs(
        first=first,
        second=first - distance[keep, None] * axis,
        axis=axis,
        angle=np.arccos(np.clip(cosine[keep], -1.0, 1.0)),
    )


@dataclass(frozen=True, eq=False)
class Seal:
    """How a cup meets a surface.

    Attributes:
        closed: whether it seals.
        center: (3,) centre of the lip's plane on the cup's axis, m.
        normal: (3,) unit normal of that plane, into the object.
        unevenness: largest distance of the surface under the lip from that
            plane, m.
        nearest: smallest distance from the cup's plane, along its axis, m.
        spread: largest distance minus smallest, m.
    """

    closed: np.ndarray
    center: np.ndarray
    normal: np.ndarray
    unevenness: np.ndarray
    nearest: np.ndarray
    spread: np.ndarray


def seal_cups(
    mesh: trimesh.Trimesh,
    X_OC: np.ndarray,
    *,
    radius: float,
    tolerance: float,
    max_normal_angle: float,
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
        radius: of the lip, m.
        tolerance: m.
        max_normal_angle: rad.
        reach: rays start this far behind the lip, m.

    Returns:
        A Seal whose attributes have a leading axis of n.
    """
    offsets = ring_offsets(radius)
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
        radius=radius,
        tolerance=tolerance,
        max_normal_angle=max_normal_angle,
    )


def fit_seal(
    X_C: np.ndarray,
    depth: np.ndarray,
    normals: np.ndarray,
    met: np.ndarray,
    *,
    radius: float,
    tolerance: float,
    max_normal_angle: float,
) -> Seal:
    """Says how cups meet the surface under the points of their lips.

    Args:
        X_C: (n, 4, 4) poses of cups: origin at the lip, z into the object.
        depth: (n, k) distance of the surface from the cup's plane along its
            axis at each of the k points of ``ring_offsets``, m.
        normals: (n, k, 3) its unit normals there, out of the object.
        met: (n,) whether there is a surface under all of them.
        radius: of the lip, m.
        tolerance: see :func:`seal_cups`.
        max_normal_angle: see :func:`seal_cups`.

    Returns:
        A Seal whose attributes have a leading axis of n, in the poses' frame.
    """
    offsets = ring_offsets(radius)
    n, k = depth.shape
    A = np.column_stack([offsets, np.ones(k)])
    plane = depth[:, :RING_POINTS] @ np.linalg.pinv(A[:RING_POINTS]).T
    slope = plane[:, :2]
    scale = 1.0 / np.sqrt(1.0 + (slope**2).sum(axis=1))
    deviation = (depth - plane @ A.T) * scale[:, None]
    uneven = np.abs(deviation[:, :RING_POINTS]).max(axis=1)
    bulge = -deviation[:, RING_POINTS:].min(axis=1)
    normal_C = scale[:, None] * np.column_stack([-slope, np.ones(n)])
    normal = np.einsum("nij,nj->ni", X_C[:, :3, :3], normal_C)
    cosines = -np.einsum("nki,ni->nk", normals, normal)
    return Seal(
        closed=met
        & (uneven <= tolerance)
        & (bulge <= 2 * tolerance)
        & (cosines.min(axis=1) >= np.cos(max_normal_angle)),
        center=X_C[:, :3, 3] + plane[:, 2:] * X_C[:, :3, 2],
        normal=normal,
        unevenness=uneven,
        nearest=depth.min(axis=1),
        spread=np.ptp(depth, axis=1),
    )


def sample_suction(
    mesh: trimesh.Trimesh,
    rng: np.random.Generator,
    *,
    count: int,
    radius: float,
    tolerance: float = 0.001,
    max_normal_angle: float = np.deg2rad(15.0),
    room: float = 0.004,
) -> SuctionPoints:
    """Samples places where a suction cup seals (Mahler et al., Dex-Net 3.0).

    The cup is turned into the plane that its lip meets, and projected again.

    Args:
        mesh: closed surface in O, m.
        rng: random generator.
        count: surface points drawn.
        radius: of the lip, m.
        tolerance: largest distance of the surface under the lip from its
            plane, m.
        max_normal_angle: largest deviation of the surface's normals, rad.
        room: the larger cup of ``SuctionPoints.roomy`` has a lip wider by
            this radius, m.
    """
    points, faces = surface_points(mesh, count, rng)
    X_OC = cup_frames(points, -mesh.face_normals[faces])
    for _ in range(2):
        seal = seal_cups(
            mesh,
            X_OC,
            radius=radius,
            tolerance=tolerance,
            max_normal_angle=max_normal_angle,
            reach=0.01,
        )
        X_OC = cup_frames(seal.center, seal.normal)
    keep = seal.closed
    roomy = seal_cups(
        mesh,
        X_OC[keep],
        radius=radius + room,
        tolerance=1.5 * tolerance,
        max_normal_angle=1.5 * max_normal_angle,
        reach=0.01,
    ).closed
    return SuctionPoints(
        point=seal.center[keep],
        approach=seal.normal[keep],
        unevenness=seal.unevenness[keep],
        roomy=roomy,
    )
