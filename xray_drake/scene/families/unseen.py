"""Families that training never uses: the test set is drawn from them."""

import numpy as np

from xray_drake.scene.families.family import Family
from xray_drake.scene.shapes import (
    Solid,
    arc,
    beam,
    box,
    convex,
    cylinder,
    ellipsoid,
    frustum,
    prism,
    rod,
    slab,
)


def airplane(rng: np.random.Generator) -> Solid:
    """A toy airplane: fuselage, swept wings, tailplane and fin."""
    length, radius = rng.uniform(0.07, 0.13), rng.uniform(0.007, 0.012)
    tail = radius * rng.uniform(0.35, 0.8)
    nose = length * rng.uniform(0.12, 0.2)
    solid = rod((0, 0, 0), (-length, 0, 0.2 * radius), radius, tail)
    solid += rod((-0.001, 0, 0), (nose, 0, 0), radius, 0.4 * radius)
    chord, span = length * rng.uniform(0.18, 0.34), rng.uniform(0.08, 0.14)
    sweep, tip = rng.uniform(0, 0.3) * span, rng.uniform(0.35, 0.9) * chord
    place = -rng.uniform(0.2, 0.4) * length
    height = rng.uniform(-0.6, 0.6) * radius

    def wing(chord: float, tip: float, span: float, sweep: float) -> Solid:
        back = -sweep - tip
        right = [[-sweep, span / 2], [back, span / 2], [min(-chord, back), 0]]
        left = [[-sweep, -span / 2], [0, 0]]
        outline = np.array([*left, *right, [back, -span / 2]])
        return prism(outline, 0.004).moved(z=-0.002)

    solid += wing(chord, tip, span, 0.5 * sweep).moved(x=place, z=height)
    share = rng.uniform(0.3, 0.5)
    chord *= 0.6
    tailplane = wing(chord, 0.6 * tip, share * span, 0.3 * share * sweep)
    solid += tailplane.moved(x=chord - length, z=0.3 * radius)
    up = rng.uniform(0.015, 0.03)
    side = np.array([[0, 0], [-chord, 0], [-chord, up], [-0.6 * chord, up]])
    fin = prism(side, 0.004).turned((1, 0, 0), np.pi / 2)
    return solid + fin.moved(x=chord - length, y=0.002, z=0.3 * tail)


def chair(rng: np.random.Generator) -> Solid:
    """A chair or a stool of a doll's house."""
    width, depth = rng.uniform(0.03, 0.05), rng.uniform(0.03, 0.05)
    seat, leg = rng.uniform(0.005, 0.009), rng.uniform(0.022, 0.045)
    thick = rng.uniform(0.005, 0.008)
    solid = slab(depth, width, seat)
    splay = rng.uniform(-0.05, 0.2)
    for i in (-1, 1):
        for j in (-1, 1):
            x, y = i * (depth - thick) / 2, j * (width - thick) / 2
            foot = (x + i * splay * leg, y + j * splay * leg, -leg)
            solid += rod((x, y, 0.003), foot, thick / 2)
    if rng.random() < 0.75:
        back, lean = rng.uniform(0.02, 0.055), rng.uniform(0, 0.3)
        rest = slab(thick, width, back).turned((0, 1, 0), -lean)
        solid += rest.moved(x=(thick - depth) / 2, z=seat - 0.002)
    return solid


def scissors(rng: np.random.Generator) -> Solid:
    """Two crossing blades, each with half a loop at its end."""
    blade, shank = rng.uniform(0.045, 0.085), rng.uniform(0.025, 0.045)
    width, thickness = rng.uniform(0.009, 0.015), rng.uniform(0.004, 0.006)
    opening = rng.uniform(0.15, 0.6)
    outer, band = rng.uniform(0.012, 0.019), rng.uniform(0.004, 0.006)
    lower = [[-shank, -0.4 * width], [0, -0.5 * width], [blade, -0.1 * width]]
    upper = [[blade, 0.15 * width], [0, 0.5 * width], [-shank, 0.4 * width]]
    outline = np.array(lower + upper)
    loop = arc(outer - band, outer, thickness, np.pi, 3)
    half = prism(outline, thickness)
    for part in (loop, slab(2 * outer, band, thickness)):
        half += part.moved(x=0.002 - shank - outer, y=-0.2 * width)
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    other = Solid(
        tuple(mesh.copy().apply_transform(mirror) for mesh in half.surfaces),
        tuple(hull * (1, -1, 1) for hull in half.hulls),
    )
    half = half.turned((0, 0, 1), -opening / 2)
    other = other.turned((0, 0, 1), opening / 2)
    return half + other.moved(z=thickness - 0.0005)


