"""Watches a search: records each action and ends the rollout."""

from collections.abc import Collection
from dataclasses import asdict
from typing import Any, Protocol

import numpy as np
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import Context, EventStatus

from xray_drake.geometry.silhouette import project_mesh_mask
from xray_drake.gripper.transfer import LIFT_CLEARANCE
from xray_drake.lifetimes import my_context
from xray_drake.messages import (
    GripperMode,
    GripperStatus,
    Outcome,
    SearchAction,
)
from xray_drake.policy.registry import POLICIES
from xray_drake.scene.sleep_monitor import SleepMonitor
from xray_drake.search.diagram import AGENT, SearchDiagram
from xray_drake.search.record import ActionRecord, SearchRecord
from xray_drake.station.provenance import scenario_provenance
from xray_drake.station.scenario import record_scenario
from xray_drake.station.start import TargetView, target_view


class Observer(Protocol):
    """Is told of a search while it goes on."""

    def decided(
        self, diagram: SearchDiagram, context: Context, action: SearchAction
    ) -> None:
        """Is called when the policy has decided, before the gripper moves.

        Args:
            diagram: the search.
            context: its root context.
            action: the decision.
        """
        return

    def ended(
        self, diagram: SearchDiagram, context: Context, record: ActionRecord
    ) -> None:
        """Is called when an action has ended."""
        return


