"""The system that carries out grasps by contact."""

import numpy as np
from pydrake.systems.framework import BasicVector, Context

from xray_drake.cell.bin import Tote
from xray_drake.cell.cell import Cell
from xray_drake.gripper.actuation.contact import (
    ContactActuation,
    ContactState,
    ExecutionConfig,
    Measured,
)
from xray_drake.gripper.carriers.carrier import Tracking
from xray_drake.gripper.mounted import MountedGripper
from xray_drake.gripper.suction import CupState
from xray_drake.gripper.system import TransferSystem


class GripperController(TransferSystem[ContactState, Measured]):
    """Lifts objects with fingers or suction cup, and feels whether it does.

    .. pydrake_system::

        name: GripperController
        input_ports:
        - action
        - carrier_state
        - finger_state
        - cup_state
        - at_rest
        output_ports:
        - status
        - carrier_desired_state
        - finger_desired_state
        - suction

    A new ``action`` (:class:`~xray_drake.messages.SearchAction`) is carried
    out by :class:`~xray_drake.gripper.actuation.contact.ContactActuation`. The
    inputs ``carrier_state`` (2 n, of n joints) and ``finger_state`` (4) are
    what the plant gives out as state of the two model instances, and the
    outputs are their desired states. ``cup_state``
    (:class:`~xray_drake.gripper.suction.CupState`) comes from the
    :class:`~xray_drake.gripper.suction_cup.SuctionCup`, and
    ``suction`` (1) goes to it; a gripper without a cup leaves both open.
    ``at_rest`` (1) says whether the cell is at rest, see
    :class:`~xray_drake.gripper.rest_sensor.RestSensor`; left open, it is taken
    to be so soon after the gripper is home.

    ``status`` (:class:`~xray_drake.messages.GripperStatus`) is as the gripper
    measures it: ``held`` is what it meant to take, if it holds anything.
    """

    def __init__(
        self,
        *,
        gripper: MountedGripper,
        tote: Tote | None = None,
        config: ExecutionConfig | None = None,
        force: float | None = None,
        period: float = 0.01,
        time_step: float = 0.005,
    ) -> None:
        """Builds the controller.

        Args:
            gripper: what it moves.
            tote: where it puts objects down; by default the nominal cell's.
            config: how.
            force: squeeze of each finger, N; by default all that it can.
            period: of the state machine, s.
            time_step: of the plant, s: the delay of its position control.
        """
        actuation = ContactActuation(
            gripper,
            tote or Cell().placed_tote,
            config,
            force=force,
            period=period,
        )
        super().__init__(actuation, actuation.initial(), period=period)
        self._time_step = time_step
        size = 2 * len(gripper.carrier.home)
        self._carrier = self.DeclareVectorInputPort("carrier_state", size)
        self._fingers = self.DeclareVectorInputPort("finger_state", 4)
        self._cup = self.declare_input("cup_state", CupState())
        self._at_rest = self.DeclareVectorInputPort("at_rest", 1)
        for name, length, calc in (
            ("carrier_desired_state", size, self._calc_carrier),
            ("finger_desired_state", 4, self._calc_fingers),
            ("suction", 1, self._calc_suction),
        ):
            self.DeclareVectorOutputPort(
                name,
                length,
                calc,
                prerequisites_of_calc={self._ticket, self.time_ticket()},
            )

    def _calc_carrier(self, context: Context, output: BasicVector) -> None:
        q, v = self.state(context).path.sample(context.get_time())
        output.SetFromVector(np.concatenate([q, v]))

    def _calc_fingers(self, context: Context, output: BasicVector) -> None:
        state = self.state(context)
        q, v = state.finger, state.finger_rate
        output.SetFromVector([q, q, v, v])

    def _calc_suction(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector([float(self.state(context).suction)])

    def _measure(self, context: Context, state: ContactState) -> Measured:
        time = context.get_time()
        q, v = np.split(self._carrier.Eval(context), 2)
        due = time - self._time_step
        return Measured(
            time=time,
            tracking=Tracking(
                q, v, *state.path.sample(due), state.path.acceleration(due)
            ),
            finger=float(self._fingers.Eval(context)[:2].mean()),
            cup=self._cup.Eval(context)
            if self._cup.HasValue(context)
            else CupState(),
            at_rest=not self._at_rest.HasValue(context)
            or bool(self._at_rest.Eval(context)[0] > 0.5),
        )
