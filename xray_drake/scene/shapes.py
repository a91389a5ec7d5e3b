"""Solids built from convex parts that are known while building.

Every solid carries two shapes: closed surfaces for cameras and grasps, in which
round things have 24 sides, and convex collision hulls, in which they have
eight, or six where they are slender. Octagon and hexagon are chosen to have the
area of the 24-gon, so the two shapes agree in volume; an octagon lies at most
3 % of the radius inside and 5 % outside, a hexagon 6 % and 10 %.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import trimesh

VISUAL_SIDES = 24
COLLISION_SIDES = 8
SLENDER_SIDES = 6
SLENDER = 0.016
"""m. Rods up to this radius have six sides as collision pieces."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A shape as it looks and as it collides.

    Attributes:
        surfaces: closed meshes, m, whose union is the surface.
        hulls: (n, 3) vertices of each convex collision piece, m.
    """

    surfaces: tuple[trimesh.Trimesh, ...]
    hulls: tuple[np.ndarray, ...]

    def __add__(self, other: "Solid") -> "Solid":
        return Solid(self.surfaces + other.surfaces, self.hulls + other.hulls)

    def transformed(self, X: np.ndarray) -> "Solid":
        """Returns the solid moved by the 4×4 rigid transform ``X``."""
        return Solid(
            tuple(mesh.copy().apply_transform(X) for mesh in self.surfaces),
            tuple(hull @ X[:3, :3].T + X[:3, 3] for hull in self.hulls),
        )

    def stretched(self, factors: Sequence[float] | np.ndarray) -> "Solid":
        """Returns the solid stretched about the origin.

        Args:
            factors: (3,) along x, y and z.
        """
        return Solid(
            tuple(mesh.copy().apply_scale(factors) for mesh in self.surfaces),
            tuple(hull * np.asarray(factors) for hull in self.hulls),
        )

    def moved(self, x: float = 0, y: float = 0, z: float = 0) -> "Solid":
        """Returns the solid shifted, m."""
        X = np.eye(4)
        X[:3, 3] = x, y, z
        return self.transformed(X)

    def turned(self, axis: Sequence[float], angle: float) -> "Solid":
        """Returns the solid turned about an axis through the origin, rad."""
        return self.transformed(
            trimesh.transformations.rotation_matrix(angle, axis)
        )


def polygon(radius: float, sides: int, squash: float = 1) -> np.ndarray:
    """Returns a regular polygon with the area of the 24-gon of ``radius``.

    Args:
        radius: circumradius of the 24-gon, m.
        sides: number of sides; the first side crosses the x-axis squarely.
        squash: factor on y, which makes an oval.

    Returns:
        (sides, 2) corners, counterclockwise, m.
    """
    angles = (np.arange(sides) + 0.5) * 2 * np.pi / sides
    r = radius * _area_factor(2 * np.pi / sides)
    return r * np.stack([np.cos(angles), squash * np.sin(angles)], axis=1)


def convex(vertices: np.ndarray) -> Solid:
    """Returns the convex hull of (n, 3) vertices, m; it looks as it collides.

    Raises:
        scipy.spatial.QhullError: the points lie in a plane.
    """
    mesh = trimesh.Trimesh(vertices).convex_hull
    return Solid((mesh,), (np.array(mesh.vertices),))


def box(
    length: float,
    width: float,
    height: float,
    center: Sequence[float] | np.ndarray = (0, 0, 0),
) -> Solid:
    """Returns a box along the axes.

    Args:
        length: along x, m.
        width: along y, m.
        height: along z, m.
        center: (3,) of it, m.
    """
    mesh = trimesh.creation.box((length, width, height))
    mesh.apply_translation(center)
    return Solid((mesh,), (np.array(mesh.vertices),))


def slab(
    length: float, width: float, height: float, x: float = 0, y: float = 0
) -> Solid:
    """Returns a box that stands on z = 0, its middle at (x, y), m."""
    return box(length, width, height, (x, y, height / 2))


def taper(
    start: float, near: float, end: float, far: float, height: float
) -> Solid:
    """Returns a bar along x on z = 0 that gets wider or narrower.

    Args:
        start: x of the one end, m.
        near: width there, m.
        end: x of the other end, m.
        far: width there, m.
        height: m.
    """
    outline = [
        [start, -near / 2],
        [end, -far / 2],
        [end, far / 2],
        [start, near / 2],
    ]
    return prism(np.array(outline), height)


def prism(outline: np.ndarray, height: float) -> Solid:
    """Returns a prism from z = 0 to ``height`` over a convex (n, 2) outline."""
    return convex(_between(outline, outline, height))


def frustum(
    bottom: float,
    top: float,
    height: float,
    squash: float = 1,
    *,
    sides: int = COLLISION_SIDES,
) -> Solid:
    """Returns a round frustum standing on z = 0.

    Args:
        bottom: its radius at z = 0, m.
        top: its radius at ``height``, m.
        height: m.
        squash: factor on y, which makes it oval.
        sides: of the collision piece.
    """

    def vertices(sides: int) -> np.ndarray:
        return _between(
            polygon(bottom, sides, squash),
            polygon(top, sides, squash),
            height,
        )

    surface = trimesh.Trimesh(vertices(VISUAL_SIDES)).convex_hull
    return Solid((surface,), (vertices(sides),))


def cylinder(
    radius: float,
    height: float,
    squash: float = 1,
    *,
    sides: int = COLLISION_SIDES,
) -> Solid:
    """Returns a cylinder standing on z = 0; ``squash`` scales its y."""
    return frustum(radius, radius, height, squash, sides=sides)


def rod(
    start: Sequence[float],
    end: Sequence[float],
    radius: float,
    end_radius: float | None = None,
) -> Solid:
    """Returns a round bar between two points.

    Args:
        start: (3,) centre of one end, m.
        end: (3,) centre of the other, m.
        radius: at the start, m.
        end_radius: at the end, m; by default the same.
    """
    if end_radius is None:
        end_radius = radius
    slender = max(radius, end_radius) <= SLENDER
    along = np.subtract(end, start).astype(float)
    X = trimesh.geometry.align_vectors((0, 0, 1), along)
    X[:3, 3] = start
    return frustum(
        radius,
        end_radius,
        float(np.linalg.norm(along)),
        sides=SLENDER_SIDES if slender else COLLISION_SIDES,
    ).transformed(X)


def beam(
    start: Sequence[float], end: Sequence[float], width: float, height: float
) -> Solid:
    """Returns a bar of rectangular section along a line in the xy-plane.

    Args:
        start: (x, y) of the middle of one end, m.
        end: (x, y) of the other, m.
        width: across the line in the plane, m.
        height: from z = 0, m.
    """
    along = np.subtract(end, start)
    length = float(np.linalg.norm(along))
    bar = box(length, width, height, (length / 2, 0, height / 2))
    angle = float(np.arctan2(along[1], along[0]))
    return bar.turned((0, 0, 1), angle).moved(*start)


def ellipsoid(radii: Sequence[float]) -> Solid:
    """Returns an ellipsoid about the origin: 42 points seen, 12 felt.

    Args:
        radii: (3,) along x, y and z, m; the collision piece reaches 13 %
            farther in twelve directions.
    """
    surface = trimesh.creation.icosphere(subdivisions=1)
    core = trimesh.creation.icosahedron()
    scale = (surface.volume / core.volume) ** (1 / 3)
    hull = np.array(core.vertices) * scale * np.asarray(radii)
    surface.apply_scale(radii)
    return Solid((surface,), (hull,))


def loft(bottom: np.ndarray, top: np.ndarray, height: float) -> Solid:
    """Returns the hull of two convex (n, 2) outlines at z = 0 and above."""
    return convex(_between(bottom, top, height))


def arc(
    inner: float,
    outer: float,
    height: float,
    angle: float = 2 * np.pi,
    pieces: int = COLLISION_SIDES,
) -> Solid:
    """Returns a part of a flat ring about the z-axis, standing on z = 0.

    Args:
        inner: radius of the hole, m.
        outer: outer radius, m.
        height: m.
        angle: from the x-axis counterclockwise, rad; 2π closes the ring.
        pieces: number of collision pieces, wedges of 8 vertices.
    """
    closed = angle > 2 * np.pi - 1e-9
    steps = max(round(angle / (2 * np.pi) * VISUAL_SIDES), 2)
    surface = _swept(
        _rectangles(inner, outer, height, np.linspace(0, angle, steps + 1)),
        closed,
    )
    factor = _area_factor(angle / pieces)
    corners = _rectangles(
        inner * factor,
        outer * factor,
        height,
        np.linspace(0, angle, pieces + 1),
    )
    hulls = tuple(np.concatenate(pair) for pair in pairwise(corners))
    return Solid((surface,), hulls)


def cup(
    bottom: float, top: float, height: float, wall: float, floor: float
) -> Solid:
    """Returns an open round vessel standing on z = 0: 9 collision pieces.

    Args:
        bottom: outer radius at z = 0, m.
        top: outer radius at the rim, m.
        height: m.
        wall: horizontal thickness of the wall, m.
        floor: thickness of the floor, m.
    """
    inner_bottom = bottom - wall + (top - bottom) * floor / height
    profile = np.array(
        [
            [0, 0],
            [bottom, 0],
            [top, height],
            [top - wall, height],
            [inner_bottom, floor],
            [0, floor],
        ]
    )
    half_step = np.pi / VISUAL_SIDES
    surface = trimesh.creation.revolve(
        profile,
        sections=VISUAL_SIDES,
        transform=trimesh.transformations.rotation_matrix(half_step, (0, 0, 1)),
    )
    factor = _area_factor(2 * np.pi / COLLISION_SIDES)
    angles = (
        (np.arange(COLLISION_SIDES + 1) + 0.5) * 2 * np.pi / COLLISION_SIDES
    )
    low, high = (
        _rectangles((radius - wall) * factor, radius * factor, height, angles)
        for radius in (bottom, top)
    )
    ends = np.concatenate([low[:, :2], high[:, 2:]], axis=1)
    walls = tuple(np.concatenate(pair) for pair in pairwise(ends))
    return Solid((surface,), (*walls, *frustum(bottom, bottom, floor).hulls))


def box_of(vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Recognises an axis-aligned box.

    Args:
        vertices: (n, 3) points, m.

    Returns:
        Its (3,) size and (3,) centre, m; ``None`` unless the points are the
        eight corners of a box, to within a nanometre.
    """
    if len(vertices) != 8:
        return None
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    at_low = np.abs(vertices - low) < 1e-9
    at_high = np.abs(vertices - high) < 1e-9
    corners = {tuple(row) for row in at_high}
    if not (at_low | at_high).all() or len(corners) != 8:
        return None
    return high - low, (high + low) / 2