class SearchMonitor:
    """A simulator monitor that ends the rollout by the rules of PROTOCOL.md.

    A Diagram cannot end its own simulation, nor put its bodies to sleep. This
    can, also in a plain ``simulator.AdvanceTo`` in a notebook: see
    :func:`attach_monitor`. It is of one simulation.

    Attributes:
        record: what has happened so far.
    """

    def __init__(
        self, diagram: SearchDiagram, *, observers: tuple[Observer, ...] = ()
    ) -> None:
        """Builds the monitor.

        Args:
            diagram: the search.
            observers: told of decisions and of ends of actions.
        """
        scenario, station = diagram.scenario, diagram.station
        self._diagram = diagram
        self._observers = observers
        self._target = diagram.heap.target
        self._bin = diagram.scenario.cell.bin
        self._tote = diagram.scenario.cell.placed_tote
        self._action = diagram.GetOutputPort("search_policy.action")
        self._status = diagram.GetOutputPort("gripper_controller.status")
        gripper = station.gripper
        self._by_contact = gripper is not None
        self._sleep = SleepMonitor(
            station.plant,
            station.scene_graph,
            station.objects.values(),
            movers=gripper.bodies(station.plant) if gripper else (),
        )
        self._settle_awake = scenario.gripper.quasi_static.settle_awake
        self._removed: set[str] = set()
        self._decided = 0
        self._moving = False
        self._began = 0.0
        self._cleared = False
        self.record = _begun(diagram)

    def __call__(self, root_context: Context) -> EventStatus:
        """Looks at the search after a step."""
        if self.record.end:
            return self._termination()
        context = my_context(self._diagram, root_context)
        action: SearchAction = self._action.Eval(context)
        if action.number > self._decided:
            self._begin(context, action)
        status: GripperStatus = self._status.Eval(context)
        if self._by_contact:
            # Whatever the gripper holds, the target may hang on it.
            if status.held and not self._cleared:
                self._cleared = self._is_clear(context)
        elif status.held == self._target.name and self._is_clear(context):
            self._finish(context, Outcome.LIFTED, "", "success")
            return self._termination()
        self._let_sleep(root_context, status)
        goes_on = self.record.num_done < self.record.num_actions
        if goes_on and status.has_done(self._decided):
            end = self._end(context, status)
            self._finish(context, status.outcome, status.reason, end)
        if self.record.end:
            return self._termination()
        return EventStatus.DidNothing()

    def _let_sleep(self, root_context: Context, status: GripperStatus) -> None:
        """Lets the heap sleep, but for what the gripper stirs.

        What is drawn out wakes what it disturbs, and that comes to rest again.
        All in the bin are awake after a slip of the ideal gripper, and where
        the scenario says so. By contact, what is at rest and far from the
        gripper sleeps. While the gripper is idle all sleep, so that pictures
        of one decision are of one heap.
        """
        asleep = {*self._diagram.station.objects}
        if self._by_contact:
            moving, loose = status.mode is not GripperMode.IDLE, set()
        else:
            loose = set(status.loose)
            moving = status.stirring
            if status.settling and (self._settle_awake or not status.held):
                moving, asleep = False, self._removed
        if not moving:
            self._sleep.set_asleep(root_context, asleep - loose)
        else:
            if not self._moving:
                self._sleep.forget()
            self._sleep(root_context, awake=loose)
        self._moving = moving

    def _termination(self) -> EventStatus:
        return EventStatus.ReachedTermination(
            self._diagram, f"the search ended: {self.record.end}"
        )

    def _eval(self, context: Context, port: str) -> Any:
        return self._diagram.GetOutputPort(port).Eval(context)

    def _camera_port(self, context: Context, port: str) -> Any:
        name = self._diagram.scenario.camera.name
        return self._eval(context, f"{name}.{port}")

    def _target_pose(self, context: Context) -> np.ndarray:
        index = self._diagram.station.labels[self._target.name]
        return self._eval(context, "cheat.body_poses")[index].GetAsMatrix4()

    def amodal_mask(self, context: Context) -> np.ndarray:
        """Returns the target's (H, W) bool pixels as if it lay alone.

        Args:
            context: of the search.
        """
        return project_mesh_mask(
            self._target.visual.vertices,
            self._target.visual.faces,
            self._target_pose(context),
            self._camera_port(context, "camera"),
        )

    def target_view(self, context: Context) -> TargetView:
        """Returns what the camera sees of the target and what covers it.

        Args:
            context: of the search.
        """
        return target_view(
            self._camera_port(context, "label_image").data[:, :, 0],
            self.amodal_mask(context),
            self._diagram.station.labels,
            self._target.name,
        )

    def _is_clear(self, context: Context) -> bool:
        X = self._target_pose(context)
        lowest = (self._target.visual.vertices @ X[2, :3]).min() + X[2, 3]
        return bool(lowest >= self._bin.wall_height + LIFT_CLEARANCE)

    def _end(self, context: Context, status: GripperStatus) -> str:
        p_WT = self._target_pose(context)[:3, 3]
        if self._by_contact and self._cleared and self._tote.holds(p_WT):
            return "success"
        if not self._bin.is_over(p_WT):
            return "target_lost"
        action: SearchAction = self._action.Eval(context)
        if status.outcome is Outcome.NO_GRASP and not action.invalid:
            return "nothing_graspable"
        if self.record.num_actions >= self.record.horizon:
            return "horizon"
        return ""

    def _begin(self, context: Context, action: SearchAction) -> None:
        self._decided = action.number
        self._began = context.get_time()
        self._cleared = False
        amodal = self.amodal_mask(context)
        pixels = max(int(np.count_nonzero(amodal)), 1)
        visible = action.target_pixels / pixels
        rho = self._eval(context, "occupancy_inference.occupancy")
        inside = np.count_nonzero(rho.support() & amodal) / pixels
        record = self.record
        if not record.actions:
            record.start |= asdict(self.target_view(context))
            record.start["target_visible_fraction"] = visible
        elif record.actions[-1].support_after < 0:
            record.actions[-1].support_after = action.support
            record.actions[-1].support_01_after = action.support_01
        record.actions.append(
            ActionRecord(
                step=action.number,
                object=self._grasped_body(context, action),
                segment=action.grasp.object,
                is_target=action.is_target,
                grasp=action.grasp,
                score=action.score,
                support_before=action.support,
                support_01_before=action.support_01,
                target_visible_fraction=min(visible, 1.0),
                true_mask_in_support=inside,
                seconds=dict(action.seconds),
                ranking=action.ranking,
            )
        )
        for observer in self._observers:
            observer.decided(self._diagram, context, action)

    def _grasped_body(self, context: Context, action: SearchAction) -> str:
        """Returns the name of the body that the gripper is told to take."""
        if action.grasp and self._diagram.HasSubsystemNamed("grasped_body"):
            action = self._eval(context, "grasped_body.action")
        return action.grasp.object

    def _finish(
        self, context: Context, outcome: Outcome, reason: str, end: str
    ) -> None:
        action = self.record.actions[-1]
        poses = self._eval(context, "cheat.body_poses")
        places = {
            name: poses[index].translation()
            for name, index in self._diagram.station.labels.items()
        }
        removed = {
            n for n, p_WO in places.items() if not self._bin.is_over(p_WO)
        }
        brought = {action.object} if outcome is Outcome.LIFTED else set()
        if self._by_contact:
            gone = removed - self._removed
            brought = {name for name in gone if self._tote.holds(places[name])}
            outcome, reason = judge_outcome(
                outcome, reason, action.object, brought
            )
        action.outcome, action.reason = outcome, reason
        action.lifted = tuple(sorted(brought))
        action.duration = context.get_time() - self._began
        self._removed = removed
        self.record.end = end
        if end == "success":
            action.support_after = action.support_01_after = 0
        elif end:
            rho = self._eval(context, "occupancy_inference.occupancy")
            action.support_after = rho.support_size()
            action.support_01_after = rho.support_01_size()
        for observer in self._observers:
            observer.ended(self._diagram, context, action)


