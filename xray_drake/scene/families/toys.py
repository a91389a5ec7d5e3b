"""Toys: pawns, figurines, animals, vehicles, puzzle pieces, letters, stones."""

import numpy as np

from xray_drake.scene.families.family import Family
from xray_drake.scene.shapes import (
    Solid,
    beam,
    box,
    convex,
    cylinder,
    ellipsoid,
    frustum,
    loft,
    prism,
    rod,
)

STROKES: dict[str, tuple[tuple[float, ...], ...]] = {
    "A": ((0, 0, 0.5, 1), (0.5, 1, 1, 0), (0.22, 0.4, 0.78, 0.4)),
    "E": ((0, 0, 0, 1), (0, 0, 1, 0), (0, 0.5, 0.8, 0.5), (0, 1, 1, 1)),
    "F": ((0, 0, 0, 1), (0, 0.55, 0.75, 0.55), (0, 1, 1, 1)),
    "H": ((0, 0, 0, 1), (1, 0, 1, 1), (0, 0.5, 1, 0.5)),
    "K": ((0, 0, 0, 1), (0, 0.45, 1, 1), (0.2, 0.55, 1, 0)),
    "L": ((0, 0, 0, 1), (0, 0, 1, 0)),
    "M": ((0, 0, 0, 1), (0, 1, 0.5, 0.4), (0.5, 0.4, 1, 1), (1, 1, 1, 0)),
    "N": ((0, 0, 0, 1), (0, 1, 1, 0), (1, 0, 1, 1)),
    "T": ((0.5, 0, 0.5, 1), (0, 1, 1, 1)),
    "U": ((0, 0, 0, 1), (0, 0, 1, 0), (1, 0, 1, 1)),
    "V": ((0, 1, 0.5, 0), (0.5, 0, 1, 1)),
    "Y": ((0.5, 0, 0.5, 0.5), (0.5, 0.45, 0, 1), (0.5, 0.45, 1, 1)),
    "Z": ((0, 1, 1, 1), (1, 1, 0, 0), (0, 0, 1, 0)),
}
"""Letters as strokes x, y to x, y in a square."""


def pawn(rng: np.random.Generator) -> Solid:
    """A piece of a board game: a base, a waist and a head of some kind."""
    radius, base = rng.uniform(0.014, 0.026), rng.uniform(0.006, 0.014)
    waist, height = rng.uniform(0.35, 0.8) * radius, rng.uniform(0.018, 0.06)
    neck = waist * rng.uniform(0.5, 1.0)
    solid = cylinder(radius, base)
    solid += frustum(waist, neck, height, sides=6).moved(z=base - 0.001)
    top = base + height - 0.001
    kind = str(rng.choice(["ball", "crown", "tower", "bishop"]))
    head = radius * rng.uniform(0.6, 0.95)
    if kind == "ball":
        solid += ellipsoid((head, head, head)).moved(z=top + 0.7 * head)
    elif kind == "crown":
        flare = frustum(neck, head, rng.uniform(0.010, 0.02))
        solid += flare.moved(z=top - 0.001)
    elif kind == "tower":
        block = box(1.6 * head, 1.6 * head, rng.uniform(0.010, 0.02))
        solid += block.moved(z=top + 0.004)
    else:
        tall = head * rng.uniform(1.2, 1.8)
        solid += ellipsoid((head, 0.8 * head, tall)).moved(z=top + 0.7 * tall)
    return solid


def figurine(rng: np.random.Generator) -> Solid:
    """A person: torso, head, arms in some pose, and legs or a skirt."""
    size = rng.uniform(0.75, 1.35)
    chest, belly = rng.uniform(0.009, 0.015), rng.uniform(0.007, 0.012)
    torso, leg = rng.uniform(0.016, 0.026), rng.uniform(0.018, 0.034)
    head = rng.uniform(0.008, 0.0135)
    solid = ellipsoid((belly, chest, torso)).moved(z=leg + 0.75 * torso)
    skull = ellipsoid((head, head, head * rng.uniform(1, 1.3)))
    solid += skull.moved(z=leg + 1.7 * torso + 0.6 * head)
    shoulder = leg + 1.1 * torso
    arm, thick = rng.uniform(0.018, 0.03), rng.uniform(0.0035, 0.005)
    both = rng.uniform(-1.1, 1.2)
    for sign in (-1, 1):
        lift = both + rng.uniform(-0.4, 0.4)
        y, z = np.cos(lift), np.sin(lift)
        hand = (0.006, sign * (0.5 * chest + arm * y), shoulder + arm * z)
        solid += rod((0, sign * 0.5 * chest, shoulder), hand, thick)
    if rng.random() < 0.45:
        hem = chest * rng.uniform(1.1, 1.9)
        solid += frustum(hem, 0.7 * chest, leg + 0.4 * torso)
    else:
        stance = rng.uniform(0.2, 0.55)
        for sign in (-1, 1):
            foot = (0, sign * (0.45 * chest + stance * 0.3 * leg), 0)
            hip = (0, sign * 0.4 * chest, leg + 0.4 * torso)
            solid += rod(foot, hip, rng.uniform(0.0045, 0.006))
    if rng.random() < 0.3:
        stand = rng.uniform(0.016, 0.024)
        solid += cylinder(stand, 0.005).moved(z=-0.003)
    return solid.stretched([size] * 3)