def sunglasses(rng: np.random.Generator) -> Solid:
    """Two dark lenses, a bridge and two temples, open or half folded."""
    width, height = rng.uniform(0.042, 0.055), rng.uniform(0.026, 0.045)
    gap, thickness = rng.uniform(0.012, 0.02), 0.004
    temple, fold = rng.uniform(0.06, 0.11), rng.uniform(0, 0.5)
    cut = rng.uniform(0.45, 0.95)
    x, y, low = width / 2, height / 2, cut * width / 2
    outline = np.array([[-x, y], [-low, -y], [low, -y], [x, y]])
    middle = (gap + width) / 2
    lens = prism(outline, thickness)
    bar = rng.uniform(0.004, 0.008)
    solid = lens.moved(x=-middle) + lens.moved(x=middle)
    solid += box(gap + 0.012, bar, thickness, (0, 0.25 * height, thickness / 2))
    for sign in (-1, 1):
        arm = slab(0.004, bar, temple).turned((0, 1, 0), -sign * fold)
        x = sign * (middle + width / 2 - 0.003)
        solid += arm.moved(x=x, y=0.4 * height, z=0.001)
    return solid


def padlock(rng: np.random.Generator) -> Solid:
    """A body under a shackle."""
    width, height = rng.uniform(0.03, 0.055), rng.uniform(0.028, 0.055)
    thickness = rng.uniform(0.012, 0.024)
    band = rng.uniform(0.0055, 0.009)
    outer = width * rng.uniform(0.36, 0.48)
    leg = rng.uniform(0.006, 0.03)
    if rng.random() < 0.6:
        solid = box(width, thickness, height, (0, 0, -height / 2))
    else:
        lower = rng.uniform(0.55, 0.9)
        outline = np.array([[-1, 0], [1, 0], [lower, -1], [-lower, -1]])
        outline = width / 2 * outline
        outline[:, 1] *= 2 * height / width
        solid = prism(outline, thickness).turned((1, 0, 0), np.pi / 2)
        solid = solid.moved(y=thickness / 2)
    depth = 0.6 * min(band, thickness)
    shackle = arc(outer - band, outer, depth, np.pi, 4).moved(z=-depth / 2)
    solid += shackle.turned((1, 0, 0), np.pi / 2).moved(z=leg)
    for sign in (-1, 1):
        x = sign * (outer - band / 2)
        solid += box(band, depth, leg + 0.003, (x, 0, (leg - 0.002) / 2))
    return solid


def camera(rng: np.random.Generator) -> Solid:
    """A photo camera: body, lens, finder and release."""
    width, height = rng.uniform(0.06, 0.10), rng.uniform(0.038, 0.06)
    depth = rng.uniform(0.02, 0.036)
    radius, reach = rng.uniform(0.3, 0.46) * height, rng.uniform(0.012, 0.045)
    x = rng.uniform(-0.15, 0.15) * width
    solid = box(width, depth, height)
    lens = frustum(radius, radius * rng.uniform(0.75, 1.1), reach + 0.001)
    lens = lens.turned((1, 0, 0), np.pi / 2)
    solid += lens.moved(x=x, y=0.001 - depth / 2)
    hood, up = width * rng.uniform(0.12, 0.22), rng.uniform(0.008, 0.016)
    corners = [
        [side * s, y * depth / 2, z]
        for side, z in ((hood, 0), (0.6 * hood, up))
        for s in (-1, 1)
        for y in (-0.9, 0.7)
    ]
    solid += convex(np.array(corners)).moved(x=x, z=height / 2 - 0.001)
    button = rng.uniform(0.005, 0.008)
    release = cylinder(button, 0.007, sides=6)
    solid += release.moved(x=-0.38 * width, z=height / 2 - 0.001)
    if rng.random() < 0.5:
        grip = rng.uniform(0.008, 0.016)
        middle = (-0.39 * width, -depth / 2 - grip / 2 + 0.001, 0)
        solid += box(0.22 * width, grip, 0.9 * height, middle)
    return solid


