"""Antipodal jaw grasps from a depth image: rims, pairs, and closing pads.

From above, the walls that pads press on are mostly hidden. What shows is their
upper rim, where the depth drops. A wall is taken to go on from its rim: along
the normal of the surface inside the rim where that is flat (a box, however it
lies), straight down where it is round (a ball, whose rim is its equator).
"""

from dataclasses import dataclass

import cv2
import numpy as np

from xray_drake.grasping.candidates import AntipodalPairs, Rows
from xray_drake.grasping.evidence.depth_surface import DepthSurface
from xray_drake.grasping.judgement import GripperModel

_WINDOW = 4
"""Half the size of the window about a rim's pixel, pixels."""

_WINDOW_SIGMA = 2.0
"""Weight of the window's pixels, pixels."""

_OUTER_DROP = 0.0015
"""A pixel at the mask's border is a rim if the depth drops by this, m."""

_FLATNESS = 0.0003
"""Deviation from a plane at which a surface is half flat, half round, m."""

_STEEP = 0.7
"""Cosine of the angle to the horizontal at which a surface is a flank."""

_FLAT_WALL = 0.012
_ROUND_WALL = 0.004
"""How far a wall is taken to go on below its rim at most, m."""

_WALL_STEP = 0.0015
"""Distance of the points of a wall below its rim, m."""

_PAD_COLUMNS = 3
_PAD_ROWS = 6
"""Cells of a pad, to tell how much of it touches."""


@dataclass(frozen=True, eq=False)
class Rims(Rows):
    """Upper edges of walls, pixel by pixel.

    Attributes:
        point: (n, 3) on the edge, in the world, m.
        normal: (n, 3) unit normal of the wall, out of the object.
        wall: (n,) how far the wall goes on below, m.
    """

    point: np.ndarray
    normal: np.ndarray
    wall: np.ndarray


@dataclass(frozen=True, eq=False)
class Contact:
    """What pads meet that close on walls.

    Attributes:
        found: (n,) whether both pads meet the object.
        width: (n,) distance of the closed pads, m.
        angle: (n,) the larger of the two angles between the closing axis and
            the mean normal under a pad, rad.
        coverage: (n,) touched share of the pad touched less.
        middle: (n, 3) mean of all points of contact, in the world, m.
    """

    found: np.ndarray
    width: np.ndarray
    angle: np.ndarray
    coverage: np.ndarray
    middle: np.ndarray


