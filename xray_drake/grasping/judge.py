"""Judges grasps on an object, by whatever it is known."""

from collections.abc import Sequence

import numpy as np

from xray_drake.grasping.candidates import moved
from xray_drake.grasping.evidence.protocol import ObjectEvidence
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
    n = len(X_WG)
    X_WG = np.array(X_WG, float)
    space = np.full(n, np.inf) if stopped is None else stopped.copy()
    closed, holding, factor = np.zeros(n), np.zeros(n), np.zeros(n)
    reason = np.full(n, "", dtype=object)
    if kind is GraspKind.JAW:
        opening = gripper.opening(width)
        if stopped is None:
            stop = seen.stop_jaw(X_WG, opening, overtravel)
            X_WG, space, reason = stop.X_WG, stop.space, stop.reason.astype("O")
        left = np.flatnonzero(reason == "")
        if len(left):
            pads = seen.close_pads(X_WG[left], opening[left], friction[left])
            closed[left], holding[left] = pads.width, pads.holding
            reason[left] = pads.reason
            cone = np.arctan(np.maximum(friction[left], 1e-6))
            factor[left] = (
                0.5 + 0.5 * np.maximum(0, 1 - pads.angle / cone)
            ) * (0.5 + 0.5 * pads.coverage)
    else:
        seal = seen.lay_cup(X_WG)
        travel = gripper.parameters.bellows_travel
        limits = (
            (~seal.closed, "cup does not seal"),
            (
                seal.nearest > overtravel + travel,
                "cup does not reach the object",
            ),
            (
                seal.nearest < -gripper.config.max_retreat - travel,
                "cup is stopped too early",
            ),
            (seal.spread > 2 * travel, "cup is too oblique"),
        )
        for failed, why in limits:
            reason[failed & (reason == "")] = why
        left = np.flatnonzero(reason == "")
        X_WG[left] = moved(X_WG[left], seal.nearest[left])
        around = seen.cup_space(X_WG[left])
        space[left], reason[left] = around.space, around.reason
        z = seal.normal
        x = X_WG[:, :3, 0]
        x = x - np.einsum("ni,ni->n", x, z)[:, None] * z
        x = x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-9)
        R_WC = np.stack([x, np.cross(z, x), z], axis=-1)
        holds = gripper.cup_holds(R_WC, seen.center - seal.center, friction)
        holding = np.where(reason == "", holds, 0.0)
        factor = 0.5 + 0.5 * (
            1 - seal.unevenness / gripper.config.seal_tolerance
        )
    quality = holding_quality(holding, seen.weight) * factor
    for i in np.flatnonzero((reason == "") & (quality <= 0)):
        reason[i] = too_weak(holding[i], seen.weight)
    return [
        JudgedGrasp(
            float(quality[i]) if reason[i] == "" else 0.0,
            str(reason[i]),
            X_WG[i],
            float(closed[i]),
            float(holding[i]),
            float(space[i]),
        )
        for i in range(n)
    ]