def _area_factor(step: float) -> float:
    """Circumradius for chords of ``step`` rad, relative to the 24-gon's."""

    def area(angle: float) -> float:
        return np.sin(angle) / angle

    return float(np.sqrt(area(2 * np.pi / VISUAL_SIDES) / area(step)))


def _between(low: np.ndarray, high: np.ndarray, height: float) -> np.ndarray:
    return np.concatenate(
        [
            np.column_stack([low, np.zeros(len(low))]),
            np.column_stack([high, np.full(len(high), height)]),
        ]
    )


def _rectangles(
    inner: float, outer: float, height: float, angles: np.ndarray
) -> np.ndarray:
    """Returns (m, 4, 3) radial cross sections, the lower two corners first."""
    radii = np.array([inner, outer, outer, inner])
    return np.stack(
        [
            np.outer(np.cos(angles), radii),
            np.outer(np.sin(angles), radii),
            np.tile([0, 0, height, height], (len(angles), 1)),
        ],
        axis=2,
    )


def _swept(sections: np.ndarray, closed: bool) -> trimesh.Trimesh:
    """Joins (m, n, 3) cross sections; where closed, the last is the first."""
    if closed:
        sections = sections[:-1]
    m, n = sections.shape[:2]
    index = np.arange(m * n).reshape(m, n)
    here = index if closed else index[:-1]
    there = np.roll(index, -1, axis=0) if closed else index[1:]
    a, b = here, np.roll(here, -1, axis=1)
    c, d = there, np.roll(there, -1, axis=1)
    faces = [
        np.stack([a, c, b], axis=-1).reshape(-1, 3),
        np.stack([b, c, d], axis=-1).reshape(-1, 3),
    ]
    if not closed:
        fan = np.array([[0, k, k + 1] for k in range(1, n - 1)])
        faces += [index[0][fan], index[-1][fan[:, ::-1]]]
    mesh = trimesh.Trimesh(sections.reshape(-1, 3), np.concatenate(faces))
    if mesh.volume < 0:
        mesh.invert()
    return mesh
