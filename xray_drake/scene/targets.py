"""The targets that are searched for: ten boxes, three things, two tall ones.

The boxes and things are PROTOCOL.md's. All are red, weigh 600 kg/m³ and have
their body origin at the centre of their bounding box, with x along the length,
y along the width and z along the thickness, or upwards.
"""

from collections.abc import Callable
from functools import cache

import numpy as np
import trimesh
from scipy.spatial import ConvexHull

from xray_drake.choices import BOX_TARGETS, TALL_TARGETS, TARGET_NAMES
from xray_drake.geometry.resting import resting_poses, standing
from xray_drake.scene.object_model import ObjectModel, object_from_pieces
from xray_drake.scene.shapes import Solid, arc, box, cylinder, prism

TARGET_COLOR = (0.8, 0.05, 0.05, 1.0)
TARGET_DENSITY = 600.0
"""kg/m³."""

_THINNEST = 0.004
"""m. Half of it is more than the noise of the floor's depth."""

LID_SIZE = (0.060, 0.057, 0.010)
DOMINO_SIZE = (0.048, 0.024, 0.0075)
FLUTE_SIZE = (0.110, 0.022, 0.016)
CUBE_SIDE = 0.060
MUG_DIAMETER, MUG_HEIGHT = 0.070, 0.080


@cache
def target_model(name: str) -> ObjectModel:
    """Returns a target.

    The flute collides as a solid octagonal prism but has the mass and inertia
    of the tube that is seen.

    Args:
        name: one of ``TARGET_NAMES`` or ``TALL_TARGETS``.

    Raises:
        ValueError: no target has this name.
    """
    names = (*TARGET_NAMES, *TALL_TARGETS)
    if name not in names:
        raise ValueError(
            f"no target is called {name!r}; there are {', '.join(names)}"
        )
    if name in BOX_TARGETS:
        ratio = 1 + BOX_TARGETS.index(name)
        solid = box(0.03 * ratio**0.5, 0.03 / ratio**0.5, 0.005)
    else:
        solid = _SHAPES[name]()
    return object_from_pieces(
        name,
        list(solid.surfaces),
        density=TARGET_DENSITY,
        collision=list(solid.hulls),
        color=TARGET_COLOR,
        recenter=False,
    )


def _lid() -> Solid:
    """A round-cornered plate with a raised rim; 9 collision pieces."""
    length, width, height = LID_SIZE
    corner, rim, plate = 0.012, 0.003, 0.003
    bottom = -height / 2

    def rounded(inset: float, segments: int) -> np.ndarray:
        return _rounded_rectangle(
            length - 2 * inset, width - 2 * inset, corner - inset, segments
        )

    outer = prism(rounded(0, 6), height).moved(z=bottom).surfaces[0]
    hollow = prism(rounded(rim, 6), height).moved(z=bottom + plate).surfaces[0]
    surface = trimesh.boolean.difference([outer, hollow], engine="manifold")

    base = prism(rounded(0, 1), plate).moved(z=bottom).hulls
    outside, inside = rounded(0, 1), rounded(rim, 1)
    walls = [
        prism(
            np.array([outside[i], outside[i - 1], inside[i - 1], inside[i]]),
            height,
        )
        .moved(z=bottom)
        .hulls[0]
        for i in range(len(outside))
    ]
    return Solid((surface,), (*base, *walls))


