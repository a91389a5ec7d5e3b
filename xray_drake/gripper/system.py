"""A transfer as a system of the diagram."""

from dataclasses import replace
from typing import Generic

from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import Context, EventStatus, State

from xray_drake.gripper.transfer import Actuation, M, Phase, S, Transfer
from xray_drake.lifetimes import CollectableLeafSystem
from xray_drake.messages import GripperStatus, SearchAction


class TransferSystem(CollectableLeafSystem, Generic[S, M]):
    """Brings one object after the other to the tote; see its subclasses.

    .. pydrake_system::

        name: TransferSystem
        input_ports:
        - action
        output_ports:
        - status

    A new ``action`` (:class:`~xray_drake.messages.SearchAction`) is carried
    out by :class:`~xray_drake.gripper.transfer.Transfer`. ``status``
    (:class:`~xray_drake.messages.GripperStatus`) is idle only when it is done.
    """

    def __init__(
        self, actuation: Actuation[S, M], initial: S, *, period: float
    ) -> None:
        """Declares ports, state and event.

        Args:
            actuation: moves, grasps and measures.
            initial: state at the start.
            period: of the state machine, s.
        """
        super().__init__()
        self.set_name("gripper_controller")
        self._transfer = Transfer(actuation)
        self._action = self.declare_input("action", SearchAction())
        self._state = self.DeclareAbstractState(Value(initial))
        self._ticket = self.abstract_state_ticket(self._state)
        self.DeclareAbstractOutputPort(
            "status",
            alloc=lambda: Value(GripperStatus()),
            calc=self._calc_status,
            prerequisites_of_calc={self._ticket},
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(
            period_sec=period, offset_sec=0.0, update=self._update
        )

    def state(self, context: Context) -> S:
        """Returns the state of the transfer in its own context."""
        return context.get_abstract_state(self._state).get_value()

    def set_state(
        self, context: Context, state: S, *, action: SearchAction
    ) -> None:
        """Lets it do what another gripper of the same heap did.

        Args:
            context: its own; changed.
            state: of the other, from :meth:`state`.
            action: that it does, with the same grasp as the other.
        """
        context.get_mutable_abstract_state(self._state).set_value(
            replace(state, action=action)
        )

    def _measure(self, context: Context, state: S) -> M:
        raise NotImplementedError

    def _calc_status(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._transfer.status(self.state(context)))

    def _update(self, context: Context, state: State) -> EventStatus:
        before = following = self.state(context)
        measured = self._measure(context, before)
        if before.phase is Phase.IDLE:
            action: SearchAction = self._action.Eval(context)
            if action.number != before.action.number:
                following = self._transfer.begin(before, action, measured)
        following = self._transfer.advance(following, measured)
        if following is before:
            return EventStatus.DidNothing()
        state.get_mutable_abstract_state(self._state).set_value(following)
        return EventStatus.Succeeded()
