"""Packaging and vessels: cartons, cans, bottles, cups, bowls, trays."""

import numpy as np

from xray_drake.scene.families.family import Family
from xray_drake.scene.shapes import (
    Solid,
    box,
    convex,
    cup,
    cylinder,
    frustum,
    slab,
)


def carton(rng: np.random.Generator) -> Solid:
    """A folding box; every third has the gable of a milk carton."""
    length, width = rng.uniform(0.06, 0.14), rng.uniform(0.038, 0.075)
    height = rng.uniform(0.022, 0.042)
    body = box(length, width, height)
    if rng.random() > 1 / 3:
        return body
    gable = rng.uniform(0.25, 0.45) * width
    x, y, z = length / 2, width / 2, height / 2
    corners = [[x, v, w] for v in (y, -y) for w in (z, -z)]
    ridge = [[x + gable, v, 0] for v in (y, -y)]
    return body + convex(np.array(corners + ridge))


def book(rng: np.random.Generator) -> Solid:
    """A book: pages between two covers that overhang on three sides."""
    length, width = rng.uniform(0.09, 0.155), rng.uniform(0.06, 0.105)
    thickness = rng.uniform(0.014, 0.032)
    cover, overhang = 0.003, 0.004
    inside, y = thickness - cover, -overhang / 2
    solid = box(length - 2 * overhang, width - overhang, inside, (0, y, 0))
    solid += box(length, cover, inside, (0, -(width - cover) / 2, 0))
    for z in (inside / 2, -inside / 2):
        solid += box(length, width, cover, (0, 0, z))
    return solid


def can(rng: np.random.Generator) -> Solid:
    """A cylinder; two in three have a wider or narrower lid."""
    radius, height = rng.uniform(0.016, 0.034), rng.uniform(0.045, 0.125)
    body = cylinder(radius, height)
    kind = rng.integers(3)
    if kind == 0:
        return body
    lid_radius = radius * (1.1 if kind == 1 else 0.85)
    lid_height = rng.uniform(0.010, 0.018)
    return body + cylinder(lid_radius, lid_height).moved(z=height - 0.001)


def bottle(rng: np.random.Generator) -> Solid:
    """A round bottle: body, shoulder and neck."""
    radius, height = rng.uniform(0.018, 0.032), rng.uniform(0.06, 0.105)
    shoulder = rng.uniform(0.010, 0.026)
    neck_radius = rng.uniform(0.007, 0.4 * radius + 0.001)
    neck = rng.uniform(0.018, 0.036)
    return (
        cylinder(radius, height)
        + frustum(radius, neck_radius, shoulder).moved(z=height)
        + cylinder(neck_radius, neck + 0.002).moved(z=height + shoulder - 0.002)
    )


def flask(rng: np.random.Generator) -> Solid:
    """A flat bottle of oval section, as shampoo comes in, with a cap."""
    radius = rng.uniform(0.024, 0.038)
    squash = rng.uniform(0.012, 0.019) / radius
    height, shoulder = rng.uniform(0.065, 0.115), rng.uniform(0.010, 0.022)
    top = rng.uniform(0.5, 0.7)
    cap_radius = top * squash * radius * rng.uniform(0.9, 1.2)
    cap, foot = rng.uniform(0.014, 0.026), rng.uniform(0.8, 1.0)
    return (
        frustum(foot * radius, radius, height, squash)
        + frustum(radius, top * radius, shoulder, squash).moved(z=height)
        + cylinder(cap_radius, cap + 0.002).moved(z=height + shoulder - 0.002)
    )


def drinking_cup(rng: np.random.Generator) -> Solid:
    """A beaker that widens towards its rim."""
    top = rng.uniform(0.026, 0.040)
    bottom, height = top * rng.uniform(0.68, 1.0), rng.uniform(0.055, 0.105)
    return cup(bottom, top, height, rng.uniform(0.0035, 0.005), 0.005)


def bowl(rng: np.random.Generator) -> Solid:
    """A wide shallow vessel."""
    top = rng.uniform(0.042, 0.066)
    bottom, height = top * rng.uniform(0.5, 0.75), rng.uniform(0.024, 0.045)
    return cup(bottom, top, height, rng.uniform(0.005, 0.008), 0.005)


def tray(rng: np.random.Generator) -> Solid:
    """A rectangular open box."""
    length, width = rng.uniform(0.08, 0.15), rng.uniform(0.055, 0.10)
    height, wall = rng.uniform(0.018, 0.042), rng.uniform(0.004, 0.006)
    solid = slab(length, width, wall)
    for sign in (-1, 1):
        x, y = sign * (length - wall) / 2, sign * (width - wall) / 2
        solid += slab(wall, width, height, x)
        solid += slab(length, wall, height, y=y)
    return solid


def saucepan(rng: np.random.Generator) -> Solid:
    """A measuring cup or small pan with a straight handle."""
    top = rng.uniform(0.028, 0.045)
    height = rng.uniform(0.024, 0.05)
    handle = rng.uniform(0.05, 0.085)
    width, thickness = rng.uniform(0.012, 0.02), rng.uniform(0.006, 0.010)
    wall = 0.005
    vessel = cup(top * rng.uniform(0.8, 1.0), top, height, wall, 0.005)
    x, z = top - wall / 2 + handle / 2, height - thickness / 2 - 0.001
    return vessel + box(handle, width, thickness, (x, 0, z))


FAMILIES = {
    "carton": Family(carton, (200, 500), ((0.8, 1.25), (0.75, 1.3), (0.8, 2))),
    "book": Family(book, (400, 700), ((0.8, 1.2), (0.8, 1.3), (1, 1.8))),
    "can": Family(can, (300, 700), ((1, 1), (1, 1), (0.45, 1.3))),
    "bottle": Family(bottle, (300, 700), ((1, 1), (0.55, 1), (0.7, 1.3))),
    "flask": Family(flask, (300, 700), ((1, 1), (0.7, 1.5), (0.75, 1.3))),
    "cup": Family(drinking_cup, (400, 1000), ((1, 1), (1, 1), (0.6, 1.4))),
    "bowl": Family(bowl, (400, 900), ((1, 1), (1, 1), (0.7, 1.9))),
    "tray": Family(tray, (350, 700), ((0.8, 1.2), (0.8, 1.3), (0.8, 2))),
    "saucepan": Family(saucepan, (500, 1100), ((1, 1), (1, 1), (0.8, 1.6))),
}
