"""The targets that are searched for: named ones, and any mesh or size.

Named are ten boxes, three things and two tall ones. The boxes and things are
PROTOCOL.md's. All are red, weigh 600 kg/m³ and have their body origin at the
centre of their bounding box, with x along the length, y along the width and z
along the thickness, or upwards.
"""

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import trimesh
from scipy.spatial import ConvexHull

from xray_drake.choices import BOX_TARGETS, TALL_TARGETS, TARGET_NAMES
from xray_drake.geometry.resting import resting_poses, standing
from xray_drake.scene.meshes.files import printable
from xray_drake.scene.meshes.formats import FORMATS
from xray_drake.scene.meshes.importer import import_mesh
from xray_drake.scene.object_model import (
    ObjectModel,
    Origin,
    object_from_pieces,
)
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
    model = object_from_pieces(
        name,
        list(solid.surfaces),
        density=TARGET_DENSITY,
        collision=list(solid.hulls),
        color=TARGET_COLOR,
        recenter=False,
    )
    return replace(model, origin=Origin(name))


_SIZE = re.compile(
    r"(\d+\.?\d*)x(\d+\.?\d*)x(\d+\.?\d*)(mm|cm|m)", re.IGNORECASE
)
_UNITS = {"mm": 0.001, "cm": 0.01, "m": 1.0}
_THINNEST_SIDE, _LONGEST_SIDE = 0.003, 0.3
"""m, of a target."""


def target_complaint(target: str) -> str:
    """Returns what is wrong with the way a target is asked for, or nothing.

    Args:
        target: see :func:`make_target`. Whether a file is there is not asked.
    """
    if target in (*TARGET_NAMES, *TALL_TARGETS):
        return ""
    if found := _SIZE.fullmatch(target):
        sides = _sides(found)
        if min(sides) < _THINNEST_SIDE or max(sides) > _LONGEST_SIDE:
            return (
                f"the sides of a target must be from {1e3 * _THINNEST_SIDE:g} "
                f"to {1e3 * _LONGEST_SIDE:g} mm"
            )
        return ""
    if not is_mesh(target):
        return (
            f"choose one of {', '.join((*TARGET_NAMES, *TALL_TARGETS))}, or "
            "give a mesh file, or a size as 70x40x12mm"
        )
    return ""


def target_name(target: str) -> str:
    """Returns what a target is called; see :func:`make_target`."""
    return printable(Path(target).stem) if is_mesh(target) else target


def is_mesh(target: str) -> bool:
    """Says whether a target is a mesh file, there or not."""
    return Path(target).suffix.lower() in FORMATS


@cache
def make_target(
    target: str,
    *,
    scale: float = 1.0,
    mass: float = 0.0,
    color: tuple[float, ...] = (),
) -> ObjectModel:
    """Makes a target of a name, a size or a mesh.

    Its body frame has the origin at the centre of its bounding box, x along
    its length, y along its width, and z up as it most probably lies.

    Args:
        target: one of ``TARGET_NAMES`` or ``TALL_TARGETS``; three lengths of a
            box, as in "70x40x12mm", with mm, cm or m; or a mesh file.
        scale: metres per unit of the file.
        mass: kg; 0 stands for 600 kg/m³.
        color: red, green, blue in [0, 1]; none stands for red.

    Raises:
        ValueError: there is no such target, or the file cannot be used.
    """
    if said := target_complaint(target):
        raise ValueError(f"target {target!r}: {said}")
    if target in (*TARGET_NAMES, *TALL_TARGETS):
        model = target_model(target)
    elif found := _SIZE.fullmatch(target):
        length, width, thickness = _sides(found)
        model = object_from_pieces(
            target,
            list(box(length, width, thickness).surfaces),
            density=TARGET_DENSITY,
            color=TARGET_COLOR,
            recenter=False,
        )
        model = replace(model, origin=Origin(target))
    else:
        path = Path(target)
        model = import_mesh(
            path, target_name(target), scale=scale, density=TARGET_DENSITY
        )
        model = replace(laid(model), color=TARGET_COLOR, textured=None)
    if mass > 0:
        factor = mass / model.mass
        model = replace(model, mass=mass, inertia=factor * model.inertia)
    if color:
        red, green, blue = color
        model = replace(model, color=(red, green, blue, 1.0))
    return model


def _sides(found: re.Match[str]) -> tuple[float, ...]:
    """Returns length, width and thickness, the longest first, m."""
    *numbers, unit = found.groups()
    lengths = [_UNITS[unit.lower()] * float(number) for number in numbers]
    return tuple(sorted(lengths, reverse=True))


def laid(model: ObjectModel) -> ObjectModel:
    """Turns an object's frame so that z is up as it most probably lies.

    Its origin comes to the middle of the bounding box, x along the length.
    """
    R_BO = resting_poses(model.visual, model.p_OCom)[0].R_WO
    turned = model.visual.vertices @ R_BO.T
    around = cv2.minAreaRect(turned[:, :2].astype(np.float32))
    _, (a, b), degrees = around
    yaw = np.deg2rad(degrees if a >= b else degrees + 90)
    c, s = np.cos(yaw), np.sin(yaw)
    R_BO = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ R_BO
    turned = model.visual.vertices @ R_BO.T
    p_BO = -(turned.min(axis=0) + turned.max(axis=0)) / 2
    visual = trimesh.Trimesh(turned + p_BO, model.visual.faces, process=False)
    X_BO = np.eye(4)
    X_BO[:3, :3], X_BO[:3, 3] = R_BO, p_BO
    origin = model.origin
    return replace(
        model,
        origin=origin._replace(X_FO=origin.X_FO @ np.linalg.inv(X_BO)),
        visual=visual,
        pieces=tuple(piece @ R_BO.T + p_BO for piece in model.pieces),
        p_OCom=R_BO @ model.p_OCom + p_BO,
        inertia=R_BO @ model.inertia @ R_BO.T,
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
    if target.is_flat:
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
