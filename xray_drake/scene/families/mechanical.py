"""Parts from a CAD collection: gears, bolts, fittings, profiles, cranks."""

import numpy as np

from xray_drake.scene.families.family import Family
from xray_drake.scene.shapes import (
    Solid,
    box,
    cylinder,
    polygon,
    prism,
    rod,
    slab,
    taper,
)


def gear(rng: np.random.Generator) -> Solid:
    """A cog wheel with five to seven coarse teeth, some with a hub."""
    teeth = int(rng.integers(5, 8))
    radius = rng.uniform(0.018, 0.036)
    depth = radius * rng.uniform(0.22, 0.5)
    height = rng.uniform(0.007, 0.024)
    foot = 2 * np.pi * radius / teeth * rng.uniform(0.42, 0.62)
    tip = foot * rng.uniform(0.45, 0.95)
    tooth = taper(0.9 * radius, foot, radius + depth, tip, height)
    solid = cylinder(radius, height)
    for i in range(teeth):
        solid += tooth.turned((0, 0, 1), 2 * np.pi * i / teeth)
    if rng.random() < 0.45:
        hub = cylinder(radius * rng.uniform(0.3, 0.7), rng.uniform(0.006, 0.03))
        solid += hub.moved(z=height - 0.001)
    return solid


def bolt(rng: np.random.Generator) -> Solid:
    """A shank under a hexagonal, square or round head; some with a nut."""
    radius, length = rng.uniform(0.005, 0.012), rng.uniform(0.028, 0.085)
    head, height = radius * rng.uniform(1.6, 2.6), rng.uniform(0.006, 0.018)
    sides = int(rng.choice([4, 6, 8]))
    solid = rod((0, 0, height - 0.001), (0, 0, height + length), radius)
    if sides == 8:
        solid += cylinder(head, height)
    else:
        solid += prism(polygon(head, sides), height)
    if rng.random() < 0.5:
        nut, place = rng.uniform(0.006, 0.014), rng.uniform(0.25, 0.8)
        solid += prism(polygon(radius * rng.uniform(1.5, 2.2), 6), nut).moved(
            z=height + place * (length - nut)
        )
    return solid


def fitting(rng: np.random.Generator) -> Solid:
    """An elbow or a tee of pipe, with collars at some of its ends."""
    radius = rng.uniform(0.009, 0.018)
    angle = np.deg2rad(rng.uniform(55, 125))
    first, second = radius * rng.uniform(2.2, 5, size=2)
    ends = [(first, 0.0), (second * np.cos(angle), second * np.sin(angle))]
    if rng.random() < 0.5:
        ends.append((-radius * rng.uniform(2.2, 4), 0.0))
        x, y = ends[2]
        solid = rod((x, y, 0), (*ends[0], 0), radius)
        solid += rod((0, 0, 0), (*ends[1], 0), radius * rng.uniform(0.6, 1))
    else:
        # Both legs run on past the corner, by half a radius.
        knee = 0.5 * radius
        x, y = np.cos(angle), np.sin(angle)
        solid = rod((-knee, 0, 0), (*ends[0], 0), radius)
        solid += rod((-knee * x, -knee * y, 0), (*ends[1], 0), radius)
    collar, width = radius * rng.uniform(1.25, 1.6), rng.uniform(0.006, 0.013)
    for x, y in ends:
        if rng.random() < 0.6:
            unit = np.array([x, y, 0]) / np.hypot(x, y)
            end = np.array([x, y, 0]) + 0.0005 * unit
            solid += rod(end - width * unit, end, collar)
    return solid


def profile(rng: np.random.Generator) -> Solid:
    """A length of angle, channel, tee, I or Z section."""
    kind = str(rng.choice(["angle", "channel", "tee", "i", "z"]))
    length = rng.uniform(0.035, 0.13)
    depth, width = rng.uniform(0.022, 0.055), rng.uniform(0.022, 0.055)
    web, flange = rng.uniform(0.004, 0.012, size=2)
    other = width * rng.uniform(0.5, 1)
    solid = slab(length, web, depth)

    def flange_at(z: float, low: float, high: float) -> Solid:
        return box(length, high - low, flange, (0, (low + high) / 2, z))

    bottom, top, edge = flange / 2, depth - flange / 2, web / 2
    if kind in ("tee", "i"):
        solid += flange_at(bottom, -width / 2, width / 2)
        if kind == "i":
            solid += flange_at(top, -other / 2, other / 2)
        return solid
    solid += flange_at(bottom, -edge, width - edge)
    if kind == "channel":
        solid += flange_at(top, -edge, other - edge)
    elif kind == "z":
        solid += flange_at(top, edge - other, edge)
    return solid


