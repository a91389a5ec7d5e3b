"""The law of a suction cup: when it seals, what it holds, when it lets go."""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from xray_drake.cell.gripper import GripperSpec, load_gripper
from xray_drake.configuration import number
from xray_drake.messages import Message


@dataclass
class SuctionConfig:
    """What a suction cup is like, beyond what planning knows of it."""

    # The vacuum draws the lip to a surface that is this near, m.
    reach: float = number(0.001, "[0, 0.1]")
    # s. The vacuum approaches its end within this time: an ejector that
    # draws 8 l/min (what Schmalz recommends for cups up to 60 mm) empties the
    # 3 ml of cup and hose two times over.
    evacuation_time: float = number(0.05, "(0, 10]")
    # s. Air that enters for so long ends the seal; a shorter jerk does not.
    leak_time: float = number(0.05, "[0, 10]")
    # s. The cup's damping over its stiffness.
    damping_time: float = number(0.01, "[0, 1]")


@dataclass(frozen=True, eq=False)
class Cup:
    """A compliant ring that a vacuum presses on a surface.

    Wrenches are (6,), torque (N·m) over force (N), as in Drake. They are what
    the cup exerts on the object, at the centre of the lip, in the cup frame C
    (z out of the cup, into the object). Deflections are (6,) alike, rotation
    vector (rad) over translation (m).

    Attributes:
        gripper: what planning knows of it, too.
        config: the rest.
    """

    gripper: GripperSpec = field(default_factory=load_gripper)
    config: SuctionConfig = field(default_factory=SuctionConfig)

    @property
    def stiffness(self) -> np.ndarray:
        """The (6,) diagonal of the stiffness K, N·m/rad and N/m.

        The full vacuum stretches the bellows by its whole travel, and
        sideways it is as stiff. A ring of springs of that stiffness k in all
        resists a tilt by k r²/2 and a twist by k r².
        """
        p = self.gripper
        k = p.vacuum_force / (2 * p.bellows_travel)
        tilt = 0.5 * k * p.cup_radius**2
        return np.array([tilt, tilt, 2 * tilt, k, k, k])

    @property
    def damping(self) -> np.ndarray:
        """The (6,) diagonal of the damping C, N·m·s and N·s/m."""
        return self.config.damping_time * self.stiffness

    def load(self, wrench: np.ndarray, vacuum: float = 1.0) -> float:
        """Returns a wrench as a share of what it can bear; above 1 it fails.

        Dex-Net 3.0's suction contact model (Mahler et al. 2018) before its
        linearisation. With the vacuum force V and the pull p that the object
        exerts along the axis, the lip is pressed on with f_N = V − p, and

            √(f_x² + f_y² + (τ_z / r)²) ≤ μ f_N    (friction)
            √(τ_x² + τ_y²) ≤ π r κ                 (elastic lip)

        That is a convex set around 0, and this is its gauge: a wrench λ times
        as large has a load λ times as large.

        Args:
            wrench: (6,).
            vacuum: reached by now, as a share of ``vacuum_force``.
        """
        torque, force, p = wrench[:3], wrench[3:], self.gripper
        slide = np.hypot(np.hypot(force[0], force[1]), torque[2] / p.cup_radius)
        grip = slide / p.friction - force[2]
        bend = np.hypot(torque[0], torque[1])
        bend /= np.pi * p.cup_radius * p.cup_elasticity
        if grip <= 0.0:
            return float(bend)
        if vacuum <= 0.0:
            return float("inf")
        return float(max(grip / (vacuum * p.vacuum_force), bend))


def point_mobility(
    mass: float, inertia: np.ndarray, lever: np.ndarray
) -> np.ndarray:
    """Returns the (6, 6) accelerations per wrench at a point of a free body.

    Args:
        mass: kg.
        inertia: (3, 3) about the centre of mass, kg·m².
        lever: (3,) from the centre of mass to the point, m, in the same axes.
    """
    x, y, z = lever
    S = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turn = np.linalg.inv(inertia)
    W = np.empty((6, 6))
    W[:3, :3] = turn
    W[:3, 3:] = turn @ S
    W[3:, :3] = -S @ turn
    W[3:, 3:] = np.eye(3) / mass - S @ turn @ S
    return W


def implicit_wrench(
    stiffness: np.ndarray,
    damping: np.ndarray,
    mobility: np.ndarray,
    deflection: np.ndarray,
    velocity: np.ndarray,
    acceleration: np.ndarray,
    step: float,
) -> np.ndarray:
    """Returns the wrench of a spring-damper by backward Euler, (6,).

    It is the wrench that spring and damper have at the end of the step. An
    explicit one throws light bodies, however small the step. With K, C, W, x,
    v and a the arguments in this order,

        (I + (h C + h² K) W) F = −(K (x + h (v + h a)) + C (v + h a)).

    Args:
        stiffness: (6,) diagonal.
        damping: (6,) diagonal.
        mobility: (6, 6) of the body at the spring's end.
        deflection: (6,) of the spring.
        velocity: (6,) of its end.
        acceleration: (6,) that all other forces give its end.
        step: h, s.
    """
    per_velocity = step * stiffness + damping
    coming = velocity + step * acceleration
    system = np.eye(6) + (step * per_velocity)[:, None] * mobility
    return np.linalg.solve(
        system, -(stiffness * deflection + per_velocity * coming)
    )


