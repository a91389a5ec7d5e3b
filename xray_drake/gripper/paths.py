"""Smooth paths of the wrist's joints, within its limits."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.trajectories import BezierCurve, CompositeTrajectory

from xray_drake.gripper.wrist import Wrist
from xray_drake.messages import Message

_PEAK_SPEED = 1.875
_PEAK_ACCELERATION = 10 / np.sqrt(3.0)
"""Of s(t) = 10 t³ − 15 t⁴ + 6 t⁵, which goes from rest at 0 to rest at 1."""


@dataclass(frozen=True, eq=False)
class Leg:
    """A straight way through joint space.

    Attributes:
        end: (6,) joint positions.
        speed: the tool's origin goes no faster, m/s.
    """

    end: np.ndarray
    speed: float = np.inf


@dataclass(frozen=True, eq=False)
class Path(Message):
    """Joint positions over time; at rest before and after.

    Attributes:
        trajectory: Drake's, of six rows.
    """

    trajectory: CompositeTrajectory

    @property
    def end_time(self) -> float:
        """When it is over, s."""
        return float(self.trajectory.end_time())

    @property
    def end(self) -> np.ndarray:
        """The (6,) joint positions that it leads to."""
        return self.trajectory.value(self.end_time)[:, 0]

    def sample(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Returns (6,) joint positions and (6,) velocities at a time (s)."""
        time = min(max(time, self.trajectory.start_time()), self.end_time)
        return (
            self.trajectory.value(time)[:, 0],
            self.trajectory.EvalDerivative(time, 1)[:, 0],
        )


def make_path(
    start: np.ndarray,
    legs: Sequence[Leg],
    begin: float,
    *,
    wrist: Wrist,
    shortest: float = 0.05,
) -> Path:
    """Returns a path from rest to rest along legs, resting between them.

    Each leg is as fast as its own speed and the wrist's velocity and
    acceleration limits let a quintic in time be.

    Args:
        start: (6,) joint positions.
        legs: one or more.
        begin: s.
        wrist: its limits.
        shortest: least duration of a leg, s.
    """
    curves = []
    for leg in legs:
        way = np.abs(leg.end - start)
        duration = max(
            shortest,
            _PEAK_SPEED * float(np.linalg.norm(way[:3])) / leg.speed,
            _PEAK_SPEED * float((way / wrist.velocity).max()),
            float(np.sqrt(_PEAK_ACCELERATION * way / wrist.acceleration).max()),
        )
        points = np.column_stack([start] * 3 + [leg.end] * 3)
        curves.append(BezierCurve(begin, begin + duration, points))
        start, begin = leg.end, begin + duration
    return Path(CompositeTrajectory(curves))


def stay(q: np.ndarray, begin: float, duration: float) -> Path:
    """Returns a path that stays at joint positions (6,)."""
    points = np.column_stack([q] * 6)
    return Path(
        CompositeTrajectory([BezierCurve(begin, begin + duration, points)])
    )
