"""Watches searches, and compares their records."""

import copy
from collections.abc import Callable
from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, EventStatus

from xray_drake.messages import GripperStatus, SearchAction
from xray_drake.search.diagram import SearchDiagram
from xray_drake.search.monitor import attach_monitor
from xray_drake.search.record import ActionRecord, SearchRecord
from xray_drake.station.scenario import Scenario

TARGET = "box_2to1"


def stripped(record: SearchRecord) -> dict[str, Any]:
    """Returns the record without its wall times."""
    data = copy.deepcopy(record.to_dict())
    for action in data["actions"]:
        del action["seconds"]
    return data


def always_failing(scenario: Scenario) -> Scenario:
    """The gripper misses by half a metre."""
    scenario.gripper.quasi_static.perturbation.position_sigma = 0.5
    return scenario


class Watcher:
    """Notes what it is told, and does something on the way."""

    def __init__(
        self,
        decided: Callable[[SearchDiagram, Context], None] | None = None,
        ended: Callable[[SearchDiagram, Context], None] | None = None,
    ) -> None:
        self._decided, self._ended = decided, ended
        self.told: list[tuple[str, int]] = []
        self.locked: list[set[str]] = []
        self.poses: list[dict[str, np.ndarray]] = []

    def decided(
        self, diagram: SearchDiagram, context: Context, action: SearchAction
    ) -> None:
        self.told.append(("decided", action.number))
        self._look(diagram, context)
        if self._decided:
            self._decided(diagram, context)

    def ended(
        self, diagram: SearchDiagram, context: Context, record: ActionRecord
    ) -> None:
        self.told.append(("ended", record.step))
        self._look(diagram, context)
        if self._ended:
            self._ended(diagram, context)

    def _look(self, diagram: SearchDiagram, context: Context) -> None:
        plant = diagram.station.plant
        plant_context = plant.GetMyContextFromRoot(context)
        items = diagram.station.objects.values()
        self.locked.append(
            {i.name for i in items if i.joint.is_locked(plant_context)}
        )
        self.poses.append(
            {
                i.name: i.body.EvalPoseInWorld(plant_context).GetAsMatrix4()
                for i in items
            }
        )


class Sleepers:
    """Notes after each step who sleeps, and what the gripper says.

    Attributes:
        seen: status and names of the sleepers.
    """

    def __init__(
        self,
        diagram: SearchDiagram,
        limit: float = 60.0,
        observers: tuple[Watcher, ...] = (),
    ) -> None:
        self.seen: list[tuple[GripperStatus, set[str]]] = []
        self._diagram = diagram
        self._items = diagram.station.objects.values()
        self._status = diagram.GetOutputPort("gripper_controller.status")
        simulator = Simulator(diagram)
        self._monitor = attach_monitor(simulator, diagram, observers=observers)
        simulator.set_monitor(self._watch)
        simulator.AdvanceTo(limit)

    @property
    def record(self) -> SearchRecord:
        return self._monitor.record

    def _watch(self, root: Context) -> EventStatus:
        result = self._monitor(root)
        context = self._diagram.station.plant.GetMyContextFromRoot(root)
        asleep = {i.name for i in self._items if i.joint.is_locked(context)}
        self.seen.append((self._status.Eval(root), asleep))
        return result