@dataclass(frozen=True, eq=False)
class CupState(Message):
    """A cup at one instant.

    Attributes:
        object: name of what it is sealed to; empty where it is open.
        X_OC: 4×4 pose of the lip in the object's frame when it sealed.
        drawing: air is drawn.
        vacuum: reached by now, as a share of the full one.
        load: as a share of what the seal can bear, see :meth:`Cup.load`.
        overloaded: for how long it has been more than that, s.
        wrench: (6,) on the object at the lip, in the world.
        velocity: (6,) of the object there, in the world.
        p_BL: (3,) that point in the gripper's frame, m.
        lost: why the last seal ended; empty where it was let go.
        tick: of which of the plant's steps it is; −1 before any.
    """

    object: str = ""
    X_OC: np.ndarray = field(default_factory=lambda: np.eye(4))
    drawing: bool = False
    vacuum: float = 0.0
    load: float = 0.0
    overloaded: float = 0.0
    wrench: np.ndarray = field(default_factory=lambda: np.zeros(6))
    velocity: np.ndarray | None = None
    p_BL: np.ndarray = field(default_factory=lambda: np.zeros(3))
    lost: str = ""
    tick: int = -1

    @property
    def flow(self) -> float:
        """Air that flows, as a share of what the open cup draws."""
        return 1.0 - self.vacuum if self.drawing else 0.0


@dataclass(frozen=True, eq=False)
class HeldBody:
    """The object that a cup holds, and the cup, all in the world.

    Attributes:
        mass: kg.
        inertia: (3, 3) about the centre of mass, kg·m².
        lever: (3,) from the centre of mass to the lip on the object, m.
        R_WC: (3, 3) orientation of the cup.
        deflection: (6,) of the lip on the object against the cup: rotation
            vector, rad, over translation, m.
        velocity: (6,) of the object at the lip, rad/s over m/s.
        cup_velocity: (6,) of the gripper at the same point.
    """

    mass: float
    inertia: np.ndarray
    lever: np.ndarray
    R_WC: np.ndarray
    deflection: np.ndarray
    velocity: np.ndarray
    cup_velocity: np.ndarray


def open_cup(state: CupState, *, suction: bool, lost: str = "") -> CupState:
    """Returns the state of a cup that holds nothing.

    Args:
        state: before.
        suction: air is drawn.
        lost: why the seal ended, if it was lost.
    """
    if not state.object and state.drawing == suction:
        return state
    return CupState(drawing=suction, lost=lost or state.lost)


def hold(cup: Cup, state: CupState, body: HeldBody, step: float) -> CupState:
    """Returns the state of a sealed cup a step later.

    The spring's wrench is that of :func:`implicit_wrench`, cut down to what
    the seal can bear. What else accelerates the body (its weight, contacts) is
    taken to be what did so in the last step: so the wrench on a light body
    that is stuck under others grows to what the spring would have, while that
    on a free one is damped as it should. A load of more than 1 for
    ``leak_time`` ends the seal.

    Args:
        cup: the cup.
        state: sealed.
        body: where the object is now.
        step: s.
    """
    R_CW = body.R_WC.T
    W = point_mobility(
        body.mass, R_CW @ body.inertia @ body.R_WC, R_CW @ body.lever
    )
    acceleration = np.zeros(6)
    if state.velocity is not None:
        change = (body.velocity - state.velocity) / step
        acceleration = turned(R_CW, change) - W @ turned(R_CW, state.wrench)
    deflection = turned(R_CW, body.deflection)
    wrench = implicit_wrench(
        cup.stiffness,
        cup.damping,
        W,
        deflection,
        turned(R_CW, body.velocity - body.cup_velocity),
        acceleration,
        step,
    )
    share = 1.0 - np.exp(-step / cup.config.evacuation_time)
    vacuum = state.vacuum + share * (1.0 - state.vacuum)
    demand = cup.load(wrench, vacuum)
    spring = -cup.stiffness * deflection
    load = max(demand, cup.load(spring, vacuum))
    overloaded = state.overloaded + step if load > 1.0 else 0.0
    if overloaded > cup.config.leak_time:
        worse = wrench if load == demand else spring
        return open_cup(state, suction=True, lost=_why(cup, worse, vacuum))
    return replace(
        state,
        vacuum=vacuum,
        load=load,
        overloaded=overloaded,
        wrench=turned(body.R_WC, wrench / max(demand, 1.0)),
        velocity=body.velocity,
    )


def deflection_of(X_WC: np.ndarray, X_WL: np.ndarray) -> np.ndarray:
    """Returns the (6,) deflection of a lip in the world.

    Args:
        X_WC: 4×4 pose of the cup, where the lip is when it is relaxed.
        X_WL: 4×4 pose of the lip.
    """
    turn = Rotation.from_matrix(X_WL[:3, :3] @ X_WC[:3, :3].T)
    return np.concatenate([turn.as_rotvec(), X_WL[:3, 3] - X_WC[:3, 3]])


def turned(R: np.ndarray, twist: np.ndarray) -> np.ndarray:
    """Returns a (6,) twist or wrench in other axes."""
    return np.concatenate([R @ twist[:3], R @ twist[3:]])


def _why(cup: Cup, wrench: np.ndarray, vacuum: float) -> str:
    pull = np.zeros(6)
    pull[5] = wrench[5]
    slide = np.array([0.0, 0.0, *wrench[2:]])
    loads = {
        "the lip bends off": cup.load(
            np.array([*wrench[:2], 0.0, 0.0, 0.0, 0.0]), vacuum
        ),
        "it slides off": cup.load(slide, vacuum) - cup.load(pull, vacuum),
        "it is pulled off": cup.load(pull, vacuum),
    }
    return max(loads, key=lambda why: loads[why])