def animal(rng: np.random.Generator) -> Solid:
    """A beast on four legs, or a bird without."""
    size = rng.uniform(0.8, 1.3)
    length, width = rng.uniform(0.02, 0.034), rng.uniform(0.011, 0.018)
    height = width * rng.uniform(0.85, 1.15)
    head = rng.uniform(0.008, 0.014)
    if rng.random() < 0.4:
        solid = ellipsoid((length, width, height))
        reach = length * rng.uniform(0.65, 0.95)
        up = height * rng.uniform(0.9, 1.3)
        solid += rod((0.5 * length, 0, 0), (reach, 0, up + head), 0.6 * head)
        solid += ellipsoid((head, head, head)).moved(x=reach, z=up + head)
        beak = rng.uniform(0.010, 0.020)
        tip = (reach + 0.6 * head + beak, 0, up + 0.8 * head)
        solid += rod((reach, 0, up + head), tip, 0.55 * head, 0.002)
        tail = rng.uniform(0.015, 0.03)
        back = [-0.5 * length, -0.8 * length - tail]
        z = rng.uniform(0, 0.022)
        fan = rng.uniform(0.5, 1.2) * width
        corners = [
            [back[0], y, s]
            for y in (-0.4 * width, 0.4 * width)
            for s in (-0.004, 0.004)
        ]
        corners += [
            [back[1], y, z + s] for y in (-fan, fan) for s in (-0.002, 0.002)
        ]
        return (solid + convex(np.array(corners))).stretched([size] * 3)
    if rng.random() < 0.5:
        solid = ellipsoid((length, width, height))
    else:
        solid = box(1.7 * length, 1.6 * width, 1.6 * height)
    leg, thick = rng.uniform(0.014, 0.034), rng.uniform(0.006, 0.009)
    x, y = 0.62 * length, 0.5 * width
    for i in (-1, 1):
        for j in (-1, 1):
            foot = height * 0.3 + leg
            middle = (i * x, j * y, -foot / 2 - 0.1 * height)
            solid += box(thick, thick, foot, middle)
    neck, lift = rng.uniform(0.008, 0.022), rng.uniform(-0.1, 1.2)
    x = 0.8 * length + neck * np.cos(lift)
    nose = (x, 0.0, 0.4 * height + neck * np.sin(lift) + 0.3 * head)
    solid += rod((0.6 * length, 0, 0.2 * height), nose, 0.6 * head)
    long, wide = head * rng.uniform(1, 1.5), head * rng.uniform(0.8, 1.1)
    solid += ellipsoid((long, wide, head)).moved(*nose)
    return solid.stretched([size] * 3)


def car(rng: np.random.Generator) -> Solid:
    """A body and a cabin or a load on four wheels."""
    length, width = rng.uniform(0.05, 0.095), rng.uniform(0.024, 0.042)
    height = rng.uniform(0.010, 0.022)
    wheel = rng.uniform(0.008, 0.013)
    nose = height * rng.uniform(0.5, 1)
    half = length / 2
    side = np.array([[-half, 0], [half, 0], [half, nose], [-half, height]])
    solid = prism(side, width).turned((1, 0, 0), np.pi / 2)
    solid = solid.moved(y=width / 2)
    low, high = rng.uniform(0.3, 0.6) * length, rng.uniform(0.55, 0.95)
    cabin, place = rng.uniform(0.010, 0.025), rng.uniform(-0.18, 0.12) * length
    inner = 0.44 * width
    foot = np.array(
        [[-low, -inner], [low, -inner], [low, inner], [-low, inner]]
    )
    foot[:, 0] /= 2
    roof = foot * (high, 0.9) + (rng.uniform(-0.08, 0.03) * length, 0)
    house = loft(foot, roof, cabin)
    solid += house.moved(x=place, z=0.5 * (height + nose) - 0.004)
    base, thick = half * rng.uniform(0.5, 0.72), rng.uniform(0.006, 0.009)
    for x in (-base, base):
        for y in (-width / 2, width / 2):
            solid += rod((x, y - thick / 2, 0), (x, y + thick / 2, 0), wheel)
    return solid


