"""How the lip of a suction cup meets a surface (Dex-Net 3.0)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from xray_drake.grasping.candidates import SuctionPoints
from xray_drake.grasping.judgement import Lip

RING_POINTS = 12
"""Points around the suction cup's lip."""


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


def fit_seal(
    X_C: np.ndarray,
    depth: np.ndarray,
    normals: np.ndarray,
    met: np.ndarray,
    lip: Lip,
) -> Seal:
    """Says how cups meet the surface under the points of their lips.

    Args:
        X_C: (n, 4, 4) poses of cups: origin at the lip, z into the object.
        depth: (n, k) distance of the surface from the cup's plane along its
            axis at each of the k points of ``ring_offsets``, m.
        normals: (n, k, 3) its unit normals there, out of the object.
        met: (n,) whether there is a surface under all of them.
        lip: of the cups.

    Returns:
        A Seal whose attributes have a leading axis of n, in the poses' frame.
    """
    offsets = ring_offsets(lip.radius)
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
        & (uneven <= lip.tolerance)
        & (bulge <= 2 * lip.tolerance)
        & (cosines.min(axis=1) >= np.cos(lip.max_normal_angle)),
        center=X_C[:, :3, 3] + plane[:, 2:] * X_C[:, :3, 2],
        normal=normal,
        unevenness=uneven,
        nearest=depth.min(axis=1),
        spread=np.ptp(depth, axis=1),
    )


def find_seals(
    lay: Callable[[np.ndarray, Lip], Seal],
    X_C: np.ndarray,
    looseness: Sequence[float],
    lip: Lip,
    *,
    room: float = 0.004,
) -> SuctionPoints:
    """Finds places where a suction cup seals (Mahler et al., Dex-Net 3.0).

    Cups are laid on the surface, and turned into the plane that their lip
    meets, several times.

    Args:
        lay: lays cups at (n, 4, 4) poses on the surface along their axes.
        X_C: (n, 4, 4) their poses at first.
        looseness: factors of tolerance and angle at each time; inf keeps all.
        lip: of the cup.
        room: the larger cup of ``SuctionPoints.roomy`` has a lip wider by
            this radius, m.

    Returns:
        The places in the poses' frame, none alike.
    """
    for loose in looseness:
        seal = lay(X_C, lip.loosened(loose))
        keep = seal.closed | np.isinf(loose)
        X_C = cup_frames(seal.center[keep], seal.normal[keep])
    roomy = lay(X_C, lip.loosened(1.5, room)).closed
    return SuctionPoints(
        point=X_C[:, :3, 3],
        approach=X_C[:, :3, 2],
        unevenness=seal.unevenness[keep],
        roomy=roomy,
        cell=np.arange(len(X_C))[:, None],
    )
