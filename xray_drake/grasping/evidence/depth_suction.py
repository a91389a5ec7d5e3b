"""Suction grasps from a depth image: where the cup's lip finds a flat place."""

from functools import partial

import numpy as np

from xray_drake.grasping.candidates import SuctionPoints
from xray_drake.grasping.evidence.depth_surface import DepthSurface
from xray_drake.grasping.judgement import Lip
from xray_drake.grasping.seal import (
    Seal,
    cup_frames,
    find_seals,
    fit_seal,
    ring_offsets,
)

_LOOKS = 2
"""How often a point of the lip is moved to where the surface is under it."""


def seal_on_depth(
    surface: DepthSurface,
    X_WC: np.ndarray,
    lip: Lip,
) -> Seal:
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
        lip: of the cups.
    """
    offsets = ring_offsets(lip.radius)
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

    return fit_seal(
        X_WC,
        depth,
        surface.normals_W[row, column],
        np.asarray(own.all(axis=1)),
        lip,
    )


def seals_seen(
    surface: DepthSurface,
    lip: Lip,
    *,
    count: int,
) -> tuple[SuctionPoints, int]:
    """Finds places where the cup seals; see ``seal.find_seals``.

    Cups are laid straight down on pixels spread evenly over the object.

    Args:
        surface: what is seen.
        lip: of the cup.
        count: how many places are tried, about.

    Returns:
        The places in the world, and at how many others it does not seal.
    """
    mask = surface.mask
    stride = max(1, int(np.sqrt(np.count_nonzero(mask) / count)))
    chosen = np.zeros(mask.shape, bool)
    chosen[::stride, ::stride] = mask[::stride, ::stride]
    point = surface.points_W[chosen]
    found = find_seals(
        partial(seal_on_depth, surface),
        cup_frames(point, np.broadcast_to([0.0, 0.0, -1.0], point.shape)),
        (10.0, 4.0, 1.0),
        lip,
    )
    return found, len(point) - len(found)
