"""The LeafSystem that remembers where the target is not."""

from dataclasses import replace

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import Context, EventStatus, State
from pydrake.systems.sensors import ImageDepth32F

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.lifetimes import CollectableLeafSystem
from xray_drake.messages import (
    GripperStatus,
    InstanceMasks,
    Outcome,
    SearchAction,
    TargetMask,
)
from xray_drake.policy.beyond.memory import Belief, TargetMemory
from xray_drake.policy.beyond.shifts import Look
from xray_drake.policy.system import PERIOD


class SearchMemory(CollectableLeafSystem):
    """Turns what is seen into what is seen and remembered.

    .. pydrake_system::

        name: SearchMemory
        input_ports:
        - depth_image
        - target_mask
        - instances
        - camera
        - action
        - status
        output_ports:
        - depth_image

    It stands before the inference: ``depth_image`` (ImageDepth32F) comes in as
    the camera sees it and goes out as remembered, see
    :class:`~xray_drake.policy.beyond.memory.TargetMemory`. Like the policy it
    looks once per action, when the gripper is idle and has done it; ``action``
    and ``status`` tell what was lifted in between. In a new context nothing is
    remembered.
    """

    def __init__(
        self,
        *,
        memory: TargetMemory,
        width: int = 512,
        height: int = 384,
        period: float = PERIOD,
    ) -> None:
        """Declares the ports.

        Args:
            memory: what to keep.
            width: of the images, pixels.
            height: of the images, pixels.
            period: how often it checks for an idle gripper, s; the policy's.
        """
        super().__init__()
        self.set_name("search_memory")
        self._memory = memory
        camera = PinholeCamera(width, height, np.eye(3), np.eye(4))
        image = ImageDepth32F(width, height)
        self._depth_image = self.declare_input("depth_image", image)
        self._target_mask = self.declare_input("target_mask", TargetMask())
        self._instances = self.declare_input("instances", InstanceMasks())
        self._camera = self.declare_input("camera", camera)
        self._action = self.declare_input("action", SearchAction())
        self._status = self.declare_input("status", GripperStatus())
        self._state = self.DeclareAbstractState(Value(Belief()))
        self._belief = self.DeclareCacheEntry(
            description="belief after this look",
            allocate=lambda: Value(Belief()),
            calc=self._calc_belief,
            prerequisites_of_calc={
                self.abstract_state_ticket(self._state),
                self.all_input_ports_ticket(),
            },
        )
        self.DeclareAbstractOutputPort(
            "depth_image",
            alloc=lambda: Value(ImageDepth32F(width, height)),
            calc=self._calc_depth,
            prerequisites_of_calc={
                self._belief.ticket(),
                self._camera.ticket(),
            },
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(
            period_sec=period, offset_sec=0.0, update=self._update
        )

    def _calc_belief(self, context: Context, output: AbstractValue) -> None:
        before: Belief = context.get_abstract_state(self._state).get_value()
        status: GripperStatus = self._status.Eval(context)
        if status.number == before.number:
            output.set_value(before)
            return
        action: SearchAction = self._action.Eval(context)
        touched = {"lifted": "", "slipped": ""}
        if status.number == action.number:
            if status.outcome is Outcome.SLIPPED:
                touched["slipped"] = action.grasp.object
            elif status.outcome not in (Outcome.FAILED, Outcome.NO_GRASP):
                touched["lifted"] = action.grasp.object
        image: ImageDepth32F = self._depth_image.Eval(context)
        mask: TargetMask = self._target_mask.Eval(context)
        look = Look(
            image.data[:, :, 0], mask.data, self._instances.Eval(context)
        )
        belief = self._memory.update(
            before, look, self._camera.Eval(context), **touched
        )
        output.set_value(replace(belief, number=status.number))

    def _calc_depth(self, context: Context, output: AbstractValue) -> None:
        belief: Belief = self._belief.Eval(context)
        depth = self._memory.recall(belief, self._camera.Eval(context))
        output.get_mutable_value().mutable_data[:, :, 0] = depth

    def _update(self, context: Context, state: State) -> EventStatus:
        before: Belief = context.get_abstract_state(self._state).get_value()
        status: GripperStatus = self._status.Eval(context)
        action: SearchAction = self._action.Eval(context)
        done = status.has_done(action.number)
        if not done or status.number == before.number:
            return EventStatus.DidNothing()
        state.get_mutable_abstract_state(self._state).set_value(
            self._belief.Eval(context)
        )
        return EventStatus.Succeeded()
