import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from xray_drake.grasping.wrench import (
    PadContact,
    holding_quality,
    jaw_holding_force,
    suction_holding_force,
)

WIDTH = 0.03
DOWN = np.array([0.0, 0.0, -1.0])


def pads(radius=0.003, R=None):
    """Two pads that squeeze along y, at distance WIDTH about the origin."""
    R = np.eye(3) if R is None else R
    return tuple(
        PadContact(
            point=R @ [0.0, side * WIDTH / 2, 0.0],
            normal=R @ [0.0, -side, 0.0],
            torsion_radius=radius,
        )
        for side in (1.0, -1.0)
    )


@settings(max_examples=20, deadline=None)
@given(
    friction=st.floats(0.1, 1.0),
    force=st.floats(1.0, 30.0),
    seed=st.integers(0, 99),
)
def test_jaw_at_the_center_of_mass_holds_twice_the_friction(
    friction, force, seed
):
    R = Rotation.random(random_state=seed).as_matrix()
    held = jaw_holding_force(
        pads(R=R), np.zeros(3), R @ DOWN, friction=friction, force=force
    )
    assert held == pytest.approx(2 * friction * force, rel=1e-6)


@pytest.mark.parametrize("offset", [0.0, 0.001, 0.01, 0.05])
def test_torsion_carries_a_center_of_mass_beside_the_axis(offset):
    radius, friction, force = 0.003, 0.5, 20.0
    held = jaw_holding_force(
        pads(radius),
        np.array([offset, 0.0, 0.0]),
        DOWN,
        friction=friction,
        force=force,
    )
    expected = 2 * friction * force / (1 + offset / radius)
    assert held == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("offset", [0.0, 0.004, 0.02])
def test_pads_share_a_center_of_mass_along_the_axis(offset):
    held = jaw_holding_force(
        pads(),
        np.array([0.0, offset, 0.0]),
        DOWN,
        friction=0.5,
        force=20.0,
    )
    expected = 0.5 * 20.0 / (0.5 + offset / WIDTH)
    assert held == pytest.approx(expected, rel=1e-6)


def test_weight_along_the_axis_rests_on_one_pad():
    held = jaw_holding_force(
        pads(), np.zeros(3), np.array([0.0, 1.0, 0.0]), friction=0.5, force=20.0
    )
    assert held == pytest.approx(20.0, rel=1e-6)


@pytest.mark.parametrize(
    ("degrees", "holds"), [(0, True), (20, True), (35, False)]
)
def test_a_wedge_holds_if_its_half_angle_is_within_the_cone(degrees, holds):
    """The faces open downwards: friction 0.5 carries up to 26.6°."""
    angle = np.deg2rad(degrees)
    contacts = tuple(
        PadContact(
            point=np.array([0.0, side * WIDTH / 2, 0.0]),
            normal=np.array([0.0, -side * np.cos(angle), -np.sin(angle)]),
            torsion_radius=0.003,
        )
        for side in (1.0, -1.0)
    )
    held = jaw_holding_force(
        contacts, np.zeros(3), DOWN, friction=0.5, force=20.0
    )
    assert (held > 0.1) == holds


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_more_friction_never_holds_less(seed):
    rng = np.random.default_rng(seed)
    gravity = rng.normal(size=3)
    gravity /= np.linalg.norm(gravity)
    center = rng.normal(scale=0.02, size=3)
    held = [
        jaw_holding_force(
            pads(), center, gravity, friction=friction, force=20.0
        )
        for friction in (0.2, 0.4, 0.8)
    ]
    assert held == sorted(held)


CUP = {
    "friction": 0.5,
    "vacuum_force": 14.0,
    "cup_radius": 0.015,
    "elasticity": 2.2,
}


def test_cup_above_the_center_of_mass_holds_the_vacuum_force():
    held = suction_holding_force([0, 0, 0.02], [0, 0, 1], **CUP)
    assert held == pytest.approx(14.0)


@pytest.mark.parametrize("offset", [0.001, 0.01, 0.04])
def test_cup_beside_the_center_of_mass_is_limited_by_its_lip(offset):
    held = suction_holding_force([offset, 0, 0.02], [0, 0, 1], **CUP)
    lip = np.pi * 0.015 * 2.2 / np.sqrt(2) / offset
    assert held == pytest.approx(min(14.0, lip))


def test_cup_on_a_vertical_face_is_limited_by_friction():
    held = suction_holding_force([0, 0, 0], [1, 0, 0], **CUP)
    assert held == pytest.approx(0.5 * 14.0 / np.sqrt(3))


def test_cups_are_judged_independently():
    lever = np.array([[0, 0, 0.02], [0.03, 0, 0.02]])
    gravity = np.array([[0, 0, 1.0], [0.6, 0, 0.8]])
    both = suction_holding_force(lever, gravity, **CUP)
    single = [
        suction_holding_force(a, b, **CUP)
        for a, b in zip(lever, gravity, strict=True)
    ]
    np.testing.assert_allclose(both, single)


@pytest.mark.parametrize(
    ("holding", "quality"), [(0.0, 0), (1.0, 0), (2.0, 0.5), (4.0, 0.75)]
)
def test_quality_is_the_margin_over_the_weight(holding, quality):
    assert holding_quality(holding, 1.0) == pytest.approx(quality)