def _unit(vectors: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.maximum(length, 1e-12)


def _mean(weight: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Returns (n,) weighted means along the rows of (n, k) weights."""
    return weight @ values / np.maximum(weight.sum(axis=1), 1e-9)


def _planes(
    points: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Fits z = a x + b y + c.

    Args:
        points: (n, k, 3) m.
        weight: (n, k), 0 for those that do not count.

    Returns:
        (n, 3) unit normals upwards and (n,) mean deviations, m.
    """
    total = np.maximum(weight.sum(axis=1), 1e-9)
    mean = np.einsum("nk,nki->ni", weight, points) / total[:, None]
    d = points - mean[:, None]
    C = np.einsum("nk,nki,nkj->nij", weight, d, d) / total[:, None, None]
    # A rod one pixel wide says nothing of the slope across it.
    xx, yy = C[:, 0, 0] + 1e-7, C[:, 1, 1] + 1e-7
    xy, xz, yz = C[:, 0, 1], C[:, 0, 2], C[:, 1, 2]
    det = xx * yy - xy * xy
    a = (xz * yy - yz * xy) / det
    b = (yz * xx - xz * xy) / det
    normal = _unit(np.stack([-a, -b, np.ones_like(a)], axis=-1))
    height = np.einsum("nki,ni->nk", d, normal)
    variance = np.einsum("nk,nk->n", weight, height**2) / total
    return normal, np.sqrt(variance)


def _drops(depth: np.ndarray, among: np.ndarray) -> np.ndarray:
    """Returns the (h, w) drop to the deepest of the four neighbours, m."""
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    with np.errstate(invalid="ignore"):  # beyond the scene: inf - inf
        return cv2.dilate(np.where(among, depth, -1.0), cross) - depth


def find_rims(
    surface: DepthSurface, *, friction: float, max_rims: int = 600
) -> Rims:
    """Finds the object's pixels beside which the depth drops.

    At the mask's border any drop will do; inside it (the inside of a cup, the
    flank of a cone) one that is too steep for pads to slide up on it.

    Args:
        surface: what is seen.
        friction: Coulomb coefficient.
        max_rims: of more, some are left out evenly.
    """
    depth, mask = surface.depth, surface.mask
    steep = surface.pixel_size() / max(friction, 0.05)
    edge = mask & (
        (_drops(depth, ~mask) > _OUTER_DROP) | (_drops(depth, mask) > steep)
    )
    row, column = np.nonzero(edge)
    if len(row) > max_rims:
        pick = np.linspace(0, len(row) - 1, max_rims).astype(int)
        row, column = row[pick], column[pick]
    offset = np.arange(-_WINDOW, _WINDOW + 1)
    dv, du = (o.ravel() for o in np.meshgrid(offset, offset, indexing="ij"))
    distance = np.hypot(du, dv)
    weight = np.exp(-0.5 * (distance / _WINDOW_SIGMA) ** 2)
    index = row[:, None] + dv + _WINDOW, column[:, None] + du + _WINDOW

    def window(image: np.ndarray) -> np.ndarray:
        margin = [(_WINDOW, _WINDOW)] * 2 + [(0, 0)] * (image.ndim - 2)
        return np.pad(image, margin, mode="edge")[index]

    own = window(mask)
    points = window(surface.points_W)
    drop = window(depth) - depth[row, column][:, None]
    # What is nearer than the object hides its shape, and does not count.
    out = np.where(
        own,
        drop > steep + 0.5 * surface.pixel_size() * distance,
        drop > -0.002,
    )
    inside = own & ~out
    u, v = (
        _mean(out * weight, d) - _mean(inside * weight, d) for d in (du, dv)
    )
    R = surface.camera.X_WC[:3, :3]
    across = np.outer(u, R[:, 0]) + np.outer(v, R[:, 1])
    across[:, 2] = 0.0
    clear = np.linalg.norm(across, axis=1) > 0.3
    across = _unit(across)

    top, rough = _planes(points, inside * 1.0)
    flat = 1 / (1 + (rough / _FLATNESS) ** 4)
    along = np.einsum("ni,ni->n", across, top)
    normal = across - (flat * along)[:, None] * top

    # A wall that is seen leans back, and shows by how much.
    point = surface.points_W[row, column]
    fall = point[:, None, 2] - points[..., 2]
    way = np.einsum("nki,ni->nk", points - point[:, None], across)
    seen = own & out & (fall > 0.002) & (way > 0)
    lean = np.where(seen, way / np.where(seen, fall, 1.0), np.inf).min(axis=1)
    level = np.linalg.norm(normal[:, :2], axis=1)
    normal[:, 2] = np.where(
        np.isfinite(lean), np.maximum(normal[:, 2], lean * level), normal[:, 2]
    )
    normal = _unit(normal)
    # Beside a steep flank it is the flank that pads meet, not what is below.
    flank = (flat > 0.5) & (along > _STEEP)
    normal[flank] = top[flank]
    deepest = np.where(out, drop, 0.0).max(axis=1)
    wall = np.minimum(deepest, _ROUND_WALL + flat * (_FLAT_WALL - _ROUND_WALL))
    wall[flank] = 0.0
    # The edge is, on average, half a pixel beyond the pixel's centre.
    point = point + 0.5 * surface.pixel_size() * across
    return Rims(point, normal, wall).take(clear)


def wall_points(rims: Rims) -> tuple[np.ndarray, np.ndarray]:
    """Returns (m, 3) points on the walls below rims, and their normals.

    Args:
        rims: where the walls begin.
    """
    down = np.array([0.0, 0.0, -1.0])
    down = _unit(down - rims.normal * (rims.normal @ down)[:, None])
    count = 1 + np.floor(rims.wall / _WALL_STEP).astype(int)
    index = np.repeat(np.arange(len(rims)), count)
    step = np.arange(len(index)) - np.repeat(np.cumsum(count) - count, count)
    points = rims.point[index] + (_WALL_STEP * step)[:, None] * down[index]
    return points, rims.normal[index]


def pair_rims(
    rims: Rims,
    *,
    friction: float,
    min_width: float,
    max_width: float,
    max_offset: float,
    max_step: float,
) -> tuple[AntipodalPairs, int]:
    """Finds all pairs of rims that are antipodal.

    As in Dex-Net 2.0 (Mahler et al. 2017), where pairs of edge pixels are
    sampled: the axis lies in both friction cones. Pads are areas, so the rims
    need not be exactly opposite.

    Args:
        rims: of one object.
        friction: Coulomb coefficient.
        min_width: least distance along the axis, m.
        max_width: largest distance along the axis, m.
        max_offset: largest sideways distance from the axis, m.
        max_step: largest difference in height, m.

    Returns:
        The pairs in the world, and how many others are too wide.
    """
    i, j = np.triu_indices(len(rims), 1)
    opposed = np.einsum("ni,ni->n", rims.normal[i], rims.normal[j])
    cone = np.arctan(friction)
    # The axis halves the angle between one normal and the other's opposite.
    facing = np.flatnonzero(opposed <= -np.cos(2 * cone))
    i, j, opposed = i[facing], j[facing], opposed[facing]
    d = rims.point[i] - rims.point[j]
    axis = _unit(rims.normal[i] - rims.normal[j])
    width = np.einsum("ni,ni->n", d, axis)
    side = _unit(np.cross(axis, [0.0, 0.0, 1.0]))
    offset = np.abs(np.einsum("ni,ni->n", d, side))
    step = np.abs(np.einsum("ni,ni->n", d, np.cross(side, axis)))
    opposite = (
        (width >= min_width)
        & (offset <= max_offset)
        & (step <= max_step)
        & (np.abs(axis[:, 2]) < 0.95)
    )
    pairs = AntipodalPairs(
        first=rims.point[i],
        second=rims.point[j],
        axis=axis,
        width=width,
        angle=0.5 * np.arccos(np.clip(-opposed, -1.0, 1.0)),
        cell=np.arange(len(i))[:, None],
    ).take(opposite)
    narrow = pairs.width <= max_width
    return pairs.take(narrow), int(np.count_nonzero(~narrow))


def close_pads(
    points_W: np.ndarray,
    normals_W: np.ndarray,
    X_WG: np.ndarray,
    opening: np.ndarray,
    gripper: GripperModel,
) -> Contact:
    """Closes pads on walls until each touches.

    Args:
        points_W: (m, 3) on walls, in the world, m.
        normals_W: (m, 3) their unit normals, out of the object.
        X_WG: (n, 4, 4) poses of the jaw.
        opening: (n,) distances of the pads before, m.
        gripper: whose pads they are.
    """
    n, tip = len(X_WG), gripper.geometry.tip_length
    pad_width = gripper.spec.pad_width
    pad_height = gripper.spec.pad_height
    R = X_WG[:, :3, :3].astype(np.float32)
    p = points_W.astype(np.float32)
    start = np.einsum("nij,ni->nj", X_WG[:, :3, :3], X_WG[:, :3, 3])
    x, y, z = (
        R[:, :, axis] @ p.T - start[:, axis, None].astype(np.float32)
        for axis in range(3)
    )
    facing = R[:, :, 1] @ normals_W.astype(np.float32).T
    within = (
        (np.abs(x) <= 0.5 * pad_width) & (z <= tip) & (z >= tip - pad_height)
    )
    within &= np.abs(y) <= 0.5 * opening[:, None]
    column = np.floor((x / pad_width + 0.5) * _PAD_COLUMNS)
    row = np.floor((tip - z) / pad_height * _PAD_ROWS)
    cell = np.clip(column, 0, _PAD_COLUMNS - 1) * _PAD_ROWS + np.clip(
        row, 0, _PAD_ROWS - 1
    )
    bit = np.left_shift(1, np.where(within, cell, 0).astype(np.int64))

    found = np.ones(n, bool)
    width = np.zeros(n)
    angle = np.zeros(n)
    coverage = np.ones(n)
    middle = np.zeros((n, 3))
    for sign in (1.0, -1.0):
        reach = np.where(within & (sign * facing > 0.3), sign * y, -np.inf)
        first = reach.max(axis=1, initial=-np.inf)
        met = np.isfinite(first)
        found &= met
        first = np.where(met, first, 0.0)
        touch = reach >= (first - gripper.spec.pad_compliance)[:, None]
        width += first
        count = np.maximum(touch.sum(axis=1), 1)
        normal = (touch @ normals_W) / count[:, None]
        cosine = sign * np.einsum("ni,ni->n", normal, X_WG[:, :3, 1])
        angle = np.maximum(angle, np.arccos(np.clip(cosine, -1.0, 1.0)))
        cells = np.bitwise_or.reduce(np.where(touch, bit, 0), axis=1)
        touched = np.unpackbits(cells[:, None].view(np.uint8), axis=1)
        share = touched.sum(axis=1) / (_PAD_COLUMNS * _PAD_ROWS)
        coverage = np.minimum(coverage, share)
        middle += 0.5 * (touch @ points_W) / count[:, None]
    return Contact(
        found=found & (width > 0),
        width=np.maximum(width, 0.0),
        angle=angle,
        coverage=coverage,
        middle=middle,
    )
