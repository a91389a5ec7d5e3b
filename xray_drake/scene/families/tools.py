"""Things with a handle or a bar: hammers, cutlery, wrenches, hooks."""

import numpy as np

from xray_drake.scene.families.family import Family
from xray_drake.scene.shapes import (
    Solid,
    arc,
    box,
    convex,
    cylinder,
    frustum,
    slab,
    taper,
)

ALONG_X = (0, 1, 0), np.pi / 2


def hammer(rng: np.random.Generator) -> Solid:
    """A round handle along x with a block or a barrel across its end."""
    radius, length = rng.uniform(0.007, 0.012), rng.uniform(0.09, 0.15)
    handle = cylinder(radius, length).turned(*ALONG_X)
    head_length = rng.uniform(0.045, 0.085)
    size = rng.uniform(0.010, 0.017)
    if rng.random() < 0.5:
        head = cylinder(size, head_length).moved(z=-head_length / 2)
        head = head.turned((1, 0, 0), np.pi / 2)
    else:
        head = box(2 * size, head_length, 2 * size)
    return handle + head.moved(x=length)


def spoon(rng: np.random.Generator) -> Solid:
    """An oval blade on a flat handle that lifts away from it."""
    length, width = rng.uniform(0.065, 0.11), rng.uniform(0.007, 0.013)
    thickness = rng.uniform(0.005, 0.008)
    radius = rng.uniform(0.018, 0.029)
    squash = rng.uniform(0.6, 0.85)
    blade = cylinder(radius, thickness + 0.002, squash).moved(x=-radius)
    handle = box(length, width, thickness, (length / 2 - 0.006, 0, 0))
    knob = cylinder(0.75 * width, thickness, 0.9)
    knob = knob.moved(x=length - 0.006, z=-thickness / 2)
    lift = rng.uniform(0, 0.2)
    stem = (handle + knob).turned((0, 1, 0), -lift)
    return blade + stem.moved(z=thickness / 2 + 0.001)


def fork(rng: np.random.Generator) -> Solid:
    """A thin handle, a bridge and three or four tines; 6 to 15 cm long."""
    scale = rng.uniform(0.55, 1.15)
    tines = int(rng.integers(3, 5))
    thickness = rng.uniform(0.0045, 0.007)
    tine, gap = 0.0045 * scale, rng.uniform(0.0035, 0.005) * scale
    width = tines * tine + (tines - 1) * gap
    handle, tine_length = 0.075 * scale, rng.uniform(0.03, 0.045) * scale
    bridge, stem = 0.016 * scale, 0.009 * scale
    solid = taper(-bridge, stem, 0, width, thickness)
    solid += slab(handle, stem, thickness, 0.002 - bridge - handle / 2)
    x = tine_length / 2 - 0.001
    for i in range(tines):
        y = -width / 2 + tine / 2 + i * (tine + gap)
        solid += slab(tine_length + 0.002, tine, thickness, x, y)
    return solid


def spatula(rng: np.random.Generator) -> Solid:
    """A trapezoidal blade on a round handle."""
    blade, near = rng.uniform(0.05, 0.08), rng.uniform(0.036, 0.05)
    far, thickness = near * rng.uniform(1.0, 1.45), rng.uniform(0.004, 0.007)
    radius, length = rng.uniform(0.006, 0.010), rng.uniform(0.065, 0.10)
    handle = cylinder(radius, length).turned(*ALONG_X)
    handle = handle.moved(x=0.012 - length, z=thickness / 2)
    return taper(0, near, blade, far, thickness) + handle


def wrench(rng: np.random.Generator) -> Solid:
    """An open-ended spanner: a bar with a fork, or a fork and a round head."""
    length, width = rng.uniform(0.05, 0.10), rng.uniform(0.010, 0.017)
    thickness = rng.uniform(0.006, 0.010)
    jaw = rng.uniform(0.014, 0.022)

    def jaws() -> Solid:
        solid = taper(-0.008, width, 0.008, 2 * jaw, thickness)
        for y in (-0.72 * jaw, 0.72 * jaw):
            solid += slab(0.020, 0.55 * jaw, thickness, 0.015, y)
        return solid

    solid = slab(length, width, thickness)
    tilt = rng.uniform(-0.3, 0.3)
    solid += jaws().turned((0, 0, 1), tilt).moved(x=length / 2)
    if rng.random() < 0.5:
        other = jaws().turned((0, 0, 1), np.pi + tilt)
    else:
        other = cylinder(rng.uniform(0.8, 1.1) * jaw, thickness + 0.003)
    return solid + other.moved(x=-length / 2)


