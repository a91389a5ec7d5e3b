"""The LeafSystem that looks, ranks, and commands the next grasp."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, InputPort, State
from pydrake.systems.sensors import ImageDepth32F

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.grasping.planner import GraspPlanner
from xray_drake.lifetimes import CollectableLeafSystem
from xray_drake.messages import (
    Grasp,
    GripperStatus,
    InstanceMasks,
    Message,
    OccupancyDistribution,
    Outcome,
    RankedCandidate,
    SearchAction,
    TargetMask,
)
from xray_drake.occupancy.observation import OccupancyModel
from xray_drake.perception.ground_truth import target_instance
from xray_drake.policy.planning import (
    FailedGrasp,
    place_of,
    planning_on_images,
    planning_on_models,
    still_there,
)
from xray_drake.policy.ranking import (
    Outlook,
    Planning,
    Ranking,
    SearchView,
    candidates,
    order,
)
from xray_drake.seeding import stream

PERIOD = 0.05
"""How often policy and memory check for an idle gripper, s."""


@dataclass(frozen=True, eq=False)
class Decision(Message):
    """The policy's state.

    Attributes:
        action: what it has decided.
        place: what was seen where it grasps, to tell whether that has changed;
            see :func:`~xray_drake.policy.planning.place_of`.
        failed: what has failed before.
    """

    action: SearchAction = field(default_factory=SearchAction)
    place: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    failed: tuple[FailedGrasp, ...] = ()


@dataclass(frozen=True)
class Foresight:
    """What a policy whose ranking imagines removals needs.

    Attributes:
        inference: infers where the target could be then.
        target_size: (3,) length, width, thickness of the target, m.
    """

    inference: OccupancyModel
    target_size: np.ndarray


class SearchPolicy(CollectableLeafSystem):
    """Chooses the next object and a grasp on it (paper section V).

    .. pydrake_system::

        name: SearchPolicy
        input_ports:
        - occupancy
        - instances
        - target_mask
        - status
        - body_poses (planning from models)
        - seen_depth_image (planning from depth)
        - depth_image (with foresight)
        - camera (planning from depth, or with foresight)
        - true_target (with truth)
        output_ports:
        - action

    It looks only while ``status`` says that the gripper is idle and has done
    the last action. Then it ranks the objects seen, asks the planner for a
    grasp on the first, else on the next, and raises ``action.number``. The
    inputs are messages of :mod:`xray_drake.messages` but for ``body_poses``,
    the ground truth that planning from models needs, ``seen_depth_image``
    (ImageDepth32F, what the camera sees), ``depth_image`` (ImageDepth32F, what
    the occupancy was inferred from) and ``camera`` (PinholeCamera).
    ``true_target`` is the target's true amodal mask; a policy without ``truth``
    has no such port.

    A grasp that failed is not tried again. Planning from models, the planner is
    told of all grasps that failed on an object. Planning from depth, where an
    object has no name that lasts, it is told of all that failed at places that
    still look as they did (:mod:`xray_drake.policy.planning`).
    """

    def __init__(
        self,
        *,
        ranking: Ranking,
        planner: GraspPlanner[Any],
        bodies: Mapping[str, int] | None = None,
        target_first: bool = True,
        min_visible_pixels: int = 50,
        min_grasp_quality: float = 0.0,
        foresight: Foresight | None = None,
        truth: bool = False,
        width: int = 512,
        height: int = 384,
        seed: int = 0,
        period: float = PERIOD,
    ) -> None:
        """Builds the policy.

        Args:
            ranking: scores the objects; the only thing policies differ in.
            planner: finds grasps: with ``bodies`` on models at poses, else on
                what is seen, where it excludes grasps by their poses in the
                world, whatever object they are called of.
            bodies: object name to its index in ``body_poses``.
            target_first: grasp the target whenever there is a grasp on it.
            min_visible_pixels: objects with fewer are not candidates.
            min_grasp_quality: a weaker grasp is taken only where no candidate
                that hides the target, as the ranking says, has one as good as
                this; then the first of the weak ones is.
            foresight: for rankings that imagine removals.
            truth: for rankings that know where the target is.
            width: of the images, pixels.
            height: of the images, pixels.
            seed: of the ranking's random generator.
            period: how often it checks for an idle gripper, s.
        """
        super().__init__()
        self.set_name("search_policy")
        self._ranking = ranking
        self._planner = planner
        self._bodies = bodies
        self._target_first = target_first
        self._min_pixels = min_visible_pixels
        self._min_quality = min_grasp_quality
        self._seed = seed
        self._foresight = foresight
        self._truth = truth
        self._declare_inputs(width, height)
        self._memory = self.DeclareAbstractState(Value(Decision()))
        ticket = self.abstract_state_ticket(self._memory)
        self.declare_output("action", SearchAction(), self._action, ticket)
        self.DeclarePeriodicUnrestrictedUpdateEvent(
            period_sec=period, offset_sec=0.0, update=self._update
        )

    def _declare_inputs(self, width: int, height: int) -> None:
        image = ImageDepth32F(width, height)
        self._occupancy = self.declare_input(
            "occupancy", OccupancyDistribution()
        )
        self._instances = self.declare_input("instances", InstanceMasks())
        self._target_mask = self.declare_input("target_mask", TargetMask())
        self._status = self.declare_input("status", GripperStatus())
        if self._bodies is None:
            self._seen_depth = self.declare_input("seen_depth_image", image)
        else:
            self._poses = self.declare_input("body_poses", [RigidTransform()])
        if self._foresight is not None:
            self._depth_image = self.declare_input("depth_image", image)
        if self._bodies is None or self._foresight is not None:
            camera = PinholeCamera(width, height, np.eye(3), np.eye(4))
            self._camera = self.declare_input("camera", camera)
        if self._truth:
            self._true_target = self.declare_input("true_target", TargetMask())

    def _last(self, context: Context) -> Decision:
        return context.get_abstract_state(self._memory).get_value()

    def _action(self, context: Context) -> SearchAction:
        return self._last(context).action

    def _update(self, context: Context, state: State) -> EventStatus:
        number = self._last(context).action.number
        status: GripperStatus = self._status.Eval(context)
        if not status.has_done(number):
            return EventStatus.DidNothing()
        failed = self._failed(context)
        state.get_mutable_abstract_state(self._memory).set_value(
            self._decide(context, number + 1, failed)
        )
        return EventStatus.Succeeded()

    def _failed(self, context: Context) -> tuple[FailedGrasp, ...]:
        """Returns the grasps that failed, that of the last action included."""
        last = self._last(context)
        status: GripperStatus = self._status.Eval(context)
        if status.outcome in (Outcome.FAILED, Outcome.SLIPPED):
            return *last.failed, FailedGrasp(last.action.grasp, last.place)
        return last.failed

    def _ranked(
        self, context: Context, view: SearchView, number: int
    ) -> list[RankedCandidate]:
        """Returns the candidates, the best first."""
        return order(
            view,
            self._ranking,
            stream(self._seed, "ranking", number),
            target=view.target if self._target_first else "",
        )

    def _decide(
        self, context: Context, number: int, failed: tuple[FailedGrasp, ...]
    ) -> Decision:
        clock = time.perf_counter
        start = clock()
        target_mask: TargetMask = self._target_mask.Eval(context)
        instances: InstanceMasks = self._instances.Eval(context)
        seen = clock()
        occupancy: OccupancyDistribution = self._occupancy.Eval(context)
        inferred = clock()
        target = target_instance(instances, target_mask)
        failed = self._still_excluded(context, failed)
        plan = self._planning(context, instances, failed)
        view = SearchView(
            occupancy,
            instances,
            candidates(instances, min_pixels=self._min_pixels),
            target,
            plan,
            self._outlook(context, target_mask),
            self._true_target.Eval(context).data if self._truth else None,
        )
        ranked = self._ranked(context, view, number)
        ordered = clock()
        ranked, chosen = self._first_grasp(ranked, plan)
        planned = clock()
        grasp = plan(ranked[chosen].name).grasp if chosen >= 0 else Grasp()
        action = SearchAction(
            number=number,
            grasp=grasp,
            is_target=bool(grasp) and grasp.object == target,
            ranking=tuple(ranked),
            score=ranked[chosen].score if chosen >= 0 else 0.0,
            support=occupancy.support_size(),
            support_01=occupancy.support_01_size(),
            target_pixels=int(np.count_nonzero(target_mask.data)),
            seconds=(
                ("perception", seen - start),
                ("occupancy", inferred - seen),
                ("ranking", ordered - inferred),
                ("planning", planned - ordered),
            ),
        )
        return Decision(action, self._place(context, grasp), failed)

    def _planning(
        self,
        context: Context,
        instances: InstanceMasks,
        failed: Sequence[FailedGrasp],
    ) -> Planning:
        planner = self._planner
        if self._bodies is None:
            seen = self._seen(context)
            return planning_on_images(planner, instances, *seen, failed)
        body_poses = self._poses.Eval(context)
        poses = {
            name: body_poses[index].GetAsMatrix4()
            for name, index in self._bodies.items()
        }
        return planning_on_models(planner, poses, failed)

    def _planning_inputs(self) -> list[InputPort]:
        if self._bodies is None:
            return [self._seen_depth, self._camera]
        return [self._poses]

    def _seen(self, context: Context) -> tuple[np.ndarray, PinholeCamera]:
        image: ImageDepth32F = self._seen_depth.Eval(context)
        return np.array(image.data[:, :, 0]), self._camera.Eval(context)

    def _still_excluded(
        self, context: Context, failed: tuple[FailedGrasp, ...]
    ) -> tuple[FailedGrasp, ...]:
        if self._bodies is not None:
            return failed
        depth, camera = self._seen(context)
        return tuple(f for f in failed if still_there(f, depth, camera))

    def _place(self, context: Context, grasp: Grasp) -> np.ndarray:
        if self._bodies is not None:
            return np.zeros((0, 3))
        return place_of(grasp, *self._seen(context))

    def _outlook(
        self, context: Context, target_mask: TargetMask
    ) -> Outlook | None:
        foresight = self._foresight
        if foresight is None:
            return None
        image: ImageDepth32F = self._depth_image.Eval(context)
        camera: PinholeCamera = self._camera.Eval(context)
        return Outlook(
            np.array(image.data[:, :, 0]),
            target_mask.data,
            camera,
            foresight.target_size,
            lambda depth, mask: foresight.inference.infer(depth, mask, camera),
        )

    def grasps(
        self, context: Context, names: Sequence[str]
    ) -> dict[str, Grasp]:
        """Plans grasps as after the last decision.

        For those who watch: the policy itself stops at the first that it
        takes.

        Args:
            context: the policy's own; the heap is as it was when it decided.
            names: of the candidates to plan for.

        Returns:
            Candidate to its best grasp; without those that have none.
        """
        instances: InstanceMasks = self._instances.Eval(context)
        failed = self._last(context).failed
        plan = self._planning(context, instances, failed)
        planned = {name: plan(name).grasp for name in names}
        return {name: grasp for name, grasp in planned.items() if grasp}

    def _first_grasp(
        self, ranked: Sequence[RankedCandidate], plan: Planning
    ) -> tuple[list[RankedCandidate], int]:
        """Finds the candidate to be grasped.

        The first whose grasp is good enough. While only a weak one is found it
        waits for one on the others; but if it is on what hides the target, not
        for those on what does not.

        Returns:
            The ranking, with why others were passed over, and its index in it;
            −1 for none.
        """
        told, weak = list(ranked), -1
        for i, candidate in enumerate(ranked):
            if weak >= 0 and ranked[weak].hides and not candidate.hides:
                why = "hides nothing, and a weak grasp on what does is better"
            else:
                planned = plan(candidate.name)
                quality = planned.grasp.quality
                if planned and quality >= self._min_quality:
                    return told, i
                why = planned.why_not() or "no grasp"
                if planned:
                    why = f"quality {quality:.2f} < {self._min_quality:g}"
                    weak = i if weak < 0 else weak
            told[i] = candidate._replace(passed_over=why)
        if weak >= 0:
            told[weak] = ranked[weak]
        return told, weak
