from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from xray_drake.cell.gripper import load_gripper
from xray_drake.grasping.wrench import (
    PadContact,
    holding_quality,
    jaw_holding_force,
    suction_holding_force,
)

WIDTH = 0.03
DOWN = np.array([0.0, 0.0, -1.0])


def pads(lean=0.0):
    """Two pads that squeeze along y, at distance WIDTH about the origin.

    Args:
        lean: of the faces that they press on, which open downwards, rad.
    """
    return tuple(
        PadContact(
            point=np.array([0.0, side * WIDTH / 2, 0.0]),
            normal=np.array([0.0, -side * np.cos(lean), -np.sin(lean)]),
            torsion_radius=0.003,
        )
        for side in (1.0, -1.0)
    )


@settings(max_examples=20)
@given(st.floats(0.1, 1.0), st.floats(1.0, 30.0), st.integers(0, 99))
def test_jaw_at_the_center_of_mass_holds_twice_the_friction(mu, force, seed):
    R = Rotation.random(random_state=seed).as_matrix()
    turned = tuple(
        replace(pad, point=R @ pad.point, normal=R @ pad.normal)
        for pad in pads()
    )
    held = jaw_holding_force(
        turned, np.zeros(3), R @ DOWN, friction=mu, force=force
    )
    assert held == pytest.approx(2 * mu * force, rel=1e-6)


@pytest.mark.parametrize(
    ("center", "gravity", "expected"),
    [
        # Beside the axis the torsion carries, ...
        *(([x, 0, 0], DOWN, 20 / (1 + x / 0.003)) for x in (0, 0.001, 0.05)),
        # ... along it the pads share, and the whole weight rests on one pad.
        *(([0, y, 0], DOWN, 10 / (0.5 + y / WIDTH)) for y in (0.004, 0.02)),
        ([0, 0, 0], np.array([0.0, 1.0, 0.0]), 20),
    ],
)
def test_where_the_center_of_mass_is(center, gravity, expected):
    held = jaw_holding_force(
        pads(), np.array(center), gravity, friction=0.5, force=20.0
    )
    assert held == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(("degrees", "holds"), [(20, True), (35, False)])
def test_a_wedge_holds_if_its_half_angle_is_within_the_cone(degrees, holds):
    """The faces open downwards: friction 0.5 carries up to 26.6°."""
    held = jaw_holding_force(
        pads(np.deg2rad(degrees)),
        np.zeros(3),
        DOWN,
        friction=0.5,
        force=20.0,
    )
    assert (held > 0.1) == holds


@settings(max_examples=20)
@given(seed=st.integers(0, 10_000))
def test_more_friction_never_holds_less(seed):
    rng = np.random.default_rng(seed)
    gravity = rng.normal(size=3)
    gravity /= np.linalg.norm(gravity)
    center = rng.normal(scale=0.02, size=3)
    held = [
        jaw_holding_force(pads(), center, gravity, friction=mu, force=20.0)
        for mu in (0.2, 0.4, 0.8)
    ]
    assert held == sorted(held)


ALONG = [0, 0, 1]
BEND = np.pi * 0.015 * 2.2 / np.sqrt(2)
CUPS = [
    ([0, 0, 0.02], ALONG, 14.0),
    ([0.001, 0, 0.02], ALONG, 14.0),
    # Beside the centre of mass the lip limits it, ...
    ([0.01, 0, 0.02], ALONG, BEND / 0.01),
    ([0.04, 0, 0.02], ALONG, BEND / 0.04),
    # ... on a vertical face friction.
    ([0, 0, 0], [1, 0, 0], 0.5 * 14.0 / np.sqrt(3)),
]


def test_what_limits_cups():
    """Each for itself, judged at once."""
    levers, gravities, expected = zip(*CUPS, strict=True)
    held = suction_holding_force(levers, gravities, load_gripper(), 0.5)
    np.testing.assert_allclose(held, expected)


@pytest.mark.parametrize(
    ("holding", "quality"), [(0.0, 0), (1.0, 0), (2.0, 0.5), (4.0, 0.75)]
)
def test_quality_is_the_margin_over_the_weight(holding, quality):
    assert holding_quality(holding, 1.0) == pytest.approx(quality)
