"""How much weight a grasp can hold: quasi-static wrench resistance.

The question is always the same: which is the largest force u in the direction
of gravity, acting at the object's centre of mass, that the contacts can
balance? The object is held if its weight is smaller.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.solvers import ClpSolver, MathematicalProgram

from xray_drake.cell.gripper import GripperSpec

CONE_EDGES = 8
"""Edges of the linearised friction cone."""

_LENGTH = 0.02
"""Torques are divided by it, m, so that the rows of the program compare."""


@dataclass(frozen=True, eq=False)
class PadContact:
    """A soft-finger contact of one pad.

    Attributes:
        point: (3,) in any common frame, m.
        normal: (3,) unit normal into the object.
        torsion_radius: torque about the normal per friction force, m: 2/3 of
            the radius of a disc under uniform pressure.
    """

    point: np.ndarray
    normal: np.ndarray
    torsion_radius: float


def soft_finger_wrenches(
    contact: PadContact,
    tangent: np.ndarray,
    center: np.ndarray,
    *,
    friction: float,
) -> np.ndarray:
    """Returns the generators of a soft finger's wrench cone.

    They have unit normal force. Their convex hull is the inside of
    ‖f_t‖ / μ + |τ_n| / (μ b) ≤ f_n (Prattichizzo & Trinkle 2008, soft finger)
    with the friction circle replaced by an octagon inscribed in it.

    Args:
        contact: where, and how large.
        tangent: (3,) the direction of the octagon's first corner is its
            projection on the tangent plane.
        center: (3,) about which torques are taken, m.
        friction: Coulomb coefficient μ.

    Returns:
        (6, CONE_EDGES + 2) of force over torque, N and N·m.
    """
    normal = contact.normal
    first = tangent - (tangent @ normal) * normal
    first = first / np.linalg.norm(first)
    second = np.cross(normal, first)
    angle = 2 * np.pi * np.arange(CONE_EDGES) / CONE_EDGES
    friction_forces = friction * (
        np.outer(first, np.cos(angle)) + np.outer(second, np.sin(angle))
    )
    force = normal[:, None] + np.hstack([friction_forces, np.zeros((3, 2))])
    torque = np.cross(contact.point - center, force, axisb=0, axisc=0)
    twist = friction * contact.torsion_radius
    torque[:, CONE_EDGES:] += np.outer(normal, [twist, -twist])
    return np.vstack([force, torque])


def jaw_holding_force(
    contacts: tuple[PadContact, PadContact],
    center_of_mass: np.ndarray,
    gravity: np.ndarray,
    *,
    friction: float,
    force: float,
) -> float:
    """Returns the largest weight that two pads can hold, N; 0 for none.

    A linear program: maximise u subject to Σ G_i α_i + u ĝ = 0 and, at each
    pad, Σ α_i ≤ force (Prattichizzo & Trinkle 2008, grasp restraint with
    limited contact forces; Mahler et al., Dex-Net 2.0, uses the same test).

    Args:
        contacts: of the two pads, in any common frame.
        center_of_mass: (3,) of the object, m.
        gravity: (3,) unit vector in the direction of the weight.
        friction: Coulomb coefficient.
        force: largest normal force at each pad, N.
    """
    G = []
    for contact in contacts:
        along = gravity - (gravity @ contact.normal) * contact.normal
        if np.linalg.norm(along) < 1e-6:
            along = np.eye(3)[np.argmin(np.abs(contact.normal))]
        G.append(
            soft_finger_wrenches(
                contact, along, center_of_mass, friction=friction
            )
        )
    n = G[0].shape[1]
    A = np.zeros((8, 2 * n + 1))
    A[:6, :n], A[:6, n : 2 * n] = G
    A[3:6] /= _LENGTH
    A[:3, 2 * n] = gravity
    A[6, :n] = 1.0
    A[7, n : 2 * n] = 1.0
    lower: Any = np.zeros(8)
    upper: Any = np.array([0.0] * 6 + [force, force])

    program = MathematicalProgram()
    x = program.NewContinuousVariables(2 * n + 1, "x")
    program.AddBoundingBoxConstraint(0.0, np.inf, x)
    program.AddLinearConstraint(A=A, lb=lower, ub=upper, vars=x)
    program.AddLinearCost(np.eye(2 * n + 1)[2 * n] * -1.0, 0.0, x)
    result = ClpSolver().Solve(program)
    if not result.is_success():
        return 0.0
    return max(0.0, float(result.GetSolution(x)[2 * n]))


def suction_holding_force(
    lever: np.ndarray,
    gravity: np.ndarray,
    gripper: GripperSpec,
    friction: np.ndarray | float,
) -> np.ndarray:
    """Returns the largest weight that a sealed cup can hold, N; 0 for none.

    The compliant ring of Dex-Net 3.0 (Mahler et al. 2018, suction contact
    model). With vacuum force V and weight u, the lip is pressed on with
    f_N = V − u T, T the part of the weight along the cup's axis, and

        √3 |f_x|, √3 |f_y| ≤ μ f_N,   √3 |τ_z| ≤ r μ f_N    (friction)
        √2 |τ_x|, √2 |τ_y| ≤ π r κ                          (elastic lip)
        f_N ≥ 0                                             (vacuum)

    All are linear in u, so the answer is the smallest of seven quotients.

    Args:
        lever: (..., 3) centre of mass minus centre of the lip, in the contact
            frame (z along the approach, into the object), m.
        gravity: (..., 3) unit direction of the weight in the contact frame.
        gripper: its V, r and κ.
        friction: (...) Coulomb coefficient μ.

    Returns:
        (...) array.
    """
    lever = np.asarray(lever, dtype=float)
    gravity = np.asarray(gravity, dtype=float)
    pull = gravity[..., 2]
    torque = np.abs(np.cross(lever, gravity))
    sliding = np.abs(gravity)
    root2, root3 = np.sqrt(2.0), np.sqrt(3.0)
    vacuum_force, r = gripper.vacuum_force, gripper.cup_radius
    grip, lip = friction * vacuum_force, np.pi * r * gripper.cup_elasticity
    need = np.stack(
        [
            pull / vacuum_force,
            (root3 * sliding[..., 0] + friction * pull) / grip,
            (root3 * sliding[..., 1] + friction * pull) / grip,
            (root3 * torque[..., 2] / r + friction * pull) / grip,
            root2 * torque[..., 0] / lip,
            root2 * torque[..., 1] / lip,
        ],
        axis=-1,
    ).max(axis=-1)
    return 1.0 / np.maximum(need, 1e-9)


def holding_quality(
    holding_force: np.ndarray | float, weight: float
) -> np.ndarray:
    """Returns (...) 1 − weight / holding force, clipped to [0, 1].

    Zero where the grasp cannot hold the weight, ½ where it could hold twice
    the weight.

    Args:
        holding_force: (...) largest weight the grasp can hold, N.
        weight: of the object, N.
    """
    force = np.asarray(holding_force, float)
    held = force > max(weight, 0.0)
    return np.where(held, 1.0 - weight / np.where(held, force, 1.0), 0.0)
