"""Joint positions and paths of the YuMi-like arm."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from pydrake.trajectories import CompositeTrajectory
from scipy.spatial.transform import Rotation

from xray_drake.gripper.carriers.arm_cell import MOUNT, ArmCell
from xray_drake.gripper.carriers.carrier import ReachError, Tracking
from xray_drake.gripper.carriers.paths import Leg, Path, timed_curve
from xray_drake.messages import Message

READY = np.deg2rad([0.0, -60.0, 0.0, 10.0, 0.0, 60.0, 0.0])
"""Somewhere in the middle of the arm's reach."""

_HOME = np.deg2rad([103.0, -108.0, -111.0, 53.0, 63.0, 88.0, -69.0])
_HOME_PLACE = (0.52, 0.0)
"""At home the tool points down over the tote, out of the camera's view: near
these joint positions, and there along x and y, m."""

_SEEDS = 12
"""Joint positions that inverse kinematics begins at."""

_CHAINS = 3
"""Ways to be at a pose and to go on that it chooses from."""

_STEP = 0.02
_TURN = 0.1
"""Ways are followed in steps of this much at most, m and rad."""

_JUMP = 0.5
"""No joint turns further in one of them, rad."""

_LEVER = 0.3
"""A rotation by 1 rad counts as much as this many metres."""

_TOLERANCE = 1e-7
_ITERATIONS = 20
_DAMPING = 1e-6
_LONGEST = 0.4
"""Of Newton's method: error that ends it, m; steps, damping; step, rad."""

_CENTRING = 0.25
"""How strongly joints are drawn away from their limits, rad."""

_TURNS = np.deg2rad([0, 20, -20, 40, -40, 60, -60])
"""The tool is turned by so much more than the arm, tried in this order."""

_TURNING_RADIUS = (0.22, 0.34)
"""So near axis 1 is the tool while the arm turns, to pass base and posts, m."""

_FEELING = 0.03
"""Of the Jacobian, singular values below this share of the largest tell
nothing of the force."""

_HEADROOM = 0.18
"""The tool stays so far below the base, where the arm has room to fold, m."""

_DIGITS = 6
"""Ways are compared after so many decimals, that rounding decides nothing."""

_NEAR_ENOUGH = 0.01
"""What is released this much higher than wanted is set down, too, m."""

