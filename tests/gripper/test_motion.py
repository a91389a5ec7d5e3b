import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.poses import at
from xray_drake.gripper.motion import Grip, Segment, straight


def pose(rng):
    X = at(*rng.uniform(-1, 1, 3))
    X[:3, :3] = Rotation.from_quat(rng.normal(size=4)).as_matrix()
    return X


@st.composite
def segments(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    begin, duration = draw(st.floats(0, 100)), draw(st.floats(0.1, 3))
    return Segment(pose(rng), pose(rng), begin, duration)


@settings(max_examples=30)
@given(segments(), st.floats(0, 2))
def test_it_goes_from_rest_to_rest(segment, more):
    first, last = segment.begin, segment.begin + segment.duration
    for time, end in (
        (first - more, segment.start),
        (first, segment.start),
        (last, segment.end),
        (last + more, segment.end),
    ):
        X, v, a = segment.sample(time)
        np.testing.assert_allclose(X, end, atol=1e-9)
        np.testing.assert_allclose(v, 0, atol=1e-9)
        np.testing.assert_allclose(a, 0, atol=1e-6 / segment.duration**2)


@settings(max_examples=30)
@given(segments(), st.floats(0.02, 0.98))
def test_velocity_and_acceleration_are_derivatives(segment, share):
    time, h = segment.begin + share * segment.duration, 1e-4
    before, now, after = (segment.sample(time + s * h) for s in (-1, 0, 1))
    scale = 10 / segment.duration
    v = (after[0][:3, 3] - before[0][:3, 3]) / (2 * h)
    np.testing.assert_allclose(v, now[1], atol=1e-5 * scale**3)
    a = (after[1] - before[1]) / (2 * h)
    np.testing.assert_allclose(a, now[2], atol=1e-5 * scale**4)


@settings(max_examples=30)
@given(segments(), st.floats(0, 1))
def test_it_is_straight_and_turns_the_short_way(segment, share):
    X, _, _ = segment.sample(segment.begin + share * segment.duration)
    R = X[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(R) == pytest.approx(1.0)
    step = segment.end[:3, 3] - segment.start[:3, 3]
    done = X[:3, 3] - segment.start[:3, 3]
    way = done @ step / (step @ step)
    np.testing.assert_allclose(done, way * step, atol=1e-9)
    whole = Rotation.from_matrix(segment.start[:3, :3].T @ segment.end[:3, :3])
    part = Rotation.from_matrix(segment.start[:3, :3].T @ R)
    turned = way * whole.magnitude()
    np.testing.assert_allclose(part.magnitude(), turned, atol=1e-6)


@settings(max_examples=30)
@given(
    st.one_of(st.just(0.0), st.floats(0.001, 2)),
    st.floats(0.05, 2),
    st.integers(0, 2**32 - 1),
)
def test_a_straight_motion_keeps_to_its_speed(distance, speed, seed):
    rng = np.random.default_rng(seed)
    start = pose(rng)
    direction = rng.normal(size=3)
    to = start[:3, 3] + distance * direction / np.linalg.norm(direction)
    segment = straight(start, to, 1.0, speed=speed)
    np.testing.assert_allclose(segment.end[:3, 3], to)
    np.testing.assert_array_equal(segment.end[:3, :3], start[:3, :3])
    assert segment.duration >= 0.2
    times = segment.begin + np.linspace(0, segment.duration, 21)
    fastest = max(np.linalg.norm(segment.sample(t)[1]) for t in times)
    assert fastest <= speed * (1 + 1e-9)
    if segment.duration > 0.2:
        assert fastest == pytest.approx(speed)
    over = [segment.is_over(t) for t in (1.0, times[-2], times[-1])]
    assert over == [False, False, True]


class Body:
    """A free rigid body under gravity that a grip draws along."""

    def __init__(self, mass, grip=None):
        self.mass = mass
        self.inertia = 1e-4 * mass * np.diag([1.0, 2.0, 2.5])
        self.grip = grip or Grip()
        self.R = np.eye(3)
        self.p, self.v, self.w = np.zeros(3), np.zeros(3), np.zeros(3)

    def wrench(self, desired):
        return self.grip.wrench(
            mass=self.mass,
            inertia_W=self.R @ self.inertia @ self.R.T,
            desired=desired,
            R_WO=self.R,
            p_WCom=self.p,
            w_WO=self.w,
            v_WCom=self.v,
        )

    def step(self, desired):
        h = self.grip.step
        torque, force = self.wrench(desired)
        inertia_W = self.R @ self.inertia @ self.R.T
        gyro = np.cross(self.w, inertia_W @ self.w)
        self.v = self.v + h * (force / self.mass - [0, 0, 9.81])
        self.w = self.w + h * np.linalg.solve(inertia_W, torque - gyro)
        self.p = self.p + h * self.v
        self.R = Rotation.from_rotvec(h * self.w).as_matrix() @ self.R
        return torque, force


def still(X):
    return X, np.zeros(3), np.zeros(3)


MASSES = [0.003, 0.05, 0.4]
"""kg, from the targets to a full bottle."""

EACH_MASS = pytest.mark.parametrize("mass", MASSES)


@EACH_MASS
@pytest.mark.parametrize("a", [np.zeros(3), np.array([0.3, -0.2, 1.0])])
def test_a_body_that_follows_is_borne_and_accelerated(mass, a):
    body = Body(mass)
    body.v = a / 3
    torque, force = body.wrench((np.eye(4), body.v, a))
    np.testing.assert_allclose(force, mass * (a + [0, 0, 9.81]))
    np.testing.assert_array_equal(torque, 0)


@settings(max_examples=50)
@given(st.sampled_from(MASSES), st.integers(0, 2**32 - 1))
def test_the_wrench_is_the_springs_at_the_end_of_the_step(mass, seed):
    """Backward Euler: what makes it stable for any mass."""
    rng = np.random.default_rng(seed)
    body = Body(mass)
    grip = body.grip
    body.v = 0.1 * rng.normal(size=3)
    body.w = np.array([0.0, 0.0, 0.4])
    X = at(*(0.005 * rng.normal(size=3)), yaw=0.1)
    v = 0.1 * rng.normal(size=3)
    torque, force = body.step((X, v, np.zeros(3)))
    force = force - [0, 0, 9.81 * mass]
    lag = X[:3, 3] + grip.step * v - body.p
    expected = grip.stiffness * lag + grip.damping * (v - body.v)
    np.testing.assert_allclose(force, expected, rtol=1e-6, atol=1e-9)
    left = Rotation.from_matrix(X[:3, :3] @ body.R.T).as_rotvec()
    expected = grip.arm**2 * (grip.stiffness * left - grip.damping * body.w)
    np.testing.assert_allclose(torque, expected, atol=1e-9)
    assert torque[2] != 0


@EACH_MASS
def test_the_pull_is_limited(mass):
    body = Body(mass, Grip(force=3.0))
    torque, force = body.wrench(still(at(0.0, 40.0, 30.0, pitch=3.0)))
    pull = force - [0, 0, 9.81 * mass]
    np.testing.assert_allclose(pull, [0.0, 2.4, 1.8])
    assert np.linalg.norm(torque) <= 3.0 * body.grip.arm * (1 + 1e-9)
    assert torque[1] > 0


@EACH_MASS
def test_a_body_follows_a_lift_and_comes_to_rest(mass):
    body = Body(mass)
    body.R = Rotation.from_rotvec([0.3, -0.2, 0.4]).as_matrix()
    segment = straight(np.eye(4), np.array([0.0, 0.1, 0.2]), 0.0, speed=0.8)
    lag = 0.0
    for i in range(300):
        desired = segment.sample(0.005 * i)
        lag = max(lag, float(np.linalg.norm(desired[0][:3, 3] - body.p)))
        body.step(desired)
    assert lag < 0.01
    np.testing.assert_allclose(body.p, [0, 0.1, 0.2], atol=1e-4)
    np.testing.assert_allclose(body.R, np.eye(3), atol=1e-3)
    np.testing.assert_allclose(body.v, 0, atol=1e-3)
    np.testing.assert_allclose(body.w, 0, atol=1e-2)


@EACH_MASS
def test_the_spring_does_not_swing(mass):
    body = Body(mass)
    way = []
    for _ in range(200):
        body.step(still(at(0.01)))
        way.append(body.p[0])
    assert max(way) <= 0.01 * 1.001
    assert way[-1] == pytest.approx(0.01, abs=1e-5)