def boat(rng: np.random.Generator) -> Solid:
    """A hull with a pointed bow, deck houses and a mast or a funnel."""
    length, width = rng.uniform(0.06, 0.13), rng.uniform(0.022, 0.05)
    height, bow = rng.uniform(0.014, 0.028), rng.uniform(0.2, 0.45)
    stern = rng.uniform(0.6, 1)
    deck = np.array(
        [[0, -stern], [1 - bow, -1], [1, 0], [1 - bow, 1], [0, stern]]
    ) * (length, width / 2)
    shrink, middle = rng.uniform([0.7, 0.35], [0.95, 0.9]), (0.45 * length, 0)
    keel = (deck - middle) * shrink + middle
    solid = loft(keel, deck, height)
    cabin = rng.uniform([0.2, 0.4], [0.5, 0.75]) * (length, width)
    tall = rng.uniform(0.010, 0.026)
    x = length * rng.uniform(0.28, 0.5)
    solid += box(cabin[0], cabin[1], tall, (x, 0, height + tall / 2 - 0.001))
    kind = rng.integers(3)
    top = height + tall - 0.001
    foot = (x, 0, top - 0.002)
    if kind == 0:
        end = (x, 0, top + rng.uniform(0.02, 0.05))
        solid += rod(foot, end, rng.uniform(0.003, 0.005))
    elif kind == 1:
        end = (x - 0.004, 0, top + rng.uniform(0.012, 0.024))
        solid += rod(foot, end, rng.uniform(0.25, 0.42) * cabin.min())
    else:
        second = rng.uniform(0.5, 0.8) * cabin
        more = rng.uniform(0.008, 0.016)
        solid += box(second[0], second[1], more, (x, 0, top + more / 2 - 0.001))
    return solid


def puzzle(rng: np.random.Generator) -> Solid:
    """Three to six cubes that hang together, as two or three bars."""
    unit = rng.uniform(0.013, 0.024) * rng.uniform(0.8, 1.2, size=3)
    first = int(rng.integers(2, 5))

    def cells(low: np.ndarray, high: np.ndarray) -> Solid:
        size = (high - low + 1) * unit
        return box(size[0], size[1], size[2], (low + high) / 2 * unit)

    solid = cells(np.array([0, 0, 0]), np.array([first - 1, 0, 0]))
    places: set[tuple[int, ...]] = set()
    for _ in range(int(rng.integers(1, 3))):
        start = int(rng.integers(first))
        axis, sign = int(rng.integers(1, 3)), int(rng.choice([-1, 1]))
        if (start, axis, sign) in places:
            continue
        places.add((start, axis, sign))
        low, high = np.array([start, 0, 0]), np.array([start, 0, 0])
        reach = int(rng.integers(1, 3))
        low[axis], high[axis] = (1, reach) if sign > 0 else (-reach, -1)
        # A tenth of a millimetre deep in the first bar, to be one body.
        slack = np.zeros(3)
        slack[axis] = -sign * 1e-4 / unit[axis]
        solid += cells(low + slack, high)
    return solid


def letter(rng: np.random.Generator) -> Solid:
    """A capital letter of two to four strokes."""
    strokes = STROKES[str(rng.choice(list(STROKES)))]
    height, depth = rng.uniform(0.045, 0.085), rng.uniform(0.008, 0.026)
    width = height * rng.uniform(0.55, 1.05)
    thick = height * rng.uniform(0.13, 0.24)
    solids = []
    for stroke in strokes:
        start, end = np.reshape(stroke, (2, 2)) * (width, height)
        along = (end - start) / np.linalg.norm(end - start)
        slanted = bool(min(np.abs(along)) > 1e-9)
        more = along * thick * (0.3 if slanted else 0.5)
        # A slanted stroke is a little lower: no two faces coincide.
        tall = depth * (1 - 0.06 * slanted)
        solids.append(beam(start - more, end + more, thick, tall))
    return sum(solids[1:], solids[0])


def stone(rng: np.random.Generator) -> Solid:
    """A broken stone: the hull of a dozen points."""
    radii = rng.uniform([22, 16, 9], [45, 32, 26])
    points = rng.normal(size=(12, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    # Drive the points apart, so that the stone is no splinter.
    for _ in range(8):
        gap = points[:, None] - points
        distance = np.linalg.norm(gap, axis=2) + np.eye(12)
        points += 0.04 * (gap / distance[..., None] ** 3).sum(axis=1)
        points /= np.linalg.norm(points, axis=1)[:, None]
    points *= rng.uniform(0.7, 1.1, size=(12, 1))
    return convex(points * radii * 1e-3)


FAMILIES = {
    "pawn": Family(pawn, (500, 1100)),
    "figurine": Family(figurine, (600, 1200)),
    "animal": Family(animal, (500, 1100)),
    "car": Family(car, (400, 900)),
    "boat": Family(boat, (300, 700)),
    "puzzle": Family(puzzle, (500, 900)),
    "letter": Family(letter, (500, 1100)),
    "stone": Family(stone, (900, 2400)),
}