def _flute() -> Solid:
    """An elliptical tube, open at both ends, with six finger holes on top."""
    length, width, height = FLUTE_SIZE
    wall, hole_radius, spacing, first = 0.002, 0.003, 0.013, -0.022

    def rod(angles: np.ndarray, scale: float, length: float) -> Solid:
        outline = scale * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        half = np.array([height, width]) / 2
        along_z = prism(outline * half, length).moved(z=-length / 2)
        return along_z.turned((0, 1, 0), np.pi / 2)

    fine = np.arange(32) * np.pi / 16
    outer = rod(fine, 1, length).surfaces[0]
    bore = rod(fine, 1, 2 * length).surfaces[0]
    bore.apply_scale([1, 1 - 2 * wall / width, 1 - 2 * wall / height])
    drills = [
        trimesh.creation.cylinder(
            hole_radius,
            height,
            sections=16,
            transform=trimesh.transformations.translation_matrix(
                [first + i * spacing, 0, height / 2]
            ),
        )
        for i in range(6)
    ]
    surface = trimesh.boolean.difference(
        [outer, bore, *drills], engine="manifold"
    )
    octagon = (np.arange(8) + 0.5) * np.pi / 4
    return Solid((surface,), rod(octagon, 1 / np.cos(np.pi / 8), length).hulls)


def _mug() -> Solid:
    """A cup with a square handle along x; 16 collision pieces."""
    radius, wall, bottom = MUG_DIAMETER / 2, 0.004, 0.005
    bar, width, gap, rise = 0.008, 0.012, 0.019, 0.048
    # The handle reaches into the wall, lest a slit is left.
    start, end = radius - wall / 2, radius + gap + bar
    middle = MUG_HEIGHT / 2
    arm = box(end - start, width, bar, ((start + end) / 2, 0, middle))
    solid = (
        arc(radius - wall, radius, MUG_HEIGHT, pieces=12)
        + cylinder(radius - wall / 2, bottom)
        + arm.moved(z=(rise - bar) / 2)
        + arm.moved(z=-(rise - bar) / 2)
        + box(bar, width, rise, (end - bar / 2, 0, middle))
    )
    return solid.moved(x=-(end - radius) / 2, z=-middle)


_SHAPES: dict[str, Callable[[], Solid]] = {
    "lid": _lid,
    "domino": lambda: box(*DOMINO_SIZE),
    "flute": _flute,
    "cube": lambda: box(CUBE_SIDE, CUBE_SIDE, CUBE_SIDE),
    "mug": _mug,
}


def size_in_any_pose(target: ObjectModel) -> np.ndarray:
    """Returns the size by which policies reckon with a target.

    For one that lies flat, its length, width and thickness. One that may lie
    on any face reaches at most as far as its bounding box's diagonal and
    covers at least as much as its smallest silhouette; and since its sides
    are seen, nothing but the floor itself shows that it is not there. A flat
    box that is so long and covers so little stands for it.

    Returns:
        (3,) length, width, thickness, m.
    """
    if target.name not in TALL_TARGETS:
        return target.extents
    diagonal = float(np.linalg.norm(target.extents))
    areas = [
        ConvexHull(standing(target.visual.vertices, pose.R_WO)[:, :2]).volume
        for pose in resting_poses(target.visual, target.p_OCom)
    ]
    # length² + width² = diagonal², length · width = area
    total, twice = diagonal**2, 2 * min(areas)
    apart = np.sqrt(max(total - twice, 0.0))
    together = np.sqrt(total + twice)
    return np.array([(together + apart) / 2, (together - apart) / 2, _THINNEST])


def _rounded_rectangle(
    length: float, width: float, radius: float, segments: int
) -> np.ndarray:
    """Returns the counterclockwise outline of a rectangle with round corners.

    Args:
        length: size along x, m.
        width: size along y, m.
        radius: of the corners, m.
        segments: chords per corner. One makes a chamfer that cuts off as much
            area as the arc.

    Returns:
        (4·(segments + 1), 2) points, m.
    """
    cut = radius if segments > 1 else radius * np.sqrt(2 - np.pi / 2)
    angles = np.linspace(0, np.pi / 2, segments + 1)
    corner = cut * np.column_stack([np.cos(angles), np.sin(angles)])
    center = np.array([length, width]) / 2 - cut
    points = []
    for turn in range(4):
        c, s = np.cos(turn * np.pi / 2), np.sin(turn * np.pi / 2)
        signs = np.sign([c - s, s + c])
        points.append(corner @ np.array([[c, s], [-s, c]]) + signs * center)
    return np.concatenate(points)
