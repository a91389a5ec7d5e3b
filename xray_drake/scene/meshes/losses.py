"""What the simplification to a few convex pieces loses."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import ConvexHull

from xray_drake.geometry.convex import CUBE_AXES
from xray_drake.geometry.silhouette import facing_triangles, fill_convex
from xray_drake.scene.meshes.solids import solid, union

SILHOUETTE_PIXELS = 160
"""Along the diagonal of the bounding box."""


@dataclass(frozen=True)
class Losses:
    """How a union of convex pieces differs from the surface they stand for.

    Attributes:
        missing: volume of the surface's inside that no piece covers, as a
            share of that inside.
        added: volume of the pieces outside the surface, as a share of the
            surface's convex hull: what of its hollows is filled.
        volume: relative error of the volume; its sign is that of the error.
        silhouette: one less the worst intersection over union of the two
            silhouettes, seen from 13 directions.
    """

    missing: float
    added: float
    volume: float
    silhouette: float


@dataclass(frozen=True)
class LossLimits:
    """The most that an imported object may lose; see :class:`Losses`."""

    missing: float = 0.25
    added: float = 0.45
    silhouette: float = 0.2

    def exceeded(self, losses: Losses) -> str:
        """Says in one line which limit losses exceed; "" if none."""
        for name, words in (
            ("missing", "miss {:.0%} of its volume"),
            ("added", "fill {:.0%} of its hull beyond its volume"),
            ("silhouette", "change its silhouette by {:.0%}"),
        ):
            value, limit = getattr(losses, name), getattr(self, name)
            if value > limit:
                return (
                    f"its convex pieces {words.format(value)} (limit "
                    f"{limit:.0%}): allow more pieces or vertices"
                )
        return ""

    def check(self, losses: Losses) -> None:
        """Checks losses.

        Raises:
            ValueError: one is beyond its limit.
        """
        reason = self.exceeded(losses)
        if reason:
            raise ValueError(reason)


def measure_losses(
    surface: trimesh.Trimesh, pieces: Sequence[np.ndarray]
) -> Losses:
    """Compares pieces with the surface they stand for.

    Args:
        surface: closed mesh, m.
        pieces: (n, 3) vertices each, m.
    """
    inside, joint = solid(surface), union(pieces)
    common = (inside ^ joint).volume()
    volume = inside.volume()
    return Losses(
        missing=max(1 - common / volume, 0.0),
        added=max(joint.volume() - common, 0.0) / inside.hull().volume(),
        volume=joint.volume() / volume - 1,
        silhouette=max(
            _silhouette_loss(surface, pieces, direction)
            for direction in CUBE_AXES
        ),
    )


def _silhouette_loss(
    surface: trimesh.Trimesh, pieces: Sequence[np.ndarray], axis: np.ndarray
) -> float:
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(helper, axis)
    x /= np.linalg.norm(x)
    basis = np.stack([x, np.cross(axis, x)], axis=1)
    pixels = SILHOUETTE_PIXELS / float(surface.scale)
    drawn = [np.asarray(surface.vertices) @ basis * pixels]
    drawn += [np.asarray(piece) @ basis * pixels for piece in pieces]
    low = np.min([points.min(axis=0) for points in drawn], axis=0) - 2
    high = np.max([points.max(axis=0) for points in drawn], axis=0) + 2
    width, height = np.ceil(high - low).astype(int)
    true, simple = np.zeros((2, height, width), dtype=np.uint8)
    # Seen from either side a silhouette is the same, so the triangles that
    # turn away would do as well as those that face the viewer.
    faces = np.asarray(surface.faces)
    fill_convex(true, facing_triangles(drawn[0] - low, faces))
    for points in drawn[1:]:
        outline = points[ConvexHull(points).vertices] - low
        fill_convex(simple, outline[None])
    either = float(np.count_nonzero(true | simple))
    return 1 - float(np.count_nonzero(true & simple)) / max(either, 1.0)
