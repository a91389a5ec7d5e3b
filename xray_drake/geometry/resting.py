"""How a rigid body can lie at rest on the floor, and how likely each way is."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import trimesh

from xray_drake.geometry.silhouette import height_map

_REACH = 60
"""Half width of the height maps that poses are compared by, cells."""

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
    return _find(
        np.asarray(mesh.vertices, dtype=float).tobytes(),
        np.asarray(mesh.faces, dtype=np.int64).tobytes(),
        np.asarray(com, dtype=float).tobytes(),
        least_share,
        same,
    )


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
    vertex_bytes: bytes,
    face_bytes: bytes,
    com_bytes: bytes,
    least_share: float,
    same: float,
) -> tuple[RestingPose, ...]:
    vertices = np.frombuffer(vertex_bytes).reshape(-1, 3)
    faces = np.frombuffer(face_bytes, dtype=np.int64).reshape(-1, 3)
    p_OCom = np.frombuffer(com_bytes)
    spread = np.linalg.svd(vertices - vertices.mean(axis=0), compute_uv=False)
    if len(spread) < 3 or spread[-1] <= 1e-9 * spread[0]:
        raise ValueError("a body without volume does not rest")
    hull = trimesh.Trimesh(vertices, faces, process=False).convex_hull
    transforms, shares = trimesh.poses.compute_stable_poses(
        hull, center_mass=p_OCom, threshold=0.0
    )
    if not len(shares):
        raise ValueError("the mesh has no stable pose")
    poses: list[tuple[np.ndarray, np.ndarray]] = []
    totals: list[float] = []
    downs: list[list[np.ndarray]] = []
    pitch = float(np.linalg.norm(np.ptp(vertices, axis=0))) / _REACH
    # A stable sort: equal shares keep the order in which they were found.
    for index in np.argsort(-shares.round(9), kind="stable"):
        if shares[index] <= 0:
            continue
        R_WO = np.array(transforms[index][:3, :3])
        heights = _centered(standing(vertices, R_WO), faces, pitch)
        for k, (_, known) in enumerate(poses):
            if _is_same(known, heights, same):
                totals[k] += float(shares[index])
                downs[k].append(-R_WO[2])
                break
        else:
            poses.append((R_WO, heights))
            downs.append([-R_WO[2]])
            totals.append(float(shares[index]))
    share = np.array(totals) / sum(totals)
    kept = [k for k in np.argsort(-share, kind="stable")]
    kept = [k for k in kept if share[k] >= least_share or k == kept[0]]
    whole = sum(share[k] for k in kept)
    return tuple(
        RestingPose(poses[k][0], float(share[k] / whole), np.array(downs[k]))
        for k in kept
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
