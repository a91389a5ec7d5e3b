"""Smooth paths of joints, within their limits."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.trajectories import (
    BezierCurve,
    CompositeTrajectory,
    PathParameterizedTrajectory,
    PiecewisePolynomial,
)

from xray_drake.gripper.models import JointLimits
from xray_drake.messages import Message

_PEAK_SPEED = 1.875
_PEAK_ACCELERATION = 10 / np.sqrt(3.0)
"""Of s(t) = 10 t³ − 15 t⁴ + 6 t⁵, which goes from rest at 0 to rest at 1."""

_SPARE = 1.01
"""Limits are looked at in samples; so much more time keeps between them."""


@dataclass(frozen=True, eq=False)
class Leg:
    """A way on which the tool's origin goes straight.

    Attributes:
        end: (n,) joint positions.
        speed: the tool's origin goes no faster, m/s.
        free: it need not go straight, if only it does not swing far out.
    """

    end: np.ndarray
    speed: float = np.inf
    free: bool = False


@dataclass(frozen=True, eq=False)
class Path(Message):
    """Joint positions over time; at rest before and after.

    Attributes:
        trajectory: Drake's, of as many rows as there are joints.
    """

    trajectory: CompositeTrajectory

    @property
    def end_time(self) -> float:
        """When it is over, s."""
        return float(self.trajectory.end_time())

    @property
    def end(self) -> np.ndarray:
        """The (n,) joint positions that it leads to."""
        return self.trajectory.value(self.end_time)[:, 0]

    def sample(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Returns (n,) joint positions and (n,) velocities at a time (s)."""
        time = min(max(time, self.trajectory.start_time()), self.end_time)
        return (
            self.trajectory.value(time)[:, 0],
            self.trajectory.EvalDerivative(time, 1)[:, 0],
        )

    def acceleration(self, time: float) -> np.ndarray:
        """Returns (n,) accelerations of the joints at a time (s)."""
        if not self.trajectory.start_time() <= time <= self.end_time:
            return np.zeros(self.trajectory.rows())
        return self.trajectory.EvalDerivative(time, 2)[:, 0]


def straight_path(
    start: np.ndarray,
    legs: Sequence[Leg],
    begin: float,
    *,
    velocity: np.ndarray,
    acceleration: np.ndarray,
    shortest: float = 0.05,
) -> Path:
    """Returns a path from rest to rest along legs, resting between them.

    Each leg is straight through joint space, and as fast as its own speed and
    the limits let a quintic in time be.

    Args:
        start: (n,) joint positions; the first three are those of slides.
        legs: one or more.
        begin: s.
        velocity: (n,) highest speeds, m/s or rad/s.
        acceleration: (n,) highest accelerations, m/s² or rad/s².
        shortest: least duration of a leg, s.
    """
    curves = []
    for leg in legs:
        way = np.abs(leg.end - start)
        duration = max(
            shortest,
            _PEAK_SPEED * float(np.linalg.norm(way[:3])) / leg.speed,
            _PEAK_SPEED * float((way / velocity).max()),
            float(np.sqrt(_PEAK_ACCELERATION * way / acceleration).max()),
        )
        points = np.column_stack([start] * 3 + [leg.end] * 3)
        curves.append(BezierCurve(begin, begin + duration, points))
        start, begin = leg.end, begin + duration
    return Path(CompositeTrajectory(curves))


def stay(q: np.ndarray, begin: float, duration: float) -> Path:
    """Returns a path that stays at joint positions (n,)."""
    points = np.column_stack([q] * 6)
    return Path(
        CompositeTrajectory([BezierCurve(begin, begin + duration, points)])
    )


def timed_curve(
    knots: np.ndarray,
    points: np.ndarray,
    begin: float,
    *,
    speed: float,
    tool_acceleration: float,
    limits: JointLimits,
    shortest: float = 0.05,
) -> PathParameterizedTrajectory:
    """Returns a smooth curve through knots, from rest to rest.

    It goes along its parameter as a quintic in time, as fast as the limits let
    it.

    Args:
        knots: (m, n) joint positions, evenly along the way.
        points: (m, 3) where the tool's origin is there, m.
        begin: s.
        speed: the tool's origin goes no faster, m/s.
        tool_acceleration: it accelerates no more, m/s².
        limits: of the n joints.
        shortest: least duration, s.
    """
    times = np.linspace(0, 1, 8 * len(knots) + 1)
    joints, tool = _spline(knots), _spline(points)
    (v, a), (v_tool, a_tool) = (
        [
            np.array([curve.EvalDerivative(t, order)[:, 0] for t in times])
            for order in (1, 2)
        ]
        for curve in (_quintic(line, 0.0, 1.0) for line in (joints, tool))
    )
    fastest = np.linalg.norm(v_tool, axis=1).max() / speed
    hardest = np.linalg.norm(a_tool, axis=1).max() / tool_acceleration
    duration = _SPARE * max(
        shortest,
        float((np.abs(v) / limits.velocity).max()),
        float(np.sqrt((np.abs(a) / limits.acceleration).max())),
        float(fastest),
        float(np.sqrt(hardest)),
    )
    return _quintic(joints, begin, duration)


def _spline(values: np.ndarray) -> PiecewisePolynomial:
    """Returns a spline through (m, n) values, over [0, 1]."""
    u = np.linspace(0, 1, max(len(values), 4))  # As few as it can do with.
    given = np.linspace(0, 1, len(values))
    rows = [np.interp(u, given, row) for row in values.T]
    return PiecewisePolynomial.CubicWithContinuousSecondDerivatives(
        u, np.array(rows), False
    )


def _quintic(
    curve: PiecewisePolynomial, begin: float, duration: float
) -> PathParameterizedTrajectory:
    """Returns a curve over [0, 1] gone along from rest to rest."""
    way = np.array([[0.0, 0.0, 0.0, 1.0, 1.0, 1.0]])
    return PathParameterizedTrajectory(
        curve, BezierCurve(begin, begin + duration, way)
    )
