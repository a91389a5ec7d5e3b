"""Tells the gripper when the cell is at rest."""

from collections.abc import Mapping, Sequence

from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import (
    BasicVector,
    Context,
    EventStatus,
    State,
)

from xray_drake.lifetimes import CollectableLeafSystem
from xray_drake.scene.object_model import ObjectModel
from xray_drake.scene.rest import RestTest, corners_in_cell


class RestSensor(CollectableLeafSystem):
    """Sees whether anything in the cell still moves.

    .. pydrake_system::

        name: RestSensor
        input_ports:
        - body_poses
        output_ports:
        - at_rest

    ``at_rest`` (1) is 1 where no object has moved for a whole round, else 0. It
    is of the cell, not of the gripper: what a person, or two pictures one after
    the other, would tell a real robot. Which object it is that moves, and
    where, it does not give away.
    """

    def __init__(
        self,
        *,
        objects: Sequence[ObjectModel],
        bodies: Mapping[str, int],
        motion: float = 0.001,
        round_time: float = 0.3,
        period: float = 0.05,
    ) -> None:
        """Builds the sensor.

        Args:
            objects: that may move.
            bodies: object name to its index in ``body_poses``.
            motion: nothing moves farther than this within a round, m.
            round_time: length of a round, s.
            period: time between two looks, s.
        """
        super().__init__()
        self.set_name("rest_sensor")
        self._objects = [(model, bodies[model.name]) for model in objects]
        self._poses = self.declare_input("body_poses", [RigidTransform()])
        self._state = self.DeclareAbstractState(
            Value(RestTest(motion, round_time))
        )
        self.DeclareVectorOutputPort(
            "at_rest",
            1,
            self._calc_at_rest,
            prerequisites_of_calc={self.abstract_state_ticket(self._state)},
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(
            period_sec=period, offset_sec=0.0, update=self._update
        )

    def _test(self, context: Context) -> RestTest:
        return context.get_abstract_state(self._state).get_value()

    def _calc_at_rest(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector([float(self._test(context).at_rest)])

    def _update(self, context: Context, state: State) -> EventStatus:
        test, time = self._test(context), context.get_time()
        if not test.is_due(time):
            return EventStatus.DidNothing()
        poses = self._poses.Eval(context)
        points = corners_in_cell(
            (model, poses[index].GetAsMatrix4())
            for model, index in self._objects
        )
        state.get_mutable_abstract_state(self._state).set_value(
            test.update(time, points)
        )
        return EventStatus.Succeeded()
