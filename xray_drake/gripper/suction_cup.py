"""The suction cup as a system of the diagram."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce, SpatialVelocity
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import (
    Context,
    EventStatus,
    State,
)

from xray_drake.grasping.evidence.sampling import cast_rays, seal_cups
from xray_drake.grasping.judgement import Lip
from xray_drake.grasping.seal import ring_offsets
from xray_drake.gripper.suction import (
    Cup,
    CupState,
    HeldBody,
    deflection_of,
    hold,
    open_cup,
)
from xray_drake.lifetimes import CollectableLeafSystem
from xray_drake.scene.object_model import ObjectModel

_BEHIND = 0.02
"""Rays at the surface start this far behind the lip, m."""


class SuctionCup(CollectableLeafSystem):
    """Holds what its lip seals on, until that is too much.

    .. pydrake_system::

        name: SuctionCup
        input_ports:
        - suction
        - body_poses
        - body_spatial_velocities
        output_ports:
        - state
        - applied_spatial_force

    While ``suction`` (a vector of one, on above 0.5) is on, rays are cast from
    the lip along the cup's axis. Where all of it meets one object's surface,
    locally flat, within the reach of bellows and vacuum, it seals (the test of
    Dex-Net 3.0, as in grasp planning). From then on a spring and a damper hold
    the object by what ``applied_spatial_force`` gives to it and, opposite, to
    the gripper; see :mod:`xray_drake.gripper.suction`.

    ``state`` (:class:`~xray_drake.gripper.suction.CupState`) has what a real
    ejector feels, ``vacuum`` and ``flow``, and what only a simulation knows. It
    changes in one periodic event, once for each of the plant's steps. The force
    is that of the state after it, whether the plant steps in the same instant
    before that event is done (Drake's ``use_sampled_output_ports``) or after.
    """

    def __init__(
        self,
        *,
        objects: Sequence[ObjectModel],
        bodies: Mapping[str, int],
        gripper: int,
        X_BC: np.ndarray,
        cup: Cup | None = None,
        seal_tolerance: float = 0.0025,
        seal_angle: float = 0.70,
        time_step: float = 0.005,
        look_period: float = 0.02,
    ) -> None:
        """Builds the cup.

        Args:
            objects: that it can seal on; bin and tote it does not hold.
            bodies: object name to its index in the body ports.
            gripper: index of the gripper's body B in them.
            X_BC: 4×4 pose of the cup frame in B, m.
            cup: how strong it is.
            seal_tolerance: largest distance of the surface under the lip from
                a plane, m.
            seal_angle: largest deviation of its normals, rad.
            time_step: of the plant, s; its forces are renewed in each.
            look_period: time between two tries to seal, s.
        """
        super().__init__()
        self.set_name("suction_cup")
        self._models = {model.name: model for model in objects}
        self._bodies = dict(bodies)
        self._gripper = gripper
        self._X_BC = np.array(X_BC)
        self._cup = cup or Cup()
        radius = self._cup.gripper.cup_radius
        self._lip = Lip(radius, seal_tolerance, seal_angle)
        self._step = time_step
        self._look_every = max(1, round(look_period / time_step))
        self._suction = self.DeclareVectorInputPort("suction", 1)
        self._poses = self.declare_input("body_poses", [RigidTransform()])
        self._velocities = self.declare_input(
            "body_spatial_velocities", [SpatialVelocity.Zero()]
        )
        self._state = self.DeclareAbstractState(Value(CupState()))
        self.DeclareStateOutputPort("state", self._state)
        self._next = self.DeclareCacheEntry(
            description="the state of this step",
            allocate=lambda: Value(CupState()),
            calc=self._calc_next,
            prerequisites_of_calc={
                self.abstract_state_ticket(self._state),
                self.time_ticket(),
                self._suction.ticket(),
                self._poses.ticket(),
                self._velocities.ticket(),
            },
        )
        self.DeclareAbstractOutputPort(
            "applied_spatial_force",
            alloc=lambda: Value([ExternallyAppliedSpatialForce()]),
            calc=self._calc_force,
            prerequisites_of_calc={self._next.ticket()},
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(
            period_sec=time_step, offset_sec=0.0, update=self._update
        )

    def _calc_force(self, context: Context, output: AbstractValue) -> None:
        state: CupState = self._next.Eval(context)
        if not state.object:
            output.set_value([])
            return
        output.set_value(
            [
                _applied(
                    self._bodies[state.object], state.X_OC[:3, 3], state.wrench
                ),
                _applied(self._gripper, state.p_BL, -state.wrench),
            ]
        )

    def _calc_next(self, context: Context, output: AbstractValue) -> None:
        state: CupState = context.get_abstract_state(self._state).get_value()
        tick = round(context.get_time() / self._step)
        if state.tick != tick:
            after = self._advanced(context, state, tick)
            if after is not state:
                state = replace(after, tick=tick)
        output.set_value(state)

    def _advanced(
        self, context: Context, state: CupState, tick: int
    ) -> CupState:
        suction = bool(self._suction.Eval(context)[0] > 0.5)
        if state.object and suction:
            return self._hold(context, state)
        state = open_cup(state, suction=suction)
        if suction and tick % self._look_every == 0:
            return self._seal(context, state)
        return state

    def _update(self, context: Context, state: State) -> EventStatus:
        before = context.get_abstract_state(self._state).get_value()
        after: CupState = self._next.Eval(context)
        if after is before:
            return EventStatus.DidNothing()
        state.get_mutable_abstract_state(self._state).set_value(after)
        return EventStatus.Succeeded()

    def _hold(self, context: Context, state: CupState) -> CupState:
        model = self._models[state.object]
        poses, velocities = (
            port.Eval(context) for port in (self._poses, self._velocities)
        )
        index = self._bodies[state.object]
        X_WO = poses[index].GetAsMatrix4()
        X_WB = poses[self._gripper].GetAsMatrix4()
        X_WC, X_WL = X_WB @ self._X_BC, X_WO @ state.X_OC
        R_WO, p_WL = X_WO[:3, :3], X_WL[:3, 3]
        body = HeldBody(
            mass=model.mass,
            inertia=R_WO @ model.inertia @ R_WO.T,
            lever=R_WO @ (state.X_OC[:3, 3] - model.p_OCom),
            R_WC=X_WC[:3, :3],
            deflection=deflection_of(X_WC, X_WL),
            velocity=_velocity_at(velocities[index], p_WL - X_WO[:3, 3]),
            cup_velocity=_velocity_at(
                velocities[self._gripper], p_WL - X_WB[:3, 3]
            ),
        )
        after = hold(self._cup, state, body, self._step)
        return replace(after, p_BL=X_WB[:3, :3].T @ (p_WL - X_WB[:3, 3]))

    def _seal(self, context: Context, state: CupState) -> CupState:
        """Returns the state sealed on what the lip meets, or as it is."""
        poses = self._poses.Eval(context)
        X_WC = poses[self._gripper].GetAsMatrix4() @ self._X_BC
        near: dict[str, np.ndarray] = {}
        for name, model in self._models.items():
            X_OW = poses[self._bodies[name]].inverse().GetAsMatrix4()
            X_OC = X_OW @ X_WC
            low, high = model.visual.bounds
            room = self._lip.radius + _BEHIND
            if ((X_OC[:3, 3] > low - room) & (X_OC[:3, 3] < high + room)).all():
                near[name] = X_OC
        for name, X_OC in near.items():
            seal = seal_cups(
                self._models[name].visual,
                X_OC[None],
                self._lip,
                reach=_BEHIND,
            )
            nearest = float(seal.nearest[0])
            farthest = nearest + float(seal.spread[0])
            if (
                seal.closed[0]
                and farthest <= self._cup.config.reach
                and nearest >= -2 * self._cup.gripper.bellows_travel
                and not self._covered(near, name, farthest)
            ):
                return replace(CupState(drawing=True), object=name, X_OC=X_OC)
        return state

    def _covered(
        self, near: Mapping[str, np.ndarray], name: str, depth: float
    ) -> bool:
        """Says whether another object than ``name`` lies under the lip.

        Args:
            near: 4×4 X_OC of the objects about.
            name: what the cup would seal on.
            depth: how far from the lip's plane that is, m.
        """
        offsets = ring_offsets(self._lip.radius)
        rays = np.column_stack([offsets, np.full(len(offsets), -_BEHIND)])
        for other, X_OC in near.items():
            if other == name:
                continue
            distance, _ = cast_rays(
                self._models[other].visual,
                rays @ X_OC[:3, :3].T + X_OC[:3, 3],
                np.broadcast_to(X_OC[:3, 2], rays.shape),
            )
            if (distance - _BEHIND < depth).any():
                return True
        return False


def _applied(
    body: int, point: np.ndarray, wrench: np.ndarray
) -> ExternallyAppliedSpatialForce:
    applied = ExternallyAppliedSpatialForce()
    applied.body_index = BodyIndex(body)
    applied.p_BoBq_B = point
    applied.F_Bq_W = SpatialForce(wrench)
    return applied


def _velocity_at(V: SpatialVelocity, p: np.ndarray) -> np.ndarray:
    """Returns the (6,) velocity of a body at an offset from its origin."""
    w = V.rotational()
    return np.concatenate([w, V.translational() + np.cross(w, p)])
