"""The system that carries out grasps by contact."""

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import (
    BasicVector,
    Context,
    EventStatus,
    State,
)

from xray_drake.gripper.execution import (
    ExecutionConfig,
    GraspExecution,
    Motion,
    Phase,
    Senses,
)
from xray_drake.gripper.suction import CupState
from xray_drake.gripper.yumi import YumiGripper
from xray_drake.lifetimes import CollectableLeafSystem
from xray_drake.messages import GripperStatus, SearchAction


class GripperController(CollectableLeafSystem):
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
    out by the state machine of :mod:`xray_drake.gripper.execution`. The inputs
    ``carrier_state`` (2 n, of n joints) and ``finger_state`` (4) are what the
    plant gives out as state of the two model instances, and the outputs are
    their desired states. ``cup_state``
    (:class:`~xray_drake.gripper.suction.CupState`) comes from the
    :class:`~xray_drake.gripper.suction_cup.SuctionCup`, and
    ``suction`` (1) goes to it. ``at_rest`` (1) says whether the cell is at
    rest, see :class:`~xray_drake.gripper.rest_sensor.RestSensor`; left open, it
    is taken to be so soon after the gripper is home.

    ``status`` (:class:`~xray_drake.messages.GripperStatus`) is that of
    :class:`~xray_drake.gripper.quasi_static.QuasiStaticGripper`, as the gripper
    feels it: ``held`` is what it meant to take, if it holds anything.
    """

    def __init__(
        self,
        *,
        gripper: YumiGripper,
        config: ExecutionConfig | None = None,
        force: float = 20.0,
        period: float = 0.01,
        time_step: float = 0.005,
    ) -> None:
        """Builds the controller.

        Args:
            gripper: what it moves.
            config: how.
            force: squeeze of each finger, N.
            period: of the state machine, s.
            time_step: of the plant, s: so late it is where it should be.
        """
        super().__init__()
        self.set_name("gripper_controller")
        self._execution = GraspExecution(gripper, config, force=force)
        self._period = period
        self._time_step = time_step
        joints = len(gripper.home)
        self._action = self.DeclareAbstractInputPort(
            "action", Value(SearchAction())
        )
        self._carrier = self.DeclareVectorInputPort("carrier_state", 2 * joints)
        self._fingers = self.DeclareVectorInputPort("finger_state", 4)
        self._cup = self.DeclareAbstractInputPort(
            "cup_state", Value(CupState())
        )
        self._at_rest = self.DeclareVectorInputPort("at_rest", 1)
        self._state = self.DeclareAbstractState(Value(self._execution.rest()))
        ticket = self.abstract_state_ticket(self._state)
        self.DeclareAbstractOutputPort(
            "status",
            alloc=lambda: Value(GripperStatus()),
            calc=self._calc_status,
            prerequisites_of_calc={ticket},
        )
        self.DeclareVectorOutputPort(
            "carrier_desired_state",
            2 * joints,
            self._calc_carrier,
            prerequisites_of_calc={ticket, self.time_ticket()},
        )
        self.DeclareVectorOutputPort(
            "finger_desired_state",
            4,
            self._calc_fingers,
            prerequisites_of_calc={ticket},
        )
        self.DeclareVectorOutputPort(
            "suction", 1, self._calc_suction, prerequisites_of_calc={ticket}
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(
            period_sec=period, offset_sec=0.0, update=self._update
        )

    def _motion(self, context: Context) -> Motion:
        return context.get_abstract_state(self._state).get_value()

    def _calc_status(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._execution.status(self._motion(context)))

    def _calc_carrier(self, context: Context, output: BasicVector) -> None:
        q, v = self._motion(context).path.sample(context.get_time())
        output.SetFromVector(np.concatenate([q, v]))

    def _calc_fingers(self, context: Context, output: BasicVector) -> None:
        motion = self._motion(context)
        q, v = motion.finger, motion.finger_rate
        output.SetFromVector([q, q, v, v])

    def _calc_suction(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector([float(self._motion(context).suction)])

    def _update(self, context: Context, state: State) -> EventStatus:
        motion = self._motion(context)
        time = context.get_time()
        q, v = np.split(self._carrier.Eval(context), 2)
        due = time - self._time_step
        desired, rate = motion.path.sample(due)
        senses = Senses(
            time=time,
            joints=q,
            desired=desired,
            finger=float(self._fingers.Eval(context)[:2].mean()),
            cup=self._cup.Eval(context),
            at_rest=not self._at_rest.HasValue(context)
            or bool(self._at_rest.Eval(context)[0] > 0.5),
            velocities=v,
            lag_velocity=rate - v,
            acceleration=motion.path.acceleration(due),
        )
        following = motion
        if motion.phase is Phase.IDLE:
            action: SearchAction = self._action.Eval(context)
            if action.number != motion.action.number:
                following = self._execution.begin(motion, action, senses)
        following = self._execution.advance(following, senses, self._period)
        if following is motion:
            return EventStatus.DidNothing()
        state.get_mutable_abstract_state(self._state).set_value(following)
        return EventStatus.Succeeded()
