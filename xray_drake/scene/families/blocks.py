"""Toys, rings and spare parts: tubes, rings, discs, ramps, stars, bricks."""

import numpy as np

from xray_drake.scene.families.family import Family
from xray_drake.scene.shapes import Solid, arc, box, cylinder, prism


def tube(rng: np.random.Generator) -> Solid:
    """A hollow round bar, open at both ends."""
    outer = rng.uniform(0.015, 0.030)
    wall = rng.uniform(0.004, 0.007)
    return arc(outer - wall, outer, rng.uniform(0.06, 0.14))


def ring(rng: np.random.Generator) -> Solid:
    """A washer or the inside of a roll of tape."""
    outer = rng.uniform(0.024, 0.052)
    inner = outer * rng.uniform(0.45, 0.72)
    return arc(inner, outer, rng.uniform(0.008, 0.026))


def disc(rng: np.random.Generator) -> Solid:
    """A flat plate, half of them with a knob like a lid."""
    radius, thickness = rng.uniform(0.030, 0.062), rng.uniform(0.006, 0.013)
    plate = cylinder(radius, thickness)
    if rng.random() < 0.5:
        return plate
    knob = cylinder(rng.uniform(0.009, 0.016), rng.uniform(0.014, 0.024))
    return plate + knob.moved(z=thickness - 0.001)


def wedge(rng: np.random.Generator) -> Solid:
    """A ramp; its thin end is at least 4 mm high."""
    length, height = rng.uniform(0.05, 0.12), rng.uniform(0.022, 0.05)
    width, thin = rng.uniform(0.026, 0.07), rng.uniform(0.004, 0.012)
    outline = np.array([[0, 0], [length, 0], [length, thin], [0, height]])
    return prism(outline, width)


def star(rng: np.random.Generator) -> Solid:
    """Two or three bars that cross in the middle."""
    bars = int(rng.integers(2, 4))
    length = rng.uniform(0.065, 0.12)
    width = length * rng.uniform(0.15, 0.25)
    height = rng.uniform(0.010, 0.022)
    bar = box(length, width, height)
    second = box(length * rng.uniform(0.7, 1.0), width, height)
    solid = bar
    for i in range(1, bars):
        other = second if bars == 2 else bar
        solid += other.turned((0, 0, 1), i * np.pi / bars)
    return solid


def brick(rng: np.random.Generator) -> Solid:
    """A toy brick with one or two rows of studs."""
    columns, rows = int(rng.integers(2, 4)), int(rng.integers(1, 3))
    pitch = rng.uniform(0.017, 0.026)
    height, stud = rng.uniform(0.016, 0.030), rng.uniform(0.004, 0.006)
    solid = box(columns * pitch, rows * pitch, height)
    for i in range(columns):
        for j in range(rows):
            solid += cylinder(0.32 * pitch, stud + 0.002).moved(
                x=(i - (columns - 1) / 2) * pitch,
                y=(j - (rows - 1) / 2) * pitch,
                z=height / 2 - 0.002,
            )
    return solid


FAMILIES = {
    "tube": Family(tube, (350, 900), ((1, 1), (1, 1), (0.4, 1.2))),
    "ring": Family(ring, (350, 900), ((1, 1), (0.65, 1), (0.6, 2.4))),
    "disc": Family(disc, (400, 900), ((1, 1), (0.55, 1), (0.6, 2))),
    "wedge": Family(wedge, (300, 700), ((0.75, 1.3), (0.75, 1.3), (0.75, 1.3))),
    "star": Family(star, (400, 900), ((0.75, 1.3), (0.75, 1.3), (0.6, 2.5))),
    "brick": Family(brick, (400, 800), ((0.8, 1.3), (0.8, 1.3), (0.6, 1.8))),
}