def tap(rng: np.random.Generator) -> Solid:
    """A water tap: foot, column, a spout that bends down, and a lever."""
    foot, column = rng.uniform(0.014, 0.022), rng.uniform(0.04, 0.08)
    radius = rng.uniform(0.008, 0.013)
    spout, slim = rng.uniform(0.04, 0.075), radius * rng.uniform(0.55, 0.85)
    rise = rng.uniform(-0.1, 0.6) * spout
    start = column * rng.uniform(0.5, 0.95)
    solid = cylinder(foot, rng.uniform(0.006, 0.012))
    solid += rod((0, 0, 0.002), (0, 0, column), radius)
    end = (spout, 0.0, start + rise)
    solid += rod((0, 0, start - 0.3 * slim), end, slim)
    drop = rng.uniform(0.01, 0.03)
    above = (spout, 0, end[2] + 0.8 * slim)
    solid += rod(above, (spout, 0, end[2] - drop), slim)
    turn, lever = rng.uniform(0, np.pi), rng.uniform(0.025, 0.05)
    bar = box(lever, 0.008, 0.006, (lever / 2 - 0.006, 0, 0))
    bar = bar.turned((0, 1, 0), -rng.uniform(0, 0.6)).turned((0, 0, 1), turn)
    return solid + bar.moved(z=column + 0.0015)


def propeller(rng: np.random.Generator) -> Solid:
    """Two to five twisted blades on a hub."""
    blades = int(rng.integers(2, 6))
    hub, height = rng.uniform(0.008, 0.015), rng.uniform(0.014, 0.03)
    length, root = rng.uniform(0.03, 0.065), rng.uniform(0.008, 0.014)
    tip, thick = root * rng.uniform(0.8, 2.2), rng.uniform(0.004, 0.006)
    pitch, twist = rng.uniform(0.2, 0.9), rng.uniform(0, 0.5)

    def chord(x: float, width: float, angle: float) -> list[list[float]]:
        c, s = np.cos(angle), np.sin(angle)
        return [
            [x, c * y - s * z, s * y + c * z]
            for y in (-width / 2, width / 2)
            for z in (-thick / 2, thick / 2)
        ]

    corners = chord(0.5 * hub, root, pitch)
    corners += chord(length, tip, pitch - twist)
    blade = convex(np.array(corners))
    solid = cylinder(hub, height).moved(z=-height / 2)
    for i in range(blades):
        solid += blade.turned((0, 0, 1), 2 * np.pi * i / blades)
    if rng.random() < 0.5:
        cone = frustum(hub, 0.3 * hub, rng.uniform(0.008, 0.02))
        solid += cone.moved(z=height / 2 - 0.001)
    return solid


def anchor(rng: np.random.Generator) -> Solid:
    """A ship's anchor: shank, stock, two arms and their flukes."""
    length, radius = rng.uniform(0.06, 0.11), rng.uniform(0.004, 0.007)
    arm, lift = rng.uniform(0.025, 0.05), rng.uniform(0.2, 0.9)
    stock, place = rng.uniform(0.015, 0.035), rng.uniform(0.72, 0.92)
    thick = 1.5 * radius
    solid = rod((0, -0.4 * radius, 0), (0, length, 0), radius)
    y = place * length
    if rng.random() < 0.5:
        solid += rod((-stock, y, 0), (stock, y, 0), 0.8 * radius)
    else:
        solid += rod((0, y, -stock), (0, y, stock), 0.8 * radius)
    palm = rng.uniform(0.008, 0.014)
    for sign in (-1, 1):
        end = (sign * arm * np.cos(lift), arm * np.sin(lift))
        solid += beam((-sign * 0.003, 0), end, thick, thick).moved(z=-thick / 2)
        tri = np.array([[0.4, 0], [-0.5, -1], [-0.5, 1]]) * palm
        fluke = prism(tri, 0.005).moved(z=-0.0025)
        fluke = fluke.turned((1, 0, 0), np.pi / 2)
        angle = lift if sign > 0 else np.pi - lift
        angle += sign * 0.5
        solid += fluke.turned((0, 0, 1), angle).moved(*end)
    return solid


