"""The LeafSystem that lets an agent choose what is grasped next."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from pydrake.systems.framework import Context, EventStatus, State

from xray_drake.messages import (
    Choice,
    GraspOptions,
    InstanceMasks,
    RankedCandidate,
    SearchAction,
)
from xray_drake.policy.planning import FailedGrasp
from xray_drake.policy.ranking import SearchView, candidates
from xray_drake.policy.system import Decision, SearchPolicy


def valid_options(
    names: Sequence[str], qualities: Sequence[float], *, min_quality: float
) -> tuple[str, ...]:
    """Returns the candidates that an agent may grasp.

    Those with a grasp that is good enough; where there are none, those with
    any grasp.

    Args:
        names: of the candidates.
        qualities: of the best grasp on each; 0 where there is none.
        min_quality: what is good enough.
    """
    pairs = list(zip(names, qualities, strict=True))
    good = tuple(n for n, q in pairs if q > 0 and q >= min_quality)
    return good or tuple(n for n, q in pairs if q > 0)


class ChoicePolicy(SearchPolicy):
    """A SearchPolicy whose ranking is an agent's choice.

    .. pydrake_system::

        name: ChoicePolicy
        input_ports:
        - occupancy
        - instances
        - target_mask
        - status
        - body_poses (planning from models)
        - seen_depth_image (planning from depth)
        - camera (planning from depth)
        - choice
        output_ports:
        - action
        - options

    It waits until ``choice`` (:class:`~xray_drake.messages.Choice`) is for the
    next action; planning, the memory of failed grasps and all else are those
    of :class:`SearchPolicy`. A choice that is not among the valid ones of
    ``options`` (:class:`~xray_drake.messages.GraspOptions`) spends an action,
    and nothing moves. ``options`` plans a grasp on each candidate when it is
    evaluated, so look at it when the heap is at rest.
    """

    def __init__(self, **settings: Any) -> None:
        """Builds the policy.

        Args:
            **settings: as of :class:`SearchPolicy`; the ranking is not used,
                nor is ``target_first``.
        """
        super().__init__(**settings)
        self._choice = self.declare_input("choice", Choice())
        self._options = self.declare_output(
            "options",
            GraspOptions(),
            self._possible,
            self._instances,
            *self._planning_inputs(),
            self._status,
            self.abstract_state_ticket(self._memory),
        )

    def _possible(self, context: Context) -> GraspOptions:
        instances: InstanceMasks = self._instances.Eval(context)
        names = candidates(instances, min_pixels=self._min_pixels)
        failed = self._still_excluded(context, self._failed(context))
        plan = self._planning(context, instances, failed)
        qualities = tuple(plan(name).grasp.quality for name in names)
        valid = valid_options(names, qualities, min_quality=self._min_quality)
        return GraspOptions(names, qualities, valid)

    def _update(self, context: Context, state: State) -> EventStatus:
        decided: SearchAction = self.GetOutputPort("action").Eval(context)
        if self._chosen(context).number != decided.number + 1:
            return EventStatus.DidNothing()
        return super()._update(context, state)

    def _chosen(self, context: Context) -> Choice:
        if not self._choice.HasValue(context):
            return Choice()
        return self._choice.Eval(context)

    def _ranked(
        self, context: Context, view: SearchView, number: int
    ) -> list[RankedCandidate]:
        name = self._chosen(context).object
        valid = self._options.Eval(context).valid
        return [RankedCandidate(name, 0.0, True)] if name in valid else []

    def _decide(
        self, context: Context, number: int, failed: tuple[FailedGrasp, ...]
    ) -> Decision:
        decision = super()._decide(context, number, failed)
        action = decision.action
        others = bool(self._options.Eval(context).valid)
        return replace(
            decision,
            action=replace(action, invalid=others and not action.grasp),
        )
