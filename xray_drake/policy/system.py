"""The LeafSystem that looks, ranks, and commands the next grasp."""

import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import (
    Context,
    EventStatus,
    LeafSystem,
    State,
)
from pydrake.systems.sensors import ImageDepth32F

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.grasping.planner import GraspPlanner
from xray_drake.messages import (
    Grasp,
    GripperMode,
    GripperStatus,
    InstanceMasks,
    Message,
    OccupancyDistribution,
    Outcome,
    SearchAction,
    TargetMask,
)
from xray_drake.occupancy.system import OccupancyModel
from xray_drake.perception.ground_truth import target_instance
from xray_drake.policy.ranking import (
    Outlook,
    Planning,
    Ranking,
    SearchView,
    candidates,
    order,
)
from xray_drake.seeding import stream


@dataclass(frozen=True, eq=False)
class _Memory(Message):
    action: SearchAction = field(default_factory=SearchAction)
    failed: tuple[Grasp, ...] = ()


class _Planned:
    """Plans grasps at one state of the heap, each once."""

    def __init__(
        self,
        planner: GraspPlanner,
        poses: Mapping[str, np.ndarray],
        failed: Sequence[Grasp],
    ) -> None:
        self._planner = planner
        self._poses = poses
        self._failed = failed
        self._known: dict[tuple[str, frozenset[str]], Grasp] = {}

    def __call__(self, name: str, *, without: Collection[str] = ()) -> Grasp:
        key = name, frozenset(without)
        if key not in self._known:
            self._known[key] = self._planner.plan(
                name,
                {n: X for n, X in self._poses.items() if n not in key[1]},
                excluded=[g for g in self._failed if g.object == name],
            )
        return self._known[key]


@dataclass(frozen=True)
class Foresight:
    """What a policy whose ranking imagines removals needs.

    Attributes:
        inference: infers where the target could be then.
        target_size: (3,) length, width, thickness of the target, m.
        width, height: of the images, pixels.
    """

    inference: OccupancyModel
    target_size: np.ndarray
    width: int = 512
    height: int = 384


