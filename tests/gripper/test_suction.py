"""The law of the cup, without a plant."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.poses import at
from xray_drake.grasping.wrench import suction_holding_force
from xray_drake.gripper.suction import (
    Cup,
    CupState,
    HeldBody,
    SuctionConfig,
    deflection_of,
    hold,
    implicit_wrench,
    point_mobility,
    turned,
)

CUP = Cup()
STEP = 0.005

numbers = st.floats(-1, 1)
vectors = st.lists(numbers, min_size=3, max_size=3).map(np.array)
wrenches = st.lists(numbers, min_size=6, max_size=6).map(
    lambda w: np.array(w) * [0.1, 0.1, 0.1, 10, 10, 10]
)
masses = st.floats(np.log(0.002), np.log(0.5)).map(np.exp)


def inertia_of(mass, size=0.04):
    return mass * size**2 * np.diag([0.08, 0.12, 0.17])


def pull(force):
    return np.array([0, 0, 0, 0, 0, -force])


SHEAR = np.array([0, 0, 0, 0.6, 0.8, 0]) * 0.5 * 14.0
TWIST = np.array([0, 0, 0.015 * 0.5 * 14.0, 0, 0, 0])
BEND = np.array([0.6, 0.8, 0, 0, 0, 0]) * np.pi * 0.015 * 2.2


@pytest.mark.parametrize(
    ("wrench", "vacuum", "load"),
    [
        (pull(14.0), 1.0, 1.0),
        (pull(14.0), 0.5, 2.0),
        (pull(-14.0), 1.0, 0.0),  # pressed on
        (SHEAR, 1.0, 1.0),
        (TWIST, 1.0, 1.0),
        (BEND, 1.0, 1.0),
        (pull(0.01), 0.0, np.inf),  # without vacuum it bears no pull
        (pull(-0.01), 0.0, 0.0),
    ],
)
def test_the_limits_one_by_one(wrench, vacuum, load):
    assert CUP.load(wrench, vacuum) == pytest.approx(load)


def test_what_is_pressed_on_slides_less():
    assert CUP.load(SHEAR + pull(-7.0)) < 1.0 < CUP.load(SHEAR + pull(7.0))


@given(wrenches, wrenches, st.floats(0, 5), st.floats(0.01, 1))
def test_the_load_is_the_gauge_of_a_convex_set(a, b, factor, vacuum):
    load = CUP.load(a, vacuum)
    assert CUP.load(factor * a, vacuum) == pytest.approx(
        factor * load, abs=1e-9
    )
    both = load + CUP.load(b, vacuum)
    assert CUP.load(a + b, vacuum) <= both + 1e-9


@given(vectors, vectors)
def test_what_planning_promises_is_held(lever, gravity):
    """Planning linearises the same limits from inside (Dex-Net 3.0)."""
    assume(np.linalg.norm(gravity) > 0.1)
    gravity = gravity / np.linalg.norm(gravity)
    lever = 0.05 * lever
    p = CUP.gripper
    weight = float(suction_holding_force(lever, gravity, p, p.friction))
    # The cup answers the weight; z goes into the object, so it pulls by −z.
    held = -weight * np.concatenate([np.cross(lever, gravity), gravity])
    assert CUP.load(held) <= 1.0 + 1e-9


@given(masses, vectors, wrenches)
def test_the_mobility_is_that_of_a_free_body(mass, lever, wrench):
    lever = 0.05 * lever
    inertia = inertia_of(mass)
    W = point_mobility(mass, inertia, lever)
    np.testing.assert_allclose(W, W.T, rtol=1e-9, atol=1e-9 * np.abs(W).max())
    torque, force = wrench[:3], wrench[3:]
    alpha = np.linalg.solve(inertia, torque + np.cross(lever, force))
    expected = force / mass + np.cross(alpha, lever)
    np.testing.assert_allclose(
        W @ wrench, [*alpha, *expected], rtol=1e-6, atol=1e-9 * np.abs(W).max()
    )


@settings(max_examples=50)
@given(masses, vectors, vectors, vectors)
def test_a_body_on_the_cup_does_not_gain_energy(mass, lever, turn, shift):
    """Stepped as the plant does: new velocities, then positions by them."""
    inertia = inertia_of(mass)
    W = point_mobility(mass, inertia, 0.03 * lever)
    M = np.linalg.inv(W)
    K, C = CUP.stiffness, CUP.damping
    x, v = np.concatenate([0.3 * turn, 0.01 * shift]), np.zeros(6)
    energy = [0.5 * (x @ (K * x))]
    for _ in range(60):
        v = v + STEP * W @ implicit_wrench(K, C, W, x, v, np.zeros(6), STEP)
        x = x + STEP * v
        energy.append(0.5 * (x @ (K * x) + v @ M @ v))
    assert np.all(np.diff(energy) <= 1e-9 * energy[0] + 1e-15)
    assert energy[-1] <= 0.7 * energy[0] + 1e-15


STILL, DOWN = np.zeros(6), np.diag([1.0, -1.0, -1.0])


def body(mass, x, v=STILL, R_WC=DOWN):
    return HeldBody(
        mass=mass,
        inertia=inertia_of(mass),
        lever=np.zeros(3),
        R_WC=R_WC,
        deflection=x,
        velocity=v,
        cup_velocity=np.zeros(6),
    )


SEALED = CupState(object="plate", drawing=True, vacuum=1.0)
GRAVITY = np.array([0, 0, 0, 0, 0, -9.81])


@settings(max_examples=20)
@given(masses)
def test_it_bears_the_weight_of_a_free_body(mass):
    state, x, v = SEALED, np.zeros(6), np.zeros(6)
    W = point_mobility(mass, inertia_of(mass), np.zeros(3))
    for _ in range(200):
        state = hold(CUP, state, body(mass, x, v), STEP)
        v = v + STEP * (GRAVITY + W @ state.wrench)
        x = x + STEP * v
    assert state.object == "plate"
    weight = 9.81 * mass
    assert state.wrench[5] == pytest.approx(weight, rel=1e-3, abs=1e-6)
    assert x[5] == pytest.approx(-weight / 1750.0, rel=1e-2, abs=1e-9)
    assert state.load == pytest.approx(weight / 14.0, rel=1e-2)


@pytest.mark.parametrize("mass", [0.003, 0.3])
def test_on_a_body_that_is_stuck_it_pulls_like_a_spring(mass):
    state, x = SEALED, np.array([0, 0, 0, 0, 0, -0.004])
    for _ in range(400):
        state = hold(CUP, state, body(mass, x), STEP)
    assert state.wrench[5] == pytest.approx(0.004 * 1750.0, rel=1e-2)
    assert state.object == "plate"


@pytest.mark.parametrize(
    ("deflection", "why"),
    [
        ([0, 0, 0, 0, 0, -0.010], "it is pulled off"),  # 8 mm is the most
        ([0, 0, 0, 0.006, 0, 0], "it slides off"),
        ([0, 0, 0.5, 0, 0, 0], "it slides off"),
        ([0.8, 0, 0, 0, 0, 0], "the lip bends off"),
    ],
)
def test_too_much_for_long_ends_the_seal_and_says_why(deflection, why):
    held = body(0.3, np.array(deflection))
    state, steps = SEALED, 0
    while state.object:
        state = hold(CUP, state, held, STEP)
        assert np.abs(state.wrench).max() <= 14.0 + 1e-9  # it cannot do more
        steps += 1
        assert steps < 100
    if why == "it is pulled off":
        leak_time = CUP.config.leak_time
        assert steps * STEP == pytest.approx(leak_time, abs=2 * STEP)
    assert (state.lost, state.drawing, state.flow) == (why, True, 1.0)


def test_a_jerk_does_not():
    near, far = np.zeros(6), np.array([0, 0, 0, 0, 0, -0.010])
    state = SEALED
    for x in [far] * 5 + [near] * 5 + [far] * 5 + [near] * 20:
        state = hold(CUP, state, body(0.3, x), STEP)
    assert state.object == "plate"
    assert state.overloaded == 0.0


def test_the_vacuum_takes_its_time():
    state = CupState(object="plate", drawing=True)
    vacuum = []
    for _ in range(40):
        state = hold(CUP, state, body(0.1, np.zeros(6)), STEP)
        vacuum.append(state.vacuum)
    assert 0.05 < vacuum[0] < 0.2
    assert np.all(np.diff(vacuum) > 0)
    assert vacuum[9] == pytest.approx(1 - np.exp(-1.0))  # evacuation_time
    assert vacuum[-1] > 0.95
    assert state.flow == pytest.approx(1 - state.vacuum)


@given(st.integers(0, 2**31))
def test_directions_do_not_matter(seed):
    """The same in other axes: the law has no preferred direction."""
    rng = np.random.default_rng(seed)
    R = Rotation.random(random_state=seed % 1000).as_matrix()
    x, v = rng.normal(size=6) * 1e-3, rng.normal(size=6) * 0.1
    plain = body(0.05, x, v, R_WC=np.eye(3))
    other = replace(
        plain,
        inertia=R @ plain.inertia @ R.T,
        R_WC=R,
        deflection=turned(R, x),
        velocity=turned(R, v),
    )
    a, b = (hold(CUP, SEALED, held, STEP).wrench for held in (plain, other))
    np.testing.assert_allclose(turned(R, a), b, atol=1e-9)


def test_the_damping_is_what_is_configured():
    cup = Cup(config=SuctionConfig(damping_time=0.02))
    np.testing.assert_allclose(cup.damping, 0.02 * CUP.stiffness)


def test_a_deflection():
    found = deflection_of(at(roll=0.3), at(0, 0.001, 0.002, roll=0.5))
    expected = [0.2, 0, 0, 0, 0.001, 0.002]
    np.testing.assert_allclose(found, expected, atol=1e-12)