def _begun(diagram: SearchDiagram) -> SearchRecord:
    """Returns the record of a search before its first decision."""
    scenario, heap = diagram.scenario, diagram.heap
    policy, source = AGENT, ""
    if not diagram.agent:
        policy = scenario.policy.name
        source = POLICIES[policy].source
    return SearchRecord(
        horizon=scenario.horizon,
        policy=policy,
        policy_source=source,
        occupancy=scenario.perception.occupancy,
        execution=scenario.gripper.execution,
        seed=scenario.seed,
        target=heap.target.name,
        objects=[model.name for model in heap.objects],
        start={
            "target_tilt_deg": float(np.rad2deg(heap.target_tilt)),
            "num_dropped": heap.num_dropped,
            "attempts": heap.attempts,
            "redrawn": heap.redrawn,
        },
        target_first=scenario.policy.target_first and not diagram.agent,
        scenario=record_scenario(scenario),
        provenance=scenario_provenance(scenario),
    )


def judge_outcome(
    felt: Outcome, reason: str, meant: str, brought: Collection[str]
) -> tuple[Outcome, str]:
    """Returns how an action by contact really ended, and why.

    Args:
        felt: as far as the gripper knows.
        reason: of a failure, as far as the gripper knows.
        meant: name of the object that it was to take, empty if none is known.
        brought: names of what has reached the tote.
    """
    if meant in brought or (brought and not meant):
        return Outcome.LIFTED, ""
    if brought:
        names = ", ".join(sorted(brought))
        return Outcome.LIFTED, f"it took {names} in place of {meant}"
    if felt is Outcome.LIFTED:
        return Outcome.SLIPPED, "it fell off unnoticed"
    return felt, reason


def begin_search(
    diagram: SearchDiagram, *, observers: tuple[Observer, ...] = ()
) -> tuple[Simulator, SearchMonitor]:
    """Returns a simulator as the scenario wants it, and the monitor in it.

    Args:
        diagram: the search.
        observers: told of decisions and of ends of actions.
    """
    simulator = Simulator(diagram)
    ApplySimulatorConfig(diagram.scenario.simulator_config, simulator)
    return simulator, attach_monitor(simulator, diagram, observers=observers)


def attach_monitor(
    simulator: Simulator,
    diagram: SearchDiagram,
    *,
    observers: tuple[Observer, ...] = (),
) -> SearchMonitor:
    """Lets a simulator record a search and end with it.

    A simulator has one monitor; this sets it.

    Args:
        simulator: of the diagram, or of one that contains it.
        diagram: the search.
        observers: told of decisions and of ends of actions.

    Returns:
        The monitor; its ``record`` grows while the simulator advances.
    """
    monitor = SearchMonitor(diagram, observers=observers)
    simulator.set_monitor(monitor)
    return monitor
