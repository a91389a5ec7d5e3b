"""Packaged variants: an object on a rectangular backing card.

The paper tests on such objects too (its 13 "packaged" YCB objects).
"""

from typing import Any

import cv2
import numpy as np
import trimesh

from xray_drake.scene.object_model import ObjectModel, TexturedMesh

PACKAGED = "_packaged"
"""What is added to the name."""

CARD_DENSITY = 200.0
"""kg/m³ of corrugated cardboard."""

CARD_THICKNESS = (0.003, 0.004)
"""m."""

CARD_COLOR = (176, 148, 112)
"""RGB of the card where the object has a texture; else it has the object's
colour."""

MARGIN = (1.2, 1.6)
"""Length and width of the card in those of the object's footprint."""

LARGEST_CARD = 0.25
"""m, the longest side."""

_SUNK = 0.0005
"""m. So far the object is set into the card, so that the two are one body."""


def packaged_model(model: ObjectModel, seed: int) -> ObjectModel:
    """Puts an object on a card, on its flattest side.

    The card takes the object's friction, and its colour or, beside a texture,
    that of cardboard. Body frame: the origin at
    the common centre of mass, z across the card, x along the card's length.

    Args:
        model: any object; its mesh need not be closed.
        seed: of the card's size and of the object's place on it.

    Returns:
        An object called ``NAME_packaged``.
    """
    rng = np.random.default_rng(seed)
    R = flattest_side(model)
    turned = np.asarray(model.visual.vertices) @ R.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    footprint = (high - low)[:2]
    size = np.minimum(footprint * rng.uniform(*MARGIN, size=2), LARGEST_CARD)
    thickness = rng.uniform(*CARD_THICKNESS)
    play = np.maximum(size - footprint, 0) / 2
    shift = rng.uniform(-0.6, 0.6, size=2) * play
    # In the frame whose origin is in the middle of the card's top.
    p = np.append(shift - (low + high)[:2] / 2, -low[2] - _SUNK)

    card = trimesh.creation.box((*size, thickness))
    card.apply_translation((0, 0, -thickness / 2))
    card_mass = CARD_DENSITY * float(card.volume)
    card_center = np.array([0, 0, -thickness / 2])
    squares = np.append(size, thickness) ** 2
    card_inertia = card_mass / 12 * np.diag(squares.sum() - squares)

    object_center = R @ model.p_OCom + p
    mass = model.mass + card_mass
    center = (model.mass * object_center + card_mass * card_center) / mass
    inertia = (
        R @ model.inertia @ R.T
        + _parallel_axes(model.mass, object_center - center)
        + card_inertia
        + _parallel_axes(card_mass, card_center - center)
    )

    X = np.eye(4)
    X[:3, :3], X[:3, 3] = R, p - center
    card.apply_translation(-center)
    visual: Any = model.visual.copy().apply_transform(X)
    if visual.is_volume:
        visual = trimesh.boolean.union([visual, card], engine="manifold")
    else:
        visual = trimesh.util.concatenate([visual, card])
    pieces = [piece @ R.T + X[:3, 3] for piece in model.pieces]
    return ObjectModel(
        name=model.name + PACKAGED,
        visual=visual,
        pieces=(*pieces, np.array(card.vertices)),
        mass=mass,
        p_OCom=np.zeros(3),
        inertia=(inertia + inertia.T) / 2,
        friction=model.friction,
        color=model.color,
        textured=None
        if model.textured is None
        else _textured(model.textured, X, card),
    )


def flattest_side(model: ObjectModel) -> np.ndarray:
    """Finds how an object lies flattest.

    Of the faces of its convex hull on which it stays put, since the centre of
    mass is above them, the one over which it is lowest; of those as low, the
    one over which its centre of mass is.

    Returns:
        (3, 3) rotation to a frame with that face down, and x along the length
        of the smallest rectangle that holds the object seen from above.
    """
    hull = model.visual.convex_hull
    normals = np.asarray(hull.face_normals)
    heights = np.ptp(np.asarray(hull.vertices) @ normals.T, axis=0)
    stays = np.zeros(len(normals), dtype=bool)
    for group in _coplanar(hull):
        along = _to_floor(normals[group[0]])
        outline = np.asarray(hull.triangles)[group].reshape(-1, 3) @ along.T
        floor = cv2.convexHull(outline[:, :2].astype(np.float32))
        x, y, _ = along @ model.p_OCom
        inside = cv2.pointPolygonTest(floor, (float(x), float(y)), False) >= 0
        stays[group] = inside
    if not stays.any():
        stays[:] = True
    # To a micrometre, so that equal sides are chosen by their order.
    lowest = heights <= heights[stays].min() + 1e-6
    origins = np.asarray(hull.triangles)[:, 0]
    depths = np.einsum("ij,ij->i", origins - model.p_OCom, normals).round(6)
    best = int(np.argmin(np.where(stays & lowest, depths, np.inf)))
    R = _to_floor(normals[best])
    seen = (np.asarray(hull.vertices) @ R.T)[:, :2]
    _, (width, depth), degrees = cv2.minAreaRect(seen.astype(np.float32))
    yaw = -np.deg2rad(degrees + (90 if depth > width else 0))
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ R


def _coplanar(hull: trimesh.Trimesh) -> list[np.ndarray]:
    """Groups the faces of a hull that lie in one plane."""
    groups = [np.asarray(facet) for facet in hull.facets]
    grouped = {int(face) for group in groups for face in group}
    return groups + [
        np.array([face])
        for face in range(len(hull.faces))
        if face not in grouped
    ]


def _to_floor(normal: np.ndarray) -> np.ndarray:
    """Returns a rotation that turns an outward normal down."""
    return trimesh.geometry.align_vectors(normal, (0, 0, -1))[:3, :3]


def _textured(
    textured: TexturedMesh, X: np.ndarray, card: trimesh.Trimesh
) -> TexturedMesh:
    """Moves a textured mesh and adds a card, coloured by new rows below."""
    height, width = textured.image.shape[:2]
    rows = max(height // 16, 4)
    below = np.full((rows, width, 3), CARD_COLOR, dtype=np.uint8)
    u, v = textured.uv.T
    middle = (0.5, rows / 2 / (height + rows))
    return TexturedMesh(
        vertices=np.concatenate(
            [textured.vertices @ X[:3, :3].T + X[:3, 3], card.vertices]
        ).astype(np.float32),
        faces=np.concatenate(
            [textured.faces, card.faces + len(textured.vertices)]
        ).astype(np.int32),
        uv=np.concatenate(
            [
                np.column_stack([u, (v * height + rows) / (height + rows)]),
                np.tile(middle, (len(card.vertices), 1)),
            ]
        ).astype(np.float32),
        image=np.concatenate([textured.image, below]),
    )


def _parallel_axes(mass: float, p: np.ndarray) -> np.ndarray:
    return mass * (np.dot(p, p) * np.eye(3) - np.outer(p, p))