def screwdriver(rng: np.random.Generator) -> Solid:
    """A thick grip, a collar and a thin shaft."""
    radius, grip = rng.uniform(0.010, 0.017), rng.uniform(0.05, 0.085)
    shaft_radius, shaft = rng.uniform(0.003, 0.005), rng.uniform(0.04, 0.08)
    collar = rng.uniform(0.008, 0.014)
    return (
        cylinder(radius, grip)
        + frustum(radius, 1.3 * shaft_radius, collar).moved(z=grip)
        + cylinder(shaft_radius, shaft + 0.002).moved(z=grip + collar - 0.002)
    )


def dumbbell(rng: np.random.Generator) -> Solid:
    """Two discs on a bar."""
    bar_radius, bar = rng.uniform(0.008, 0.014), rng.uniform(0.04, 0.08)
    radius, thick = rng.uniform(0.018, 0.032), rng.uniform(0.012, 0.025)
    other = radius * rng.uniform(0.75, 1.0)
    return (
        cylinder(bar_radius, bar + 0.004)
        + cylinder(radius, thick).moved(z=0.002 - thick)
        + cylinder(other, thick).moved(z=bar + 0.002)
    )


def bracket(rng: np.random.Generator) -> Solid:
    """An angle of two plates, half of them with a gusset between."""
    width, thickness = rng.uniform(0.028, 0.06), rng.uniform(0.006, 0.011)
    first, second = rng.uniform(0.05, 0.10), rng.uniform(0.04, 0.075)
    solid = slab(first, width, thickness, first / 2)
    solid += slab(thickness, width, second, thickness / 2)
    if rng.random() < 0.5:
        leg, half = 0.6 * min(first, second), thickness / 2
        inset = 0.5 * thickness
        triangle = np.array([[inset, inset], [leg, inset], [inset, leg]])
        solid += convex(
            np.array([[x, y, z] for y in (-half, half) for x, z in triangle])
        )
    return solid


def hook(rng: np.random.Generator) -> Solid:
    """A C-shaped clip, or a J-shaped hook where it has a shank."""
    outer = rng.uniform(0.024, 0.042)
    band = rng.uniform(0.008, 0.014)
    height = rng.uniform(0.009, 0.018)
    angle = np.deg2rad(rng.choice([180, 225, 270]))
    pieces = round(angle / (np.pi / 4))
    clip = arc(outer - band, outer, height, angle, pieces)
    if rng.random() < 0.35:
        return clip
    shank = rng.uniform(0.03, 0.07)
    x, y = outer - band / 2, 0.001 - shank / 2
    return clip + slab(band, shank + 0.002, height, x, y)


FAMILIES = {
    "hammer": Family(
        hammer, (450, 1000), ((0.8, 1.15), (0.7, 1.3), (0.8, 1.4))
    ),
    "spoon": Family(spoon, (1000, 1600), ((0.8, 1.2), (0.6, 1.4), (0.8, 2.2))),
    "fork": Family(fork, (2000, 2700), ((0.8, 1.2), (1.2, 2.4), (0.8, 2.5))),
    "spatula": Family(
        spatula, (700, 1200), ((0.85, 1.2), (0.65, 1.3), (0.8, 1.8))
    ),
    "wrench": Family(
        wrench, (1000, 2700), ((0.8, 1.15), (0.7, 1.4), (0.7, 2.2))
    ),
    "screwdriver": Family(
        screwdriver, (500, 1100), ((1, 1), (0.6, 1), (0.7, 1.2))
    ),
    "dumbbell": Family(dumbbell, (350, 800), ((1, 1), (1, 1), (0.7, 1.5))),
    "bracket": Family(
        bracket, (500, 1200), ((0.75, 1.3), (0.75, 1.3), (0.75, 1.3))
    ),
    "hook": Family(hook, (900, 1500), ((0.8, 1.3), (0.8, 1.4), (0.7, 2.2))),
}
