"""How a rigid body can lie at rest on the floor, and how likely each way is."""

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
import trimesh

from xray_drake.geometry.silhouette import height_map

_REACH = 60
"""Half width of the height maps that poses are compared by, cells."""

_FLAT = 0.75
"""Height of a flat body, as a share of its width."""

_USUAL = 0.65
"""Share of throws that end with a flat body lying flat."""

_UPRIGHT = 0.99
"""Cosine of the angle between its z axis and the vertical."""

_ALIKE = 0.06
"""Share of their area by which silhouettes that are the same may differ."""

_TURNS = 72
"""Turns about the vertical at which they are compared."""


@dataclass(frozen=True, eq=False)
class RestingPose:
    """One way a body lies; how it is turned about the vertical is left open.

    Attributes:
        R_WO: (3, 3) orientation of the body in the world, z up.
        probability: share of the throws that end so.
        downs: (k, 3) which directions of the body frame point down: one for
            each face of its hull on which it looks so.
    """

    R_WO: np.ndarray
    probability: float
    downs: np.ndarray


def resting_poses(
    mesh: trimesh.Trimesh,
    p_OCom: np.ndarray | None = None,
    *,
    least_share: float = 0.03,
    same: float = 0.04,
) -> tuple[RestingPose, ...]:
    """Finds the stable poses of a mesh, the most probable first.

    The faces of its convex hull on which it does not topple, with the
    probability that a body thrown with a uniformly random orientation comes to
    lie on it (Goldberg et al., "Part pose statistics", as implemented by
    trimesh). Poses that look the same from above but for a turn about the
    vertical are one; improbable ones are dropped. Results are remembered.

    Args:
        mesh: closed, in the body frame, m.
        p_OCom: (3,) centre of mass, m; by default that of the mesh.
        least_share: poses less probable than this are dropped; the most
            probable never is. The others' probabilities are scaled to sum 1.
        same: two poses are one if their height maps differ by at most this
            share of their volume.

    Raises:
        ValueError: a mesh without volume, or without any stable pose.
    """
    com = mesh.center_mass if p_OCom is None else p_OCom
    return _find(mesh, tuple(map(float, com)), least_share, same)


def lies_flat(mesh: trimesh.Trimesh, p_OCom: np.ndarray | None = None) -> bool:
    """Says whether a body lies flat, its z axis up or down, as a rule.

    Where it does, one silhouette and one height are enough to look for it: it
    is no higher than :data:`_FLAT` of its width, most throws end so
    (:data:`_USUAL`), and on either face it looks the same from above.

    Args:
        mesh: closed, in the body frame, m.
        p_OCom: (3,) centre of mass, m; by default that of the mesh.
    """
    length, width, height = mesh.extents
    flat = [
        pose
        for pose in resting_poses(mesh, p_OCom)
        if abs(pose.R_WO[2, 2]) > _UPRIGHT
    ]
    if height > _FLAT * min(length, width) or (
        sum(pose.probability for pose in flat) < _USUAL
    ):
        return False
    vertices = np.asarray(mesh.vertices, dtype=float)
    pitch = float(np.linalg.norm(np.ptp(vertices, axis=0))) / _REACH
    outlines = [
        (_centered(standing(vertices, pose.R_WO), mesh.faces, pitch) > 0) * 1.0
        for pose in flat
    ]
    return all(_is_same(outlines[0], other, _ALIKE) for other in outlines)


def standing(vertices: np.ndarray, R_WO: np.ndarray) -> np.ndarray:
    """Returns (n, 3) vertices turned by ``R_WO`` and put on the floor, m."""
    turned = np.asarray(vertices, dtype=float) @ R_WO.T
    turned[:, 2] -= turned[:, 2].min()
    return turned


def lean(poses: tuple[RestingPose, ...], X_WO: np.ndarray) -> float:
    """Returns the angle by which a body leans from its nearest resting pose.

    Args:
        poses: its resting poses.
        X_WO: (4, 4) its pose.

    Returns:
        rad.
    """
    downs = np.concatenate([pose.downs for pose in poses])
    nearest = float((downs @ -X_WO[2, :3]).max())
    return float(np.arccos(np.clip(nearest, -1.0, 1.0)))