def hinge(rng: np.random.Generator) -> Solid:
    """Two leaves that meet at a barrel, more or less open."""
    width = rng.uniform(0.025, 0.085)
    thickness = rng.uniform(0.004, 0.008)
    radius = thickness * rng.uniform(0.8, 1.5)
    first, second = rng.uniform(0.022, 0.06, size=2)
    other = width * rng.uniform(0.55, 1)
    angle = np.deg2rad(rng.uniform(45, 180))
    barrel = rod((0, -0.51 * width, 0), (0, 0.51 * width, 0), radius)
    leaf = box(first, width, thickness, (first / 2, 0, 0))
    flap = box(second, other, thickness, (second / 2, 0, 0))
    return barrel + leaf + flap.turned((0, 1, 0), -angle)


def clamp(rng: np.random.Generator) -> Solid:
    """A G-clamp: three sides of a frame, a screw and its bar."""
    opening, throat = rng.uniform(0.03, 0.07), rng.uniform(0.022, 0.055)
    bar, thickness = rng.uniform(0.008, 0.015), rng.uniform(0.008, 0.014)
    lower = throat * rng.uniform(0.8, 1.1)
    solid = box(bar, thickness, opening + 2 * bar, (-bar / 2, 0, opening / 2))
    solid += box(throat, thickness, bar, (throat / 2, 0, opening + bar / 2))
    solid += box(lower, thickness, bar, (lower / 2, 0, -bar / 2))
    radius = 0.45 * thickness * rng.uniform(0.7, 1)
    low = -bar - rng.uniform(0.018, 0.035)
    high = opening * rng.uniform(0.1, 0.6)
    x = lower - 0.7 * bar
    solid += rod((x, 0, low), (x, 0, high), radius)
    half = rng.uniform(0.010, 0.02)
    return solid + box(0.007, 2 * half, 0.007, (x, 0, low))


def crank(rng: np.random.Generator) -> Solid:
    """An arm with a hub at one end and a peg at the other, up or down."""
    length, thickness = rng.uniform(0.04, 0.09), rng.uniform(0.006, 0.013)
    wide, narrow = rng.uniform(0.012, 0.024), rng.uniform(0.009, 0.014)
    hub, height = wide * rng.uniform(0.6, 1.0), rng.uniform(0.010, 0.035)
    peg, reach = narrow * rng.uniform(0.55, 0.9), rng.uniform(0.018, 0.05)
    solid = taper(0, wide, length, narrow, thickness)
    solid += cylinder(hub, thickness + height).moved(z=-0.0005)
    up = rng.random() < 0.5
    low, high = (-0.0005, reach) if up else (-reach, thickness + 0.0005)
    return solid + rod((length, 0, low), (length, 0, high), peg)


def handle(rng: np.random.Generator) -> Solid:
    """A pull for a drawer: a grip on two feet, some on base plates."""
    length, reach = rng.uniform(0.06, 0.13), rng.uniform(0.02, 0.045)
    radius = rng.uniform(0.005, 0.009)
    spread = length * rng.uniform(0.55, 1.0) / 2
    top = spread * rng.uniform(0.6, 1.0)
    width, flat = radius * rng.uniform(1.2, 3), rng.random() < 0.5
    if flat:
        grip = box(length, 2 * width, 1.4 * radius, (0, 0, reach))
    else:
        grip = rod((-length / 2, 0, reach), (length / 2, 0, reach), radius)
    solid = grip
    foot = rng.uniform(0.004, 0.0065)
    for sign in (-1, 1):
        solid += rod((sign * spread, 0, 0), (sign * top, 0, reach), foot)
    if rng.random() < 0.4:
        plate = rng.uniform(0.018, 0.03)
        for sign in (-1, 1):
            solid += box(plate, plate, 0.005, (sign * spread, 0, 0.001))
    return solid


FAMILIES = {
    "gear": Family(gear, (600, 1400)),
    "bolt": Family(bolt, (1200, 2700)),
    "fitting": Family(fitting, (500, 1200)),
    "profile": Family(profile, (900, 2000)),
    "hinge": Family(hinge, (1200, 2700)),
    "clamp": Family(clamp, (900, 2200)),
    "crank": Family(crank, (700, 1600)),
    "handle": Family(handle, (700, 1800)),
}