class SearchPolicy(LeafSystem):
    """Chooses the next object and a grasp on it (paper section V).

    .. pydrake_system::

        name: SearchPolicy
        input_ports:
        - occupancy
        - instances
        - target_mask
        - status
        - body_poses
        - depth_image (with foresight)
        - camera (with foresight)
        - true_target (with truth)
        output_ports:
        - action

    It looks only while ``status`` says that the gripper is idle and has done
    the last action. Then it ranks the objects seen, asks the planner for a
    grasp on the first, else on the next, and raises ``action.number``. The
    inputs are messages of :mod:`xray_drake.messages` but for ``body_poses``,
    the ground truth that planning from models needs, ``depth_image``
    (ImageDepth32F, what the occupancy was inferred from) and ``camera``
    (PinholeCamera). ``true_target`` is the target's true amodal mask; a policy
    without ``truth`` has no such port.

    A grasp that failed is not tried again: the planner is told of all grasps
    that failed on an object.
    """

    def __init__(
        self,
        *,
        ranking: Ranking,
        planner: GraspPlanner,
        bodies: Mapping[str, int],
        target_first: bool = True,
        min_visible_pixels: int = 50,
        min_grasp_quality: float = 0.0,
        foresight: Foresight | None = None,
        truth: bool = False,
        seed: int = 0,
        period: float = 0.05,
    ) -> None:
        """Builds the policy.

        Args:
            ranking: scores the objects; the only thing policies differ in.
            planner: finds grasps.
            bodies: object name to its index in ``body_poses``.
            target_first: grasp the target whenever there is a grasp on it.
            min_visible_pixels: objects with fewer are not candidates.
            min_grasp_quality: a weaker grasp is taken only where no candidate
                has one as good as this; then the first of the weak ones is.
            foresight: for rankings that imagine removals.
            truth: for rankings that know where the target is.
            seed: of the ranking's random generator.
            period: how often it checks for an idle gripper, s.
        """
        super().__init__()
        self.set_name("search_policy")
        self._ranking = ranking
        self._planner = planner
        self._bodies = dict(bodies)
        self._target_first = target_first
        self._min_pixels = min_visible_pixels
        self._min_quality = min_grasp_quality
        self._seed = seed
        self._occupancy = self.DeclareAbstractInputPort(
            "occupancy", Value(OccupancyDistribution())
        )
        self._instances = self.DeclareAbstractInputPort(
            "instances", Value(InstanceMasks())
        )
        self._target_mask = self.DeclareAbstractInputPort(
            "target_mask", Value(TargetMask())
        )
        self._status = self.DeclareAbstractInputPort(
            "status", Value(GripperStatus())
        )
        self._poses = self.DeclareAbstractInputPort(
            "body_poses", Value([RigidTransform()])
        )
        self._foresight = foresight
        if foresight is not None:
            size = foresight.width, foresight.height
            self._depth_image = self.DeclareAbstractInputPort(
                "depth_image", Value(ImageDepth32F(*size))
            )
            self._camera = self.DeclareAbstractInputPort(
                "camera", Value(PinholeCamera(*size, np.eye(3), np.eye(4)))
            )
        self._truth = truth
        if truth:
            self._true_target = self.DeclareAbstractInputPort(
                "true_target", Value(TargetMask())
            )
        self._memory = self.DeclareAbstractState(Value(_Memory()))
        self.DeclareAbstractOutputPort(
            "action",
            alloc=lambda: Value(SearchAction()),
            calc=self._calc_action,
            prerequisites_of_calc={self.abstract_state_ticket(self._memory)},
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(
            period_sec=period, offset_sec=0.0, update=self._update
        )

    def _calc_action(self, context: Context, output: AbstractValue) -> None:
        memory: _Memory = context.get_abstract_state(self._memory).get_value()
        output.set_value(memory.action)

    def _update(self, context: Context, state: State) -> EventStatus:
        memory: _Memory = context.get_abstract_state(self._memory).get_value()
        status: GripperStatus = self._status.Eval(context)
        waiting = (
            status.mode is not GripperMode.IDLE
            or status.number != memory.action.number
        )
        if waiting:
            return EventStatus.DidNothing()
        failed = self._failed(context)
        action = self._decide(context, memory.action.number + 1, failed)
        state.get_mutable_abstract_state(self._memory).set_value(
            _Memory(action, failed)
        )
        return EventStatus.Succeeded()

    def _failed(self, context: Context) -> tuple[Grasp, ...]:
        """Returns the grasps that failed, that of the last action included."""
        memory: _Memory = context.get_abstract_state(self._memory).get_value()
        status: GripperStatus = self._status.Eval(context)
        if status.outcome in (Outcome.FAILED, Outcome.SLIPPED):
            return *memory.failed, memory.action.grasp
        return memory.failed

    def _ranked(
        self, context: Context, view: SearchView, number: int
    ) -> list[tuple[str, float]]:
        """Returns the candidates with their scores, the best first."""
        return order(
            view,
            self._ranking,
            stream(self._seed, "ranking", number),
            target=view.target if self._target_first else "",
        )

    def _decide(
        self, context: Context, number: int, failed: tuple[Grasp, ...]
    ) -> SearchAction:
        clock = time.perf_counter
        start = clock()
        target_mask: TargetMask = self._target_mask.Eval(context)
        instances: InstanceMasks = self._instances.Eval(context)
        seen = clock()
        occupancy: OccupancyDistribution = self._occupancy.Eval(context)
        inferred = clock()
        target = target_instance(instances, target_mask)
        plan = self._planned(context, failed)
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
        grasp, score = self._first_grasp(ranked, plan)
        planned = clock()
        return SearchAction(
            number=number,
            grasp=grasp,
            is_target=bool(grasp) and grasp.object == target,
            ranking=tuple(name for name, _ in ranked),
            scores=tuple(score for _, score in ranked),
            score=score,
            support=occupancy.support_size(),
            support_01=occupancy.support_size(0.1),
            target_pixels=int(np.count_nonzero(target_mask.data)),
            seconds=(
                ("perception", seen - start),
                ("occupancy", inferred - seen),
                ("ranking", ordered - inferred),
                ("planning", planned - ordered),
            ),
        )

    def _planned(self, context: Context, failed: tuple[Grasp, ...]) -> _Planned:
        return _Planned(self._planner, self._object_poses(context), failed)

    def _object_poses(self, context: Context) -> dict[str, np.ndarray]:
        body_poses = self._poses.Eval(context)
        return {
            name: body_poses[index].GetAsMatrix4()
            for name, index in self._bodies.items()
        }

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

    def _first_grasp(
        self, ranked: Sequence[tuple[str, float]], plan: Planning
    ) -> tuple[Grasp, float]:
        weak: tuple[Grasp, float] = (Grasp(), 0.0)
        for name, score in ranked:
            grasp = plan(name)
            if grasp and grasp.quality >= self._min_quality:
                return grasp, score
            if grasp and not weak[0]:
                weak = grasp, score
        return weak
