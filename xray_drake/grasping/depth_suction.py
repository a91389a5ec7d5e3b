"""Suction grasps from a depth image: where the cup's lip finds a flat place."""

from dataclasses import dataclass

import numpy as np

from xray_drake.grasping.depth_surface import DepthSurface
from xray_drake.grasping.sampling import (
    RING_POINTS,
    frame_from_z,
    ring_offsets,
)

_LOOKS = 2
"""How often a point of the lip is moved to where the surface is under it."""


@dataclass(frozen=True, eq=False)
class DepthSeal:
    """How cups meet a surface that is seen.

    Attributes:
        closed: (n,) whether the cup seals.
        center: (n, 3) centre of the lip's plane on the cup's axis, in the
            world, m.
        normal: (n, 3) unit normal of that plane, into the object.
        unevenness: (n,) largest distance of the surface under the lip from
            that plane, m.
        nearest: (n,) smallest distance from the cup's plane, along its axis,
            m.
        spread: (n,) largest such distance minus smallest, m.
    """

    closed: np.ndarray
    center: np.ndarray
    normal: np.ndarray
    unevenness: np.ndarray
    nearest: np.ndarray
    spread: np.ndarray


def seal_on_depth(
    surface: DepthSurface,
    X_WC: np.ndarray,
    *,
    radius: float,
    tolerance: float,
    max_normal_angle: float,
) -> DepthSeal:
    """Lays cups on the surface that is seen (Dex-Net 3.0, seal test).

    The counterpart of ``sampling.seal_cups``: the lip, a ring of half its size
    and the centre are moved along the cup's axis to the surface. The cup seals
    if all of them meet the object, no point of the lip is farther than
    ``tolerance`` from the plane that fits them, none inside it rises more than
    twice as far into the cup, and no surface normal deviates from that plane's
    by more than ``max_normal_angle``.

    Args:
        surface: what is seen.
        X_WC: (n, 4, 4) poses of cups: origin at the lip, z into the object.
        radius: of the lip, m.
        tolerance: m.
        max_normal_angle: rad.
    """
    offsets = ring_offsets(radius)
    n, k = len(X_WC), len(offsets)
    axis = X_WC[:, None, :3, 2]
    flat = X_WC[:, None, :3, 3] + np.einsum(
        "nij,kj->nki", X_WC[:, :3, :2], offsets
    )
    height, width = surface.depth.shape
    depth = np.zeros((n, k))
    own = np.ones((n, k), bool)
    for _ in range(_LOOKS):
        u, v, _ = np.moveaxis(
            surface.camera.project(flat + depth[..., None] * axis), -1, 0
        )
        column = np.rint(np.nan_to_num(u, nan=-1.0)).clip(-1, width).astype(int)
        row = np.rint(np.nan_to_num(v, nan=-1.0)).clip(-1, height).astype(int)
        own = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        row, column = np.where(own, row, 0), np.where(own, column, 0)
        own &= surface.mask[row, column]
        met = surface.points_W[row, column] - flat
        met = np.where(own[..., None], met, 0.0)
        depth = np.einsum("nki,nki->nk", met, np.broadcast_to(axis, met.shape))

    A = np.column_stack([offsets, np.ones(k)])
    plane = depth[:, :RING_POINTS] @ np.linalg.pinv(A[:RING_POINTS]).T
    slope = plane[:, :2]
    scale = 1.0 / np.sqrt(1.0 + (slope**2).sum(axis=1))
    deviation = (depth - plane @ A.T) * scale[:, None]
    uneven = np.abs(deviation[:, :RING_POINTS]).max(axis=1)
    bulge = -deviation[:, RING_POINTS:].min(axis=1)
    normal_C = scale[:, None] * np.column_stack([-slope, np.ones(n)])
    normal = np.einsum("nij,nj->ni", X_WC[:, :3, :3], normal_C)
    cosines = -np.einsum("nki,ni->nk", surface.normals_W[row, column], normal)
    return DepthSeal(
        closed=own.all(axis=1)
        & (uneven <= tolerance)
        & (bulge <= 2 * tolerance)
        & (cosines.min(axis=1) >= np.cos(max_normal_angle)),
        center=X_WC[:, :3, 3] + plane[:, 2:] * X_WC[:, :3, 2],
        normal=normal,
        unevenness=uneven,
        nearest=depth.min(axis=1),
        spread=np.ptp(depth, axis=1),
    )


@dataclass(frozen=True, eq=False)
class DepthSuctionPoints:
    """Places where a suction cup seals, as seen.

    Attributes:
        point: (n, 3) centre of the lip on the surface, in the world, m.
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


def cup_frames(point: np.ndarray, approach: np.ndarray) -> np.ndarray:
    """Returns (n, 4, 4) poses of cups at points along unit approaches."""
    X = np.tile(np.eye(4), (len(point), 1, 1))
    X[:, :3, :3] = frame_from_z(approach)
    X[:, :3, 3] = point
    return X


def find_seals(
    surface: DepthSurface,
    *,
    count: int,
    radius: float,
    tolerance: float,
    max_normal_angle: float,
    room: float = 0.004,
) -> DepthSuctionPoints:
    """Finds places where the cup seals.

    Cups are laid straight down on pixels spread evenly over the object, and
    turned twice into the plane that their lip meets.

    Args:
        surface: what is seen.
        count: how many places are tried, about.
        radius: of the lip, m.
        tolerance: largest distance of the surface under the lip from its
            plane, m.
        max_normal_angle: largest deviation of the surface's normals, rad.
        room: the larger cup of ``roomy`` has a lip wider by this radius, m.
    """
    mask = surface.mask
    stride = max(1, int(np.sqrt(np.count_nonzero(mask) / count)))
    chosen = np.zeros(mask.shape, bool)
    chosen[::stride, ::stride] = mask[::stride, ::stride]
    point = surface.points_W[chosen]
    X = cup_frames(point, np.broadcast_to([0.0, 0.0, -1.0], point.shape))
    for loose in (10.0, 4.0, 1.0):
        seal = seal_on_depth(
            surface,
            X,
            radius=radius,
            tolerance=loose * tolerance,
            max_normal_angle=min(loose * max_normal_angle, np.pi),
        )
        keep = seal.closed
        X = cup_frames(seal.center[keep], seal.normal[keep])
    roomy = seal_on_depth(
        surface,
        X,
        radius=radius + room,
        tolerance=1.5 * tolerance,
        max_normal_angle=1.5 * max_normal_angle,
    ).closed
    return DepthSuctionPoints(
        point=X[:, :3, 3],
        approach=X[:, :3, 2],
        unevenness=seal.unevenness[keep],
        roomy=roomy,
    )
