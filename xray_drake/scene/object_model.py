"""One object of a heap, as geometry and mass, free of any simulator."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
import trimesh

from xray_drake.geometry.resting import lies_flat

DEFAULT_FRICTION = 0.5
"""Coulomb friction of objects, bin and fingers (PROTOCOL.md)."""

CREASE_ANGLE = np.deg2rad(35)
"""Faces that meet at less are shaded as one smooth surface."""


@dataclass(frozen=True, eq=False)
class TexturedMesh:
    """A surface with a picture on it, for colour images.

    Attributes:
        vertices: (n, 3) float32 in the body frame O, m; they repeat where the
            picture has seams.
        faces: (m, 3) int32 vertex indices.
        uv: (n, 2) float32 places in the picture, u right and v up from its
            lower left corner, each from 0 to 1.
        image: (h, w, 3) uint8 RGB.
    """

    vertices: np.ndarray
    faces: np.ndarray
    uv: np.ndarray
    image: np.ndarray


class Origin(NamedTuple):
    """What an object was made from.

    Attributes:
        source: a name of the library or of a target, a target's size, or the
            path of a mesh file.
        scale: metres per unit of the file.
        X_FO: 4×4 pose of the body frame O in the file's frame F, m.
    """

    source: str = ""
    scale: float = 1.0
    X_FO: np.ndarray = np.eye(4)


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """An object that can be dropped into a heap.

    Attributes:
        name: unique within a library.
        visual: closed mesh of the surface in the body frame O, m. Cameras see
            it and grasps are planned on it.
        pieces: convex collision pieces, each an (n, 3) array of the vertices
            of a convex hull in O, m. Their union approximates ``visual``.
        mass: kg.
        p_OCom: (3,) centre of mass in O, m.
        inertia: (3, 3) rotational inertia about the centre of mass, expressed
            in O, kg·m².
        friction: Coulomb coefficient.
        color: red, green, blue, alpha in [0, 1].
        textured: the same surface with its texture, where it has one.
        origin: what it was made from.
    """

    name: str
    visual: trimesh.Trimesh
    pieces: tuple[np.ndarray, ...]
    mass: float
    p_OCom: np.ndarray
    inertia: np.ndarray
    friction: float = DEFAULT_FRICTION
    color: tuple[float, float, float, float] = (0.6, 0.6, 0.6, 1.0)
    textured: TexturedMesh | None = None
    origin: Origin = field(default_factory=Origin)

    def __deepcopy__(self, memo: dict) -> "ObjectModel":
        return self

    @property
    def extents(self) -> np.ndarray:
        """The (3,) size of the axis-aligned bounding box in O, m."""
        return self.visual.extents

    @cached_property
    def is_flat(self) -> bool:
        """It lies flat, z axis up or down, as a rule.

        See :func:`~xray_drake.geometry.resting.lies_flat`.
        """
        return lies_flat(self.visual, self.p_OCom)


def object_from_pieces(
    name: str,
    pieces: list[trimesh.Trimesh],
    *,
    density: float,
    collision: list[np.ndarray] | None = None,
    color: tuple[float, float, float, float] = (0.6, 0.6, 0.6, 1.0),
    friction: float = DEFAULT_FRICTION,
    recenter: bool = True,
) -> ObjectModel:
    """Makes an object whose shape is the union of convex pieces.

    Args:
        name: its name.
        pieces: closed convex meshes, m, in any common frame.
        density: kg/m³ of the union.
        collision: convex collision pieces, (n, 3) vertices each, in the same
            frame; by default the vertices of ``pieces``.
        color: red, green, blue, alpha in [0, 1].
        friction: Coulomb coefficient.
        recenter: put the body frame's origin at the centre of mass; otherwise
            it stays where the pieces have it.

    Raises:
        ValueError: no piece, or a union without volume.
    """
    if not pieces:
        raise ValueError(f"object {name!r}: no pieces")
    visual = (
        pieces[0].copy()
        if len(pieces) == 1
        else trimesh.boolean.union(pieces, engine="manifold")
    )
    if not visual.volume > 0:
        raise ValueError(f"object {name!r}: its pieces enclose no volume")
    hulls = collision or [np.array(piece.vertices) for piece in pieces]
    visual.density = density
    offset = visual.center_mass if recenter else np.zeros(3)
    visual.apply_translation(-offset)
    return ObjectModel(
        name=name,
        visual=visual,
        pieces=tuple(np.asarray(hull, dtype=float) - offset for hull in hulls),
        mass=float(visual.mass),
        p_OCom=np.array(visual.center_mass),
        inertia=np.array(visual.moment_inertia),
        friction=friction,
        color=color,
    )


def shaded(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Splits the vertices along creases, so that edges look sharp."""
    return trimesh.graph.smooth_shade(
        mesh, angle=CREASE_ANGLE, facet_minarea=None
    )
