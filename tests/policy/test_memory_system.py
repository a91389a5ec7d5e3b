"""The SearchMemory system alone: fix its inputs, read its output."""

from typing import Any

import numpy as np
import pytest

from tests.alone import Alone
from tests.policy.blocks import (
    FLOOR,
    HEIGHT,
    TARGET_SIZE,
    WIDTH,
    Block,
    look,
    overhead_camera,
)
from xray_drake.messages import (
    Grasp,
    GraspKind,
    GripperMode,
    GripperStatus,
    Outcome,
    SearchAction,
    TargetMask,
)
from xray_drake.policy.beyond.memory import Belief, TargetMemory
from xray_drake.policy.beyond.memory_system import SearchMemory
from xray_drake.policy.beyond.shifts import Look

CAMERA = overhead_camera()
CUP = Block("cup", 30, 30, 12, 12)
BOOK = Block("book", 62, 88, 14, 14)
PEN = Block("pen", 34, 50, 3, 20)
BEFORE = look([CUP, BOOK, PEN])
AFTER = look([CUP.moved(0, 40), BOOK])
MEMORY = TargetMemory(TARGET_SIZE, FLOOR)
BUSY, IDLE = GripperMode.BUSY, GripperMode.IDLE


class Noting(TargetMemory):
    """Notes what it is told was touched."""

    touched: dict[str, Any] = {}  # noqa: RUF012

    def update(self, *args: Any, **touched: Any) -> Belief:
        self.touched.update(touched)
        return super().update(*args, **touched)


class Memory(Alone):
    """A SearchMemory with all inputs fixed, under simulation."""

    def __init__(self) -> None:
        memory = Noting(TARGET_SIZE, FLOOR)
        super().__init__(
            SearchMemory(memory=memory, width=WIDTH, height=HEIGHT),
            camera=CAMERA,
            action=SearchAction(),
            status=GripperStatus(),
        )
        self.see(BEFORE)

    def see(self, seen: Look) -> None:
        self.fix(
            depth_image=seen.depth,
            target_mask=TargetMask(seen.target),
            instances=seen.instances,
        )

    def act(self, *status: Any) -> None:
        """The gripper takes the pen."""
        grasp = Grasp(GraspKind.JAW, "pen")
        self.fix(action=SearchAction(1, grasp), status=GripperStatus(*status))

    def depth(self) -> np.ndarray:
        return np.array(self.output("depth_image").data[:, :, 0])


def remembered(**touched: str) -> np.ndarray:
    belief = MEMORY.update(Belief(), BEFORE, CAMERA)
    belief = MEMORY.update(belief, AFTER, CAMERA, **touched)
    return MEMORY.recall(belief, CAMERA)


def test_at_first_nothing_is_remembered() -> None:
    memory = Memory()
    np.testing.assert_array_equal(memory.depth(), BEFORE.depth)
    memory.see(AFTER)  # no event has made it look yet
    np.testing.assert_array_equal(memory.depth(), AFTER.depth)


@pytest.mark.parametrize(
    ("outcome", "touched"),
    [
        (Outcome.LIFTED, {"lifted": "pen", "slipped": ""}),
        (Outcome.SLIPPED, {"lifted": "", "slipped": "pen"}),
        (Outcome.FAILED, {"lifted": "", "slipped": ""}),
    ],
)
def test_after_an_action_it_adds_what_it_remembers(
    outcome: Outcome, touched: dict[str, str]
) -> None:
    """In a new context nothing is."""
    memory = Memory()
    memory.advance()
    memory.see(AFTER)
    memory.act(IDLE, 1, outcome)
    expected = remembered(**touched)
    assert (expected != AFTER.depth).any()
    for _ in range(2):  # before it stores the look, and after
        np.testing.assert_array_equal(memory.depth(), expected)
        memory.advance()
    assert Noting.touched == touched
    memory.system.SetDefaultContext(memory.context)
    np.testing.assert_array_equal(memory.depth(), AFTER.depth)


@pytest.mark.parametrize(
    "status", [(BUSY, 1), (IDLE, 0)], ids=["busy", "not taken up yet"]
)
def test_it_looks_only_when_the_action_is_done(status: tuple) -> None:
    memory = Memory()
    memory.advance()
    memory.act(*status)
    memory.see(look([]))  # would make it forget
    memory.advance()
    memory.see(AFTER)
    memory.act(IDLE, 1, Outcome.LIFTED)
    np.testing.assert_array_equal(memory.depth(), remembered(lifted="pen"))