def teapot(rng: np.random.Generator) -> Solid:
    """A belly, a spout, a handle of three bars, and a knob on the lid."""
    radius, height = rng.uniform(0.022, 0.034), rng.uniform(0.03, 0.055)
    top = radius * rng.uniform(0.55, 1.05)
    solid = frustum(radius, top, height)
    middle = (radius + top) / 2
    reach, mouth = rng.uniform(0.022, 0.04), rng.uniform(0.0035, 0.005)
    low, high = rng.uniform(0.2, 0.5) * height, rng.uniform(0.85, 1.15) * height
    start, end = (0.7 * middle, 0, low), (middle + reach, 0, high)
    solid += rod(start, end, mouth * rng.uniform(1.3, 2.0), mouth)
    out, bar = rng.uniform(0.018, 0.03), rng.uniform(0.005, 0.0075)
    first, second = 0.22 * height, 0.85 * height
    x = -middle - out
    for z in (first, second):
        arm = (x / 2 - 0.25 * middle, 0, z)
        solid += box(out + 0.5 * middle, bar, bar, arm)
    solid += box(bar, bar, second - first + bar, (x, 0, (first + second) / 2))
    knob = rng.uniform(0.006, 0.010)
    return solid + ellipsoid((knob, knob, knob)).moved(z=height + 0.6 * knob)


def drill(rng: np.random.Generator) -> Solid:
    """A power drill: motor, chuck, bit, grip and battery."""
    radius, length = rng.uniform(0.012, 0.018), rng.uniform(0.045, 0.075)
    chuck, bit = rng.uniform(0.012, 0.022), rng.uniform(0.015, 0.04)
    grip, lean = rng.uniform(0.035, 0.06), rng.uniform(-0.05, 0.35)
    solid = rod((0, 0, 0), (length, 0, 0), radius)
    back, front = (length - 0.001, 0, 0), (length + chuck, 0, 0)
    solid += rod(back, front, 0.8 * radius, 0.4 * radius)
    start = length + chuck - 0.002
    solid += rod((start, 0, 0), (start + bit, 0, 0), rng.uniform(0.003, 0.0045))
    width, thick = rng.uniform(0.015, 0.022), 1.2 * radius
    bar = box(width, thick, grip, (0, 0, -grip / 2))
    x = length * rng.uniform(0.15, 0.45)
    solid += bar.turned((0, 1, 0), lean).moved(x=x, z=-0.5 * radius)
    long, wide = width * rng.uniform(1.3, 2.2), thick * rng.uniform(1.1, 1.6)
    pack = box(long, wide, rng.uniform(0.010, 0.018))
    z = -0.5 * radius - np.cos(lean) * grip
    return solid + pack.moved(x=x - np.sin(lean) * grip, z=z)


FAMILIES = {
    "airplane": Family(airplane, (400, 900)),
    "chair": Family(chair, (500, 900)),
    "scissors": Family(scissors, (1200, 2700)),
    "sunglasses": Family(sunglasses, (900, 1300)),
    "padlock": Family(padlock, (1200, 2700)),
    "camera": Family(camera, (400, 900)),
    "tap": Family(tap, (900, 2200)),
    "propeller": Family(propeller, (600, 1400)),
    "anchor": Family(anchor, (1200, 2700)),
    "teapot": Family(teapot, (400, 900)),
    "drill": Family(drill, (500, 1000)),
}
