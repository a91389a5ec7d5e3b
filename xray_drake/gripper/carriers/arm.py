"""Joint positions and paths of the YuMi-like arm."""

import itertools
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.trajectories import CompositeTrajectory, PiecewisePose

from xray_drake.cell.cell import Cell
from xray_drake.gripper.carriers.arm_cell import YUMI_ARM, ArmCell, ArmModel
from xray_drake.gripper.carriers.carrier import ReachError, Tracking
from xray_drake.gripper.carriers.paths import Leg, Path, timed_curve

_SEEDS = 12
"""Joint positions that inverse kinematics begins at."""

_STEP = 0.02
_TURN = 0.1
"""Ways are followed in steps of this much at most, m and rad."""

_JUMP = 0.5
"""No joint turns further in one of them, rad."""

_LEVER = 0.3
"""Moments about the tool count as forces with this lever, m."""

_TURNS = np.deg2rad([0, 20, -20, 40, -40, 60, -60])
"""The tool is turned by so much more than the arm, tried in this order."""

_ROUNDS = (0.0, 2 * np.pi, -2 * np.pi)

_FEELING = 0.03
"""Of the Jacobian, singular values below this share of the largest tell
nothing of the force."""

_DIGITS = 6
"""Ways are compared after so many decimals, that rounding decides nothing."""

_NEAR_ENOUGH = 0.01
"""What is released this much higher than wanted is set down, too, m."""