_Draw = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Arm(Message):
    """Seven turning joints; the tool frame T is at the flange.

    An arm with seven joints can be at a pose in many ways. Inverse kinematics
    (:meth:`~xray_drake.gripper.carriers.arm_cell.ArmCell.solve`) finds some
    that are far from the joints' limits; from there a straight way is followed
    in small steps, each made exact by Newton's method, which leaves one way to
    turn the elbow: away from the limits again.

    Attributes:
        cell: the arm's model.
        tool_acceleration: the tool's origin accelerates no more, m/s².
    """

    cell: ArmCell
    tool_acceleration: float = 11.0

    @property
    def name(self) -> str:
        """What messages call it."""
        return "arm"

    @property
    def stiffness(self) -> np.ndarray:
        """The (7,) stiffness of the position control, N·m/rad."""
        return self.cell.stiffness

    @property
    def highest(self) -> float:
        """The tool's origin is carried about no higher than this, m."""
        return float(MOUNT[2, 3]) - _HEADROOM

    @property
    def velocity(self) -> np.ndarray:
        """The (7,) highest speeds, rad/s."""
        return self.cell.velocity

    @property
    def acceleration(self) -> np.ndarray:
        """The (7,) highest accelerations, rad/s²."""
        return self.cell.acceleration

    @cached_property
    def home(self) -> np.ndarray:
        """The (7,) joint positions in which the arm waits."""
        X_WT = np.diag([1.0, -1.0, -1.0, 1.0])
        X_WT[:3, 3] = *_HOME_PLACE, self.highest
        q = self._newton(X_WT, _HOME)
        if q is None:
            raise ReachError("the arm cannot be at home")
        return q

    def pose(self, q: np.ndarray) -> np.ndarray:
        """Returns the 4×4 pose X_WT at joint positions (7,)."""
        return self.cell.pose(q)

    def joints(self, X_WT: np.ndarray, *, near: np.ndarray) -> np.ndarray:
        """Returns joint positions (7,) at a pose; of several those near others.

        Raises:
            ReachError: none were found.
        """
        return self.along([X_WT], near=near)[0]

    def along(
        self, poses: Sequence[np.ndarray], *, near: np.ndarray
    ) -> list[np.ndarray]:
        """Returns joint positions at poses that a straight way leads through.

        Raises:
            ReachError: it cannot be at one of them, or not go straight.
        """
        chains: list[list[np.ndarray]] = []
        reached = False
        for q in self._configurations(poses[0], near):
            reached = True
            chain = self._chain(q, poses[1:])
            if chain is not None:
                chains.append(chain)
            if len(chains) == _CHAINS:
                break
        if chains:
            return min(
                chains, key=lambda c: round(self._turning(near, c[-1]), _DIGITS)
            )
        p = ", ".join(f"{x:.2f}" for x in poses[0][:3, 3])
        if not reached:
            raise ReachError(f"out of the arm's reach: tool at ({p}) m")
        raise ReachError(
            f"out of the arm's reach: straight on from the tool at ({p}) m"
        )

    def _turning(self, start: np.ndarray, end: np.ndarray) -> float:
        """Returns how far joints turn, beside the arm as a whole, rad."""
        facing = self._facing(start, self.pose(end))
        return float(np.abs(end - facing).max())

    def _chain(
        self, q: np.ndarray, poses: Sequence[np.ndarray]
    ) -> list[np.ndarray] | None:
        """Returns q and joint positions at poses straight on, or None."""
        found = [q]
        for X_WT in poses:
            way = self._follow(found[-1], X_WT)
            if way is None:
                return None
            found.append(way[-1])
        return found

    def at_height(self, q: np.ndarray, height: float) -> np.ndarray:
        """Returns q with the tool straight above or below, at a height (m).

        Where the tool cannot go as far, it goes as far as it can.
        """
        X_WT = self.pose(q)
        rise = height - X_WT[2, 3]
        for _ in range(int(np.ceil(abs(rise) / _STEP))):
            X_WT[2, 3] += np.clip(height - X_WT[2, 3], -_STEP, _STEP)
            way = self._follow(q, X_WT)
            if way is None:
                break
            q = way[-1]
        return q

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
            q: (7,) joint positions.
            p_T: (3,) the point in the tool frame, m.
            place: (2,) in the world, m.
            lowest: height that the tool's origin is to come down to there, m.

        Raises:
            ReachError: beyond its reach.
        """
        X_WT = self.pose(q)
        found: list[tuple[float, np.ndarray]] = []
        turns = self._turns_over(X_WT, p_T, q, place)
        for turn in turns:
            X = self._moved_over(X_WT, p_T, place, turn)
            knots = self._turned(q, X, turn)
            if knots is None or not self._is_clear(knots):
                continue
            there = knots[-1]
            down = self.pose(self.at_height(there, lowest))[2, 3]
            if down < lowest + _NEAR_ENOUGH:
                return there
            found.append((down, there))
        for turn in () if found else turns:
            X = self._moved_over(X_WT, p_T, place, turn)
            try:
                there = self.joints(X, near=q)
            except ReachError:
                continue
            if self._is_clear(self._swing(q, there)):
                return there
        if found:
            return min(found, key=lambda item: round(item[0], _DIGITS))[1]
        at = ", ".join(f"{x:.2f}" for x in place)
        raise ReachError(f"out of the arm's reach: to carry it over ({at}) m")

    def _moved_over(
        self,
        X_WT: np.ndarray,
        p_T: np.ndarray,
        place: np.ndarray,
        turn: float,
    ) -> np.ndarray:
        """Returns X_WT turned, with a point of the tool over a place."""
        X = np.array(X_WT)
        X[:3, :3] = _about_vertical(turn) @ X_WT[:3, :3]
        X[:2, 3] = place - (X[:3, :3] @ p_T)[:2]
        return X

    def _turns_over(
        self,
        X_WT: np.ndarray,
        p_T: np.ndarray,
        q: np.ndarray,
        place: np.ndarray,
    ) -> list[float]:
        """Returns angles to turn the tool by on its way to a place, rad."""
        turn = _azimuth(place) - _azimuth(X_WT[:3, :3] @ p_T + X_WT[:3, 3])
        return [
            turn + full + more
            for more in _TURNS
            for full in (0.0, 2 * np.pi, -2 * np.pi)
            if self.cell.lower[0] < q[0] - turn - full - more
            and q[0] - turn - full - more < self.cell.upper[0]
        ]

    def force(self, tracking: Tracking) -> np.ndarray:
        """Returns the (3,) force that the tool presses with, N.

        What the drives exert without what it takes to accelerate the arm.
        """
        cell = self.cell
        q, v = tracking.q, tracking.v
        torque = cell.stiffness * (tracking.q_desired - q) + cell.damping * (
            tracking.v_desired - v
        )
        torque = torque - cell.inertial_torque(q, v, tracking.a_desired)
        J = cell.jacobian(q)
        J[:3] *= _LEVER
        # Where the arm is stretched it does not feel the force along it.
        wrench, *_ = np.linalg.lstsq(J.T, torque, rcond=_FEELING)
        return wrench[3:]

    def path(
        self, start: np.ndarray, legs: Sequence[Leg], begin: float
    ) -> Path:
        """Returns a path from rest to rest along legs, resting between them.

        Raises:
            ReachError: it cannot go along a straight leg.
        """
        curves = []
        for leg in legs:
            if leg.free:
                knots = self._swing(start, leg.end)
            else:
                knots = self._line(start, leg.end)
            curve = timed_curve(
                knots,
                np.array([self.pose(q)[:3, 3] for q in knots]),
                begin,
                speed=leg.speed,
                tool_acceleration=self.tool_acceleration,
                limits=self,
            )
            curves.append(curve)
            start, begin = leg.end, curve.end_time()
        return Path(CompositeTrajectory(curves))

    def slowed(self, acceleration: float) -> "Arm":
        """Returns one whose tool's origin accelerates no more, m/s²."""
        return replace(
            self,
            tool_acceleration=min(self.tool_acceleration, acceleration),
        )

    # One pose.

    @cached_property
    def _seeds(self) -> np.ndarray:
        cell = self.cell
        rng = np.random.default_rng(0)
        return rng.uniform(0.7 * cell.lower, 0.7 * cell.upper, (_SEEDS, 7))

    def _configurations(
        self, X_WT: np.ndarray, near: np.ndarray
    ) -> Iterator[np.ndarray]:
        """Yields joint positions at a pose, clear of all else."""
        found: list[np.ndarray] = []
        near = self._facing(near, X_WT)
        for seed in (near, READY, *self._seeds):
            q = self.cell.solve(X_WT, near, seed)
            if q is None:
                continue
            q = self._newton(X_WT, q)
            if q is None or any(np.abs(q - p).max() < 0.1 for p in found):
                continue
            found.append(q)
            if self.cell.is_clear(q):
                yield q

    def _facing(self, q: np.ndarray, X_WT: np.ndarray) -> np.ndarray:
        """Returns q with the arm as a whole turned towards a pose."""
        turns = self._turns(_azimuth(self.pose(q)[:3, 3]), X_WT, q)
        if not turns:
            return q
        q = np.array(q)
        q[0] -= turns[0]
        return q

    def _newton(
        self, X_WT: np.ndarray, q: np.ndarray, draw: _Draw | None = None
    ) -> np.ndarray | None:
        """Returns joint positions near q exactly at a pose, or None.

        Args:
            X_WT: 4×4, m.
            q: (7,) where to begin.
            draw: says where q is drawn to, as far as the pose leaves it free.
        """
        cell = self.cell
        lower, upper = cell.lower + 1e-6, cell.upper - 1e-6
        for number in range(_ITERATIONS):
            error = _difference(X_WT, cell.pose(q))
            pull = number < 2 and draw is not None
            if not pull and np.abs(error).max() < _TOLERANCE:
                return q
            J = cell.jacobian(q)
            J[:3] *= _LEVER
            step = draw(q) if pull and draw is not None else np.zeros(7)
            A = J @ J.T + _DAMPING * np.eye(6)
            step = step + J.T @ np.linalg.solve(A, error - J @ step)
            step *= min(1.0, _LONGEST / max(np.abs(step).max(), 1e-12))
            q = np.clip(q + step, lower, upper)
        return None

    def _to_middle(self, q: np.ndarray) -> np.ndarray:
        """Returns a step (7,) away from the joints' limits."""
        cell = self.cell
        half = (cell.upper - cell.lower) / 2
        out = (q - (cell.upper + cell.lower) / 2) / half
        return -_CENTRING * out**3 / half

    # Ways.

    def _follow(
        self, q: np.ndarray, X_WT: np.ndarray
    ) -> list[np.ndarray] | None:
        """Returns joint positions along a straight way to a pose, or None."""
        start = self.pose(q)
        found = []
        for share in _shares(start, X_WT)[1:]:
            nearest = self._newton(
                _between(start, X_WT, share), q, self._to_middle
            )
            if (
                nearest is None
                or np.abs(nearest - q).max() > _JUMP
                or not self.cell.is_clear(nearest)
            ):
                return None
            q = nearest
            found.append(q)
        return found or [q]

    def _line(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Returns joint positions (n, 7) along a straight way.

        Raises:
            ReachError: there is none.
        """
        X_0, X_1 = self.pose(start), self.pose(end)
        shares = _shares(X_0, X_1)
        knots = self._along(start, end, [_between(X_0, X_1, s) for s in shares])
        if knots is None:
            raise ReachError("out of the arm's reach: no straight way")
        return knots

    def _swing(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Returns joint positions (n, 7) along a way about axis 1.

        The arm turns as a whole, and draws the tool in or puts it out
        meanwhile, so that what hangs on it stays level; whatever else is
        different at the end changes evenly. Of the two ways round it is one
        that is clear, if there is; where there is neither, the joints go
        straight.
        """
        ways = []
        X_0, X_1 = self.pose(start), self.pose(end)
        turns = self._turns(_azimuth(X_0[:3, 3]), X_1, start)
        for turn in _nearest_first(turns, start[0] - end[0]):
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
            q: (7,) joint positions.
        """
        turn = _azimuth(X_WT[:3, 3]) - azimuth
        turn = (turn + np.pi) % (2 * np.pi) - np.pi
        both = _nearest_first((turn, turn - np.sign(turn) * 2 * np.pi), 0.0)
        # Axis 1 points down.
        return [
            angle
            for angle in both
            if self.cell.lower[0] < q[0] - angle < self.cell.upper[0]
        ]

    def _turned(
        self, start: np.ndarray, X_WT: np.ndarray, turn: float
    ) -> np.ndarray | None:
        """Returns joint positions (n, 7) to where a pose is, or None.

        Args:
            start: (7,) joint positions.
            X_WT: 4×4; the tool comes to its origin, its orientation is that
                at the start, turned about the vertical.
            turn: the angle, rad.
        """
        X_0, axis = self.pose(start), MOUNT[:2, 3]
        out = X_0[:2, 3] - axis
        # What is missing when the arm has turned as a whole, seen from it.
        rest = _about_vertical(-turn)[:2, :2] @ (X_WT[:2, 3] - axis) - out
        rise = X_WT[2, 3] - X_0[2, 3]
        way = max(abs(turn) / _TURN, np.hypot(*rest) / _STEP, abs(rise) / _STEP)
        number = max(int(np.ceil(way)), 4)
        knots, q = [start], start
        for share in np.linspace(0, 1, number + 1)[1:]:
            R = _about_vertical(share * turn)
            at = out + share * rest
            radius = np.hypot(*at)
            drawn = np.clip(radius, *_TURNING_RADIUS)
            bend = min(abs(turn) / np.pi * 16 * (share - share**2) ** 2, 1.0)
            at = at * (1 + bend * (drawn / radius - 1))
            X = np.array(X_0)
            X[:2, 3] = axis + R[:2, :2] @ at
            X[2, 3] += share * rise
            X[:3, :3] = R @ X_0[:3, :3]
            guess = np.array(q)
            guess[0] -= turn / number
            nearest = self._newton(X, guess, self._to_middle)
            if nearest is None or np.abs(nearest - q).max() > _JUMP:
                return None
            q = nearest
            knots.append(q)
        return np.array(knots)

    def _is_clear(self, knots: np.ndarray) -> bool:
        return all(self.cell.is_clear(q) for q in knots)

    def _along(
        self,
        start: np.ndarray,
        end: np.ndarray,
        poses: Sequence[np.ndarray],
    ) -> np.ndarray | None:
        """Returns joint positions at poses, from start to end, or None."""
        shares = np.linspace(0, 1, len(poses))
        q, knots = start, [start]
        for share, X_WT in zip(shares[1:-1], poses[1:-1], strict=True):
            wanted = (1 - share) * start + share * end
            nearest = self._newton(X_WT, wanted)
            if nearest is None or np.abs(nearest - q).max() > _JUMP:
                return None
            q = nearest
            knots.append(q)
        if np.abs(end - q).max() > _JUMP:
            return None
        return np.array([*knots, end])


def _difference(X_WT: np.ndarray, X_WQ: np.ndarray) -> np.ndarray:
    """Returns (6,) from a pose Q to T: turn times the lever, way, m."""
    turn = Rotation.from_matrix(X_WT[:3, :3] @ X_WQ[:3, :3].T).as_rotvec()
    return np.concatenate([_LEVER * turn, X_WT[:3, 3] - X_WQ[:3, 3]])


def _shares(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Returns shares of a straight way, from 0 to 1, in small steps."""
    difference = _difference(end, start)
    turn = np.linalg.norm(difference[:3]) / _LEVER
    way = np.linalg.norm(difference[3:])
    number = max(int(np.ceil(max(way / _STEP, turn / _TURN) - 1e-6)), 1)
    return np.linspace(0, 1, number + 1)


def _between(start: np.ndarray, end: np.ndarray, share: float) -> np.ndarray:
    """Returns a pose on the straight way from one to another."""
    turn = Rotation.from_matrix(end[:3, :3] @ start[:3, :3].T).as_rotvec()
    pose = np.array(start)
    pose[:3, 3] += share * (end[:3, 3] - start[:3, 3])
    pose[:3, :3] = (
        Rotation.from_rotvec(share * turn).as_matrix() @ start[:3, :3]
    )
    return pose


def _nearest_first(angles: Sequence[float], wanted: float) -> list[float]:
    """Orders angles by distance from one, rad; of equals the lower first."""
    return sorted(angles, key=lambda a: (round(abs(a - wanted), _DIGITS), a))


def _about_vertical(angle: float) -> np.ndarray:
    return Rotation.from_rotvec([0, 0, angle]).as_matrix()


def _azimuth(p_W: np.ndarray) -> float:
    """Returns where a point is, seen from axis 1, rad."""
    out = p_W[:2] - MOUNT[:2, 3]
    return float(np.arctan2(out[1], out[0]))
