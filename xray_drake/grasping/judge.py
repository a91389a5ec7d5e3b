"""Judges grasps on an object, by whatever it is known."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from xray_drake.grasping.candidates import moved
from xray_drake.grasping.evidence.protocol import Approach, ObjectEvidence
from xray_drake.grasping.judgement import GripperModel, JudgedGrasp, too_weak
from xray_drake.grasping.wrench import holding_quality
from xray_drake.messages import GraspKind


def judge(
    seen: ObjectEvidence,
    gripper: GripperModel,
    kind: GraspKind,
    X_WG: np.ndarray,
    width: np.ndarray,
    friction: np.ndarray,
    *,
    overtravel: float = 0.0,
    stopped: np.ndarray | None = None,
) -> Sequence[JudgedGrasp]:
    """Judges grasps of one kind, quasi-statically.

    The gripper comes along its approach and *stops at contact*, as a guarded
    descent does: where it would go below the floor or into something, it stays
    short of the pose, by up to ``max_retreat``. The jaw then closes until both
    pads touch; or the cup meets the surface, its bellows taking up
    ±``bellows_travel``, and seals or not. The contacts must then resist the
    object's weight.

    Quality is 1 − weight / largest weight that can be held, times factors in
    [½, 1] for what it depends on in execution: alignment of the contact normals
    with the closing axis and share of the pad that touches, or evenness under
    the lip.

    Args:
        seen: what is known of the object and of what is around it.
        gripper: what it can do.
        kind: jaw or suction.
        X_WG: (n, 4, 4) poses of the grasp frame.
        width: (n,) distances of the contacts as planned, m; 0 for suction.
        friction: (n,) Coulomb coefficients between gripper and object.
        overtravel: how far beyond X_WG the gripper is commanded, m.
        stopped: (n,) free space around jaws that have stopped already, m.
    """
    X_WG = np.array(X_WG, float)
    if kind is GraspKind.JAW:
        grip = _squeeze(
            seen, gripper, X_WG, width, friction, overtravel, stopped
        )
    else:
        grip = _seal(seen, gripper, X_WG, friction, overtravel)
    quality = holding_quality(grip.holding, seen.weight) * grip.factor
    for i in np.flatnonzero((grip.reason == "") & (quality <= 0)):
        grip.reason[i] = too_weak(grip.holding[i], seen.weight)
    return [
        JudgedGrasp(
            float(quality[i]) if grip.reason[i] == "" else 0.0,
            str(grip.reason[i]),
            grip.X_WG[i],
            float(grip.width[i]),
            float(grip.holding[i]),
            float(grip.space[i]),
        )
        for i in range(len(X_WG))
    ]


class _Grip(NamedTuple):
    """(n,) rows of :class:`JudgedGrasp`; ``factor`` is that of quality."""

    X_WG: np.ndarray
    width: np.ndarray
    holding: np.ndarray
    factor: np.ndarray
    space: np.ndarray
    reason: np.ndarray


def _squeeze(
    seen: ObjectEvidence,
    gripper: GripperModel,
    X_WG: np.ndarray,
    width: np.ndarray,
    friction: np.ndarray,
    overtravel: float,
    stopped: np.ndarray | None,
) -> _Grip:
    opening = gripper.opening(width)
    if stopped is None:
        stop = seen.stop_jaw(X_WG, opening, overtravel)
    else:
        stop = Approach(X_WG, stopped, np.full(len(X_WG), ""))
    reason = stop.reason.astype(object)
    closed, holding, factor = np.zeros((3, len(X_WG)))
    left = np.flatnonzero(reason == "")
    if len(left):
        mu = friction[left]
        pads = seen.close_pads(stop.X_WG[left], opening[left], mu)
        closed[left], holding[left] = pads.width, pads.holding
        reason[left] = pads.reason
        cone = np.arctan(np.maximum(mu, 1e-6))
        alignment = np.maximum(0, 1 - pads.angle / cone)
        factor[left] = (0.5 + 0.5 * alignment) * (0.5 + 0.5 * pads.coverage)
    return _Grip(stop.X_WG, closed, holding, factor, stop.space, reason)


def _seal(
    seen: ObjectEvidence,
    gripper: GripperModel,
    X_WG: np.ndarray,
    friction: np.ndarray,
    overtravel: float,
) -> _Grip:
    seal = seen.lay_cup(X_WG)
    travel = gripper.spec.bellows_travel
    shortest = -gripper.config.max_retreat - travel
    limits = {
        "cup does not seal": ~seal.closed,
        "cup does not reach the object": seal.nearest > overtravel + travel,
        "cup is stopped too early": seal.nearest < shortest,
        "cup is too oblique": seal.spread > 2 * travel,
    }
    reason = np.full(len(X_WG), "", dtype=object)
    for why, failed in limits.items():
        reason[failed & (reason == "")] = why
    left = np.flatnonzero(reason == "")
    X_WG[left] = moved(X_WG[left], seal.nearest[left])
    around = seen.cup_space(X_WG[left])
    space = np.full(len(X_WG), np.inf)
    space[left], reason[left] = around.space, around.reason
    z = seal.normal
    x = X_WG[:, :3, 0]
    x = x - np.einsum("ni,ni->n", x, z)[:, None] * z
    x = x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-9)
    R_WC = np.stack([x, np.cross(z, x), z], axis=-1)
    holds = gripper.cup_holds(R_WC, seen.center - seal.center, friction)
    evenness = 1 - seal.unevenness / gripper.config.seal_tolerance
    return _Grip(
        X_WG,
        np.zeros(len(X_WG)),
        np.where(reason == "", holds, 0.0),
        0.5 + 0.5 * evenness,
        space,
        reason,
    )
