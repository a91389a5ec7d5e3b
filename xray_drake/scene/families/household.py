"""Small things of a household: pegs, keys, brushes, bulbs, bottle racks."""

import numpy as np

from xray_drake.scene.families.family import Family
from xray_drake.scene.shapes import (
    Solid,
    box,
    convex,
    cylinder,
    ellipsoid,
    frustum,
    loft,
    rod,
    slab,
)


def peg(rng: np.random.Generator) -> Solid:
    """A clothes peg: two tapered legs, closed at one end, and a spring."""
    length, width = rng.uniform(0.055, 0.11), rng.uniform(0.008, 0.022)
    thick, thin = rng.uniform(0.006, 0.011), rng.uniform(0.004, 0.006)
    spread, place = rng.uniform(0.05, 0.2), rng.uniform(0.3, 0.6) * length
    corners = [
        [x, y, z]
        for x, high in ((0, thin), (place, thick), (length, thin))
        for y in (-width / 2, width / 2)
        for z in (0, high)
    ]
    leg = convex(np.array(corners)).moved(x=-place)
    radius = thick * rng.uniform(0.6, 0.95)
    half = width / 2 + rng.uniform(0.001, 0.004)
    upper = leg.turned((0, 1, 0), -spread / 2).moved(z=0.0005)
    lower = leg.turned((1, 0, 0), np.pi).turned((0, 1, 0), spread / 2)
    spring = rod((0, -half, 0), (0, half, 0), radius)
    return upper + lower.moved(z=-0.0005) + spring


def key(rng: np.random.Generator) -> Solid:
    """A bow to turn it by, a stem, and two or three bits."""
    length, width = rng.uniform(0.035, 0.07), rng.uniform(0.007, 0.013)
    thickness = rng.uniform(0.004, 0.008)
    bow = rng.uniform(0.011, 0.022)
    kind = rng.integers(3)
    if kind == 0:
        head = cylinder(bow, thickness + 0.001, rng.uniform(0.75, 1.35))
        head = head.moved(z=-0.0005)
    elif kind == 1:
        tall = bow * rng.uniform(1.4, 2.4)
        head = box(1.6 * bow, tall, thickness, (0, 0, thickness / 2))
    else:
        outline = bow * np.array(
            [[-1.2, -0.7], [0.9, -1.1], [0.9, 1.1], [-1.2, 0.7]]
        )
        head = loft(outline, outline, thickness)
    end = length + bow
    solid = head + box(end, width, 0.9 * thickness, (end / 2, 0, thickness / 2))
    for i in range(int(rng.integers(2, 4))):
        size, gap = rng.uniform(0.004, 0.008), rng.uniform(0.008, 0.016)
        drop = rng.uniform(0.004, 0.013)
        x = end - 0.004 - i * 0.012 - 0.2 * gap
        middle = (x, -width / 2 - drop / 2 + 0.001, thickness / 2)
        solid += box(size, drop + 0.002, 0.8 * thickness, middle)
    return solid


def brush(rng: np.random.Generator) -> Solid:
    """A brush to paint, scrub or wash with: grip, head and bristles."""
    if rng.random() < 0.45:
        # The bristles go on where the handle ends.
        width, thick = rng.uniform(0.018, 0.055), rng.uniform(0.008, 0.014)
        ferrule, bristles = rng.uniform(0.012, 0.025), rng.uniform(0.02, 0.045)
        handle = rng.uniform(0.05, 0.09)
        solid = box(ferrule, width, thick)
        near = (ferrule / 2 - 0.001, 0.92 * width, 0.85 * thick)
        spread = width * rng.uniform(0.75, 1.2)
        corners = [
            [x, y * w, z * t]
            for x, w, t in (near, (ferrule / 2 + bristles, spread, 0.5 * thick))
            for y in (-0.5, 0.5)
            for z in (-0.5, 0.5)
        ]
        solid += convex(np.array(corners))
        start = -ferrule / 2 + 0.002
        first, last = rng.uniform(0.0045, 0.006), rng.uniform(0.005, 0.011)
        return solid + rod((start, 0, 0), (start - handle, 0, 0), first, last)
    # The bristles stand on the head.
    length, width = rng.uniform(0.035, 0.07), rng.uniform(0.02, 0.045)
    back, bristles = rng.uniform(0.006, 0.012), rng.uniform(0.008, 0.026)
    solid = box(length, width, back)
    foot = (
        0.46 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (length, width)
    )
    flare = rng.uniform(0.8, 1.15)
    tuft = loft(foot, foot * flare, bristles + 0.001)
    solid += tuft.moved(z=back / 2 - 0.001)
    handle = rng.uniform(0.05, 0.09) if rng.random() < 0.75 else 0.0
    if handle:
        tilt, grip = rng.uniform(-0.1, 0.35), rng.uniform(0.006, 0.010)
        start, x = -length / 2 + 0.006, -np.cos(tilt) * handle
        end = (start + x, 0, -np.sin(tilt) * handle)
        return solid + rod((start, 0, 0), end, grip * 0.75, grip)
    arch = rng.uniform(0.012, 0.02)
    middle = (0, 0, -back / 2 - arch / 2 + 0.001)
    return solid + box(0.7 * length, 0.5 * width, arch, middle)


def bulb(rng: np.random.Generator) -> Solid:
    """A lamp bulb: a globe or a candle, a neck and a socket."""
    radius, tall = rng.uniform(0.014, 0.022), rng.uniform(0.8, 1.7)
    socket, height = radius * rng.uniform(0.4, 0.75), rng.uniform(0.014, 0.03)
    neck = rng.uniform(0.010, 0.03)
    solid = cylinder(socket, height, sides=6)
    flare = frustum(socket, 0.8 * radius, neck, sides=6)
    solid += flare.moved(z=height - 0.001)
    squash = rng.uniform(0.7, 1)
    globe = ellipsoid((radius, squash * radius, tall * radius))
    solid += globe.moved(z=height + neck + 0.45 * tall * radius - 0.001)
    if rng.random() < 0.4:
        foot = socket * rng.uniform(1.2, 1.7)
        solid += cylinder(foot, rng.uniform(0.004, 0.008)).moved(z=-0.003)
    return solid


def rack(rng: np.random.Generator) -> Solid:
    """A stand: a plate with two to five posts or fins of the same height."""
    length, width = rng.uniform(0.05, 0.12), rng.uniform(0.03, 0.065)
    plate, height = rng.uniform(0.005, 0.010), rng.uniform(0.015, 0.05)
    solid = slab(length, width, plate)
    count = int(rng.integers(2, 6))
    fins, thick = rng.random() < 0.5, rng.uniform(0.0045, 0.007)
    reach = (length / 2 - thick) * rng.uniform(0.6, 1)
    across = width * rng.uniform(0.5, 1)
    tilt = rng.uniform(-0.3, 0.3)
    for x in np.linspace(-reach, reach, count):
        if fins:
            fin = slab(thick, across, height).turned((0, 1, 0), tilt)
            solid += fin.moved(x=x, z=plate - 0.002)
        else:
            top = (x + height * np.sin(tilt), 0, plate + height)
            solid += rod((x, 0, plate - 0.003), top, thick)
    return solid


FAMILIES = {
    "peg": Family(peg, (500, 1000)),
    "key": Family(key, (1200, 2700)),
    "brush": Family(brush, (400, 900)),
    "bulb": Family(bulb, (200, 500)),
    "rack": Family(rack, (500, 1100)),
}