@lru_cache(maxsize=32)
def _find(
    mesh: trimesh.Trimesh,
    p_OCom: tuple[float, ...],
    least_share: float,
    same: float,
) -> tuple[RestingPose, ...]:
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    spread = np.linalg.svd(vertices - vertices.mean(axis=0), compute_uv=False)
    if len(spread) < 3 or spread[-1] <= 1e-9 * spread[0]:
        raise ValueError("a body without volume does not rest")
    hull = trimesh.Trimesh(vertices, faces, process=False).convex_hull
    transforms, shares = trimesh.poses.compute_stable_poses(
        hull, center_mass=np.array(p_OCom), threshold=0.0
    )
    if not len(shares):
        raise ValueError("the mesh has no stable pose")
    found: list[RestingPose] = []
    maps: list[np.ndarray] = []
    pitch = float(np.linalg.norm(np.ptp(vertices, axis=0))) / _REACH
    # A stable sort: equal shares keep the order in which they were found.
    for index in np.argsort(-shares.round(9), kind="stable"):
        if shares[index] <= 0:
            continue
        R_WO, share = np.array(transforms[index][:3, :3]), float(shares[index])
        heights = _centered(standing(vertices, R_WO), faces, pitch)
        for k, known in enumerate(maps):
            if _is_same(known, heights, same):
                downs = np.vstack([found[k].downs, -R_WO[2]])
                total = found[k].probability + share
                found[k] = RestingPose(found[k].R_WO, total, downs)
                break
        else:
            found.append(RestingPose(R_WO, share, -R_WO[2:]))
            maps.append(heights)
    whole = sum(pose.probability for pose in found)
    found.sort(key=lambda pose: -pose.probability / whole)
    kept = [
        pose
        for pose in found
        if pose.probability / whole >= least_share or pose is found[0]
    ]
    rest = sum(pose.probability / whole for pose in kept)
    return tuple(
        replace(pose, probability=pose.probability / whole / rest)
        for pose in kept
    )


def turns_into_itself(
    vertices: np.ndarray, faces: np.ndarray, same: float = 0.02
) -> int:
    """Returns in how many ways a body that stands looks the same, turned.

    Args:
        vertices: (n, 3), z from the floor, turned about x = y = 0, m.
        faces: (m, 3) indices of outward-facing triangles.
        same: share of the volume by which height maps may differ.

    Returns:
        The largest n up to 12 so that a turn by 1/n changes nothing.
    """
    farthest = float(np.hypot(*vertices[:, :2].T).max())
    heights = height_map(vertices, faces, farthest / _REACH, _REACH + 2)
    best = 1
    for order in range(2, 13):
        if _difference(heights, _turned(heights, 360 / order)) <= same:
            best = order
    return best


def _centered(
    vertices: np.ndarray, faces: np.ndarray, pitch: float
) -> np.ndarray:
    """Draws the height map about its own centre, whatever the origin."""
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    first = height_map(
        vertices - [*middle[:2], 0.0], faces, pitch, _REACH
    ).astype(float)
    steps = np.arange(-_REACH, _REACH + 1) * pitch
    weight = first / first.sum()
    x = float(weight.sum(axis=0) @ steps) + middle[0]
    y = middle[1] - float(weight.sum(axis=1) @ steps)
    return height_map(vertices - [x, y, 0.0], faces, pitch, _REACH)


def _is_same(a: np.ndarray, b: np.ndarray, same: float) -> bool:
    """Says whether two height maps differ by a turn alone."""
    # What differs in its whole by more cannot be turned into the other.
    if abs(float(a.sum() - b.sum())) > same * max(a.sum(), b.sum()):
        return False
    return any(
        _difference(a, _turned(b, angle)) <= same
        for angle in np.arange(_TURNS) * (360 / _TURNS)
    )


def _difference(a: np.ndarray, b: np.ndarray) -> float:
    """Returns the share of their common volume by which two maps differ."""
    return float(np.abs(a - b).sum() / np.maximum(a, b).sum())


def _turned(heights: np.ndarray, angle: float) -> np.ndarray:
    """Turns a height map about its middle, degrees."""
    middle = (heights.shape[0] - 1) / 2
    return cv2.warpAffine(
        heights,
        cv2.getRotationMatrix2D((middle, middle), angle, 1.0),
        heights.shape,
        flags=cv2.INTER_LINEAR,
    )
