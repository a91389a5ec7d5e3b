"""Remembers where actions have ended, for searches that begin alike."""

from dataclasses import dataclass, fields

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, EventStatus

from xray_drake.gripper.actuation.ideal import (
    IdealState,
    QuasiStaticGripper,
)
from xray_drake.messages import Grasp, SearchAction
from xray_drake.scene.sleep import Sleeper
from xray_drake.search.diagram import SearchDiagram
from xray_drake.search.monitor import SearchMonitor
from xray_drake.search.record import ActionRecord

History = tuple[tuple[object, ...], ...]
"""The grasps from a heap's start on, each as what it is made of."""


@dataclass(frozen=True, eq=False)
class Transition:
    """The state in which an action has ended.

    Attributes:
        time: of the simulation, s.
        state: (n,) positions and velocities of the plant.
        asleep: names of the bodies that sleep.
        gripper: state of the gripper.
    """

    time: float
    state: np.ndarray
    asleep: frozenset[str]
    gripper: IdealState


class Transitions(dict[History, Transition]):
    """Where actions of the ideal gripper on one heap have ended.

    The same grasps on the same heap, one after the other, end in the same
    state, whoever chose them: physics and the errors of execution are the
    seed's. Policies that are compared on one heap choose alike for a while;
    what they have in common is simulated once. All else, what they see, infer
    and decide, is each one's own.

    Give one to :func:`~xray_drake.search.rollout.run_search` for each search
    on a heap, of scenarios that differ in policy and perception alone.
    """


class TransitionRecall:
    """Ends an action at once if it is known, else remembers how it ends.

    An observer of one search. It cannot change the simulation while it is
    told: the simulator stops by :meth:`stops`, then :meth:`skip` goes on.
    """

    def __init__(self, diagram: SearchDiagram, known: Transitions) -> None:
        """Begins at the start of a search.

        Args:
            diagram: the search.
            known: what is known; grows.

        Raises:
            ValueError: execution by contact, whose state is not kept.
        """
        gripper = diagram.GetSubsystemByName("gripper_controller")
        if not isinstance(gripper, QuasiStaticGripper):
            raise ValueError(
                "only quasi-static execution can skip what is known: leave "
                "out transitions"
            )
        self._gripper = gripper
        station = diagram.station
        self._plant = station.plant
        self._sleeper = Sleeper(
            station.plant, station.scene_graph, station.objects.values()
        )
        self._known = known
        self._history: History = ()
        self._action = SearchAction()
        self._next: Transition | None = None

    def decided(
        self, diagram: SearchDiagram, context: Context, action: SearchAction
    ) -> None:
        """Looks whether it is known how the action will end."""
        self._action = action
        self._history += (_parts(action.grasp),)
        self._next = self._known.get(self._history)

    def ended(
        self, diagram: SearchDiagram, context: Context, record: ActionRecord
    ) -> None:
        """Remembers how the action has ended."""
        if self._history in self._known:
            return
        plant_context = self._plant.GetMyContextFromRoot(context)
        self._known[self._history] = Transition(
            context.get_time(),
            np.array(self._plant.GetPositionsAndVelocities(plant_context)),
            self._sleeper.asleep(context),
            self._gripper.state(self._gripper.GetMyContextFromRoot(context)),
        )

    def stops(self, monitor: SearchMonitor, root: Context) -> EventStatus:
        """Calls the search's monitor, and stops where there is a known end."""
        status = monitor(root)
        if self._next is None:
            return status
        return EventStatus.ReachedTermination(
            self._gripper, "it is known how the action ends"
        )

    def skip(self, simulator: Simulator) -> None:
        """Goes to the end of an action that has just been decided, if known.

        Args:
            simulator: of the search, between two ``AdvanceTo``.
        """
        known, self._next = self._next, None
        if known is None:
            return
        root = simulator.get_mutable_context()
        root.SetTime(known.time)
        self._plant.SetPositionsAndVelocities(
            self._plant.GetMyMutableContextFromRoot(root), known.state
        )
        self._sleeper.set_asleep(root, known.asleep)
        self._gripper.set_state(
            self._gripper.GetMyMutableContextFromRoot(root),
            known.gripper,
            action=self._action,
        )
        # The monitor looks, and events due at this time are still to come, as
        # at the end of a step.
        simulator.Initialize()


def _parts(grasp: Grasp) -> tuple[object, ...]:
    values = (getattr(grasp, field.name) for field in fields(grasp))
    return tuple(
        value.tobytes() if isinstance(value, np.ndarray) else value
        for value in values
    )