class Arm:
    """Turning joints, the first about the vertical; tool frame at the flange.

    An arm with seven joints can be at a pose in many ways. Drake's differential
    inverse kinematics (:meth:`~xray_drake.gripper.carriers.arm_cell.ArmCell.\
reach`) finds some, from several seeds; from there a straight path is followed
    in small steps, which leave one way to turn the elbow: to the middle of the
    joints' limits.
    """

    name = "arm"

    def __init__(
        self, model: ArmModel = YUMI_ARM, cell: Cell | None = None
    ) -> None:
        """Builds the arm's model."""
        self._model = model
        cell = cell or Cell()
        X_WA = model.mounted(cell)
        self._axis = X_WA[:2, 3]
        # Axis 1 points up (1) or down (−1).
        self._sign = float(X_WA[2, 2])
        self.highest = float(X_WA[2, 3]) - model.headroom
        self.cell = ArmCell(model, cell)
        self.limits = self.cell.limits
        self.pose = self.cell.pose

    @cached_property
    def home(self) -> np.ndarray:
        """The (n,) joint positions in which the arm waits."""
        X_WT = np.diag([1.0, -1.0, -1.0, 1.0])
        X_WT[:3, 3] = *(self._axis + self._model.home_place), self.highest
        q = self.cell.reach(X_WT, self._model.home, centred=False)
        if q is None:
            raise ReachError("the arm cannot be at home")
        return q

    def along(
        self, poses: Sequence[np.ndarray], *, near: np.ndarray
    ) -> list[np.ndarray]:
        """Returns joint positions at poses that a straight way leads through.

        Raises:
            ReachError: it cannot be at one of them, or not go straight.
        """
        reached = ""
        for q in self._configurations(poses[0], near):
            reached = "straight on from the "
            found = [q]
            for X_WT in poses[1:]:
                way = self._straight_on(found[-1], X_WT)
                if not np.allclose(self.pose(way), X_WT, rtol=0.0, atol=1e-6):
                    break
                found.append(way)
            else:
                return found
        p = ", ".join(f"{x:.2f}" for x in poses[0][:3, 3])
        raise ReachError(f"out of the arm's reach: {reached}tool at ({p}) m")

    def at_height(self, q: np.ndarray, height: float) -> np.ndarray:
        """Returns q with the tool straight above or below, at a height (m).

        Where the tool cannot go as far, it goes as far as it can.
        """
        X_WT = self.pose(q)
        X_WT[2, 3] = height
        return self._straight_on(q, X_WT)

    def over(
        self,
        q: np.ndarray,
        p_T: np.ndarray,
        place: np.ndarray,
        *,
        lowest: float,
    ) -> np.ndarray:
        """Returns q with a point of the tool over a place.

        The tool keeps its height and its tilt; it turns about the vertical as
        the arm does, or otherwise if it comes further down so. Where it cannot
        stay level on the way, it is level at the end.

        Args:
            q: (n,) joint positions.
            p_T: (3,) the point in the tool frame, m.
            place: (2,) in the world, m.
            lowest: height that the tool's origin is to come down to there, m.

        Raises:
            ReachError: beyond its reach.
        """
        X_WT = self.pose(q)
        turn = self._azimuth(place) - self._azimuth(
            X_WT[:3, :3] @ p_T + X_WT[:3, 3]
        )
        found: list[tuple[float, np.ndarray]] = []
        ways: list[tuple[float, np.ndarray]] = []
        for more, full in itertools.product(_TURNS, _ROUNDS):
            angle = turn + full + more
            X = np.array(X_WT)
            X[:3, :3] = _about_vertical(angle) @ X_WT[:3, :3]
            X[:2, 3] = place - (X[:3, :3] @ p_T)[:2]
            if self._can_turn(q, angle):
                ways.append((angle, X))
        for angle, X in ways:
            knots = self._turned(q, X, angle)
            if knots is None or not self._is_clear(knots):
                continue
            there = knots[-1]
            down = self.pose(self.at_height(there, lowest))[2, 3]
            if down < lowest + _NEAR_ENOUGH:
                return there
            found.append((down, there))
        if found:
            return min(found, key=lambda item: round(item[0], _DIGITS))[1]
        for _, X in ways:
            for there in self._configurations(X, q):
                if self._is_clear(self._swing(q, there)):
                    return there
        at = ", ".join(f"{x:.2f}" for x in place)
        raise ReachError(f"out of the arm's reach: to carry it over ({at}) m")

    def force(self, tracking: Tracking) -> np.ndarray:
        """Returns the (3,) force that the tool presses with, N.

        What the drives exert without what it takes to accelerate the arm.
        """
        q, v = tracking.q, tracking.v
        torque = tracking.effort(self.limits) - self.cell.inertial_torque(
            q, v, tracking.a_desired
        )
        J = self.cell.jacobian(q)
        J[:3] *= _LEVER
        # Where the arm is stretched it does not feel the force along it.
        wrench, *_ = np.linalg.lstsq(J.T, torque, rcond=_FEELING)
        return wrench[3:]

    def path(
        self,
        start: np.ndarray,
        legs: Sequence[Leg],
        begin: float,
        *,
        acceleration: float = 11.0,
    ) -> Path:
        """Returns a path from rest to rest along legs, resting between them.

        Raises:
            ReachError: it cannot go along a straight leg.
        """
        curves = []
        for leg in legs:
            way = self._swing if leg.free else self._line
            knots = way(start, leg.end)
            curve = timed_curve(
                knots,
                np.array([self.pose(q)[:3, 3] for q in knots]),
                begin,
                speed=leg.speed,
                tool_acceleration=acceleration,
                limits=self.limits,
            )
            curves.append(curve)
            start, begin = leg.end, curve.end_time()
        return Path(CompositeTrajectory(curves))

    # One pose.

    def _configurations(
        self, X_WT: np.ndarray, near: np.ndarray
    ) -> Iterator[np.ndarray]:
        """Yields joint positions at a pose, clear of all else."""
        found: list[np.ndarray] = []
        lower, upper = 0.7 * self.limits.lower, 0.7 * self.limits.upper
        seeds = np.random.default_rng(0).uniform(
            lower, upper, (_SEEDS, len(lower))
        )
        for seed in (self._facing(near, X_WT), self._model.ready, *seeds):
            q = self.cell.reach(X_WT, seed)
            if q is None or any(np.abs(q - p).max() < 0.1 for p in found):
                continue
            found.append(q)
            if self.cell.is_clear(q):
                yield q

    def _facing(self, q: np.ndarray, X_WT: np.ndarray) -> np.ndarray:
        """Returns q with the arm as a whole turned towards a pose."""
        turns = self._turns(self._azimuth(self.pose(q)[:3, 3]), X_WT, q)
        if not turns:
            return q
        q = np.array(q)
        q[0] += self._sign * turns[0]
        return q

    # Ways.

    def _track(
        self,
        q: np.ndarray,
        poses: Sequence[np.ndarray],
        guess: Callable[[int, np.ndarray], np.ndarray] = lambda number, q: q,
        *,
        centred: bool = True,
        clear: bool = False,
    ) -> list[np.ndarray]:
        """Returns q and joint positions at poses, as far as it comes.

        Args:
            q: (n,) joint positions where it begins.
            poses: 4×4 X_WT, near one another.
            guess: returns where the search for the joint positions at a pose
                begins, of its number and the joint positions before.
            centred: towards the middle of the joints' limits.
            clear: only joint positions that are clear of all else.
        """
        found = [q]
        for number, X_WT in enumerate(poses):
            guessed = guess(number, q)
            nearest = self.cell.reach(X_WT, guessed, centred=centred)
            if nearest is None or np.abs(nearest - q).max() > _JUMP:
                break
            if clear and not self.cell.is_clear(nearest):
                break
            q = nearest
            found.append(q)
        return found

    def _straight_on(self, q: np.ndarray, X_WT: np.ndarray) -> np.ndarray:
        """Returns joint positions straight on, at a pose or on the way."""
        return self._track(q, _straight(self.pose(q), X_WT)[1:], clear=True)[-1]

    def _line(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Returns joint positions (m, n) along a straight way.

        Raises:
            ReachError: there is none.
        """
        poses = _straight(self.pose(start), self.pose(end))[1:-1]
        between = np.linspace(start, end, len(poses) + 2)
        knots = self._track(
            start, poses, lambda number, q: between[number + 1], centred=False
        )
        short = len(knots) <= len(poses)
        if short or np.abs(end - knots[-1]).max() > _JUMP:
            raise ReachError("out of the arm's reach: no straight way")
        return np.array([*knots, end])

    def _swing(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Returns joint positions (m, n) along a way about axis 1.

        The arm turns as a whole, and draws the tool in or puts it out
        meanwhile, so that what hangs on it stays level; whatever else is
        different at the end changes evenly. Of the two ways round it is one
        that is clear, if there is; where there is neither, the joints go
        straight.
        """
        ways = []
        X_0, X_1 = self.pose(start), self.pose(end)
        turns = self._turns(self._azimuth(X_0[:3, 3]), X_1, start)
        for turn in _nearest_first(turns, self._sign * (end[0] - start[0])):
            knots = self._turned(start, X_1, turn)
            if knots is None:
                continue
            share = np.linspace(0, 1, len(knots))
            blend = share**2 * (3 - 2 * share)
            knots = knots + np.outer(blend, end - knots[-1])
            if self._is_clear(knots):
                return knots
            ways.append(knots)
        if ways:
            return ways[0]
        number = max(int(np.ceil(np.abs(end - start).max() / _TURN)), 4)
        return np.linspace(start, end, number + 1)

    def _turns(
        self, azimuth: float, X_WT: np.ndarray, q: np.ndarray
    ) -> list[float]:
        """Returns angles that axis 1 can turn by, to a pose, rad.

        Args:
            azimuth: where the tool is, rad.
            X_WT: 4×4, where it is to be.
            q: (n,) joint positions.
        """
        turn = self._azimuth(X_WT[:3, 3]) - azimuth
        turn = (turn + np.pi) % (2 * np.pi) - np.pi
        both = _nearest_first((turn, turn - np.sign(turn) * 2 * np.pi), 0.0)
        return [angle for angle in both if self._can_turn(q, angle)]

    def _can_turn(self, q: np.ndarray, angle: float) -> bool:
        """Says whether axis 1 can turn the arm by an angle, rad."""
        lower, upper = self.limits.lower[0], self.limits.upper[0]
        return bool(lower < q[0] + self._sign * angle < upper)

    def _turned(
        self, start: np.ndarray, X_WT: np.ndarray, turn: float
    ) -> np.ndarray | None:
        """Returns joint positions (m, n) to where a pose is, or None.

        Args:
            start: (n,) joint positions.
            X_WT: 4×4; the tool comes to its origin, its orientation is that
                at the start, turned about the vertical.
            turn: the angle, rad.
        """
        X_0, axis = self.pose(start), self._axis
        out = X_0[:2, 3] - axis
        # What is missing when the arm has turned as a whole, seen from it.
        rest = _about_vertical(-turn)[:2, :2] @ (X_WT[:2, 3] - axis) - out
        rise = X_WT[2, 3] - X_0[2, 3]
        way = max(abs(turn) / _TURN, np.hypot(*rest) / _STEP, abs(rise) / _STEP)
        number = max(int(np.ceil(way)), 4)
        poses = []
        for share in np.linspace(0, 1, number + 1)[1:]:
            R = _about_vertical(share * turn)
            at = out + share * rest
            radius = np.hypot(*at)
            drawn = np.clip(radius, *self._model.turning_radius)
            bend = min(abs(turn) / np.pi * 16 * (share - share**2) ** 2, 1.0)
            at = at * (1 + bend * (drawn / radius - 1))
            X = np.array(X_0)
            X[:2, 3] = axis + R[:2, :2] @ at
            X[2, 3] += share * rise
            X[:3, :3] = R @ X_0[:3, :3]
            poses.append(X)
        turned = np.zeros(len(start))
        turned[0] = self._sign * turn / number
        knots = self._track(start, poses, lambda _, q: q + turned)
        return np.array(knots) if len(knots) > len(poses) else None

    def _azimuth(self, p_W: np.ndarray) -> float:
        """Returns where a point is, seen from axis 1, rad."""
        out = p_W[:2] - self._axis
        return float(np.arctan2(out[1], out[0]))

    def _is_clear(self, knots: np.ndarray) -> bool:
        return all(self.cell.is_clear(q) for q in knots)


def _straight(start: np.ndarray, end: np.ndarray) -> list[np.ndarray]:
    """Returns poses on a straight way, the ends too, in small steps."""
    X_0, X_1 = RigidTransform(start), RigidTransform(end)
    turn = abs(
        (X_1.rotation().inverse() @ X_0.rotation()).ToAngleAxis().angle()
    )
    way = np.linalg.norm(X_1.translation() - X_0.translation())
    number = max(int(np.ceil(max(way / _STEP, turn / _TURN) - 1e-6)), 1)
    line = PiecewisePose.MakeLinear([0.0, 1.0], [X_0, X_1])
    shares = np.linspace(0, 1, number + 1)
    return [line.GetPose(share).GetAsMatrix4() for share in shares]


def _nearest_first(angles: Sequence[float], wanted: float) -> list[float]:
    """Orders angles by distance from one, rad; of equals the lower first."""
    return sorted(angles, key=lambda a: (round(abs(a - wanted), _DIGITS), a))


def _about_vertical(angle: float) -> np.ndarray:
    return RotationMatrix.MakeZRotation(angle).matrix()
