"""The SearchMemory system alone: fix its inputs, read its output."""

from typing import Any

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator
from pydrake.systems.sensors import ImageDepth32F

from tests.policy.blocks import (
    FLOOR,
    HEIGHT,
    TARGET_SIZE,
    WIDTH,
    Block,
    look,
    overhead_camera,
)
from tests.ports import inputs_of
from xray_drake.messages import (
    Grasp,
    GraspKind,
    GripperMode,
    GripperStatus,
    Message,
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


class Noting(TargetMemory):
    """Notes what it is told was touched."""

    touched: list[dict[str, Any]]

    def __init__(self) -> None:
        super().__init__(TARGET_SIZE, FLOOR)
        object.__setattr__(self, "touched", [])

    def update(self, *args: Any, **touched: Any) -> Belief:
        self.touched.append(touched)
        return super().update(*args, **touched)


class Memory:
    """A SearchMemory with all inputs fixed, under simulation."""

    def __init__(self) -> None:
        self.memory = Noting()
        self.system = SearchMemory(
            memory=self.memory, width=WIDTH, height=HEIGHT
        )
        self.simulator = Simulator(self.system)
        self.context = self.simulator.get_mutable_context()
        self.fix("camera", CAMERA)
        self.see(BEFORE)
        self.act(0, GripperStatus())

    def fix(self, port: str, value: object) -> None:
        self.system.GetInputPort(port).FixValue(
            self.context, AbstractValue.Make(value)
        )

    def see(self, seen: Look) -> None:
        image = ImageDepth32F(WIDTH, HEIGHT)
        image.mutable_data[:, :, 0] = seen.depth
        self.fix("depth_image", image)
        self.fix("target_mask", TargetMask(seen.target))
        self.fix("instances", seen.instances)

    def act(self, number: int, status: Message, grasped: str = "pen") -> None:
        grasp = Grasp(GraspKind.JAW, grasped) if number else Grasp()
        self.fix("action", SearchAction(number, grasp))
        self.fix("status", status)

    def advance(self) -> None:
        self.simulator.AdvanceTo(self.context.get_time() + 0.2)

    def depth(self) -> np.ndarray:
        port = self.system.GetOutputPort("depth_image")
        return np.array(port.Eval(self.context).data[:, :, 0])


def remembered(memory: TargetMemory, **touched: str) -> np.ndarray:
    belief = memory.update(Belief(), BEFORE, CAMERA)
    belief = memory.update(belief, AFTER, CAMERA, **touched)
    return memory.recall(belief, CAMERA)


def test_ports_are_named() -> None:
    system = Memory().system
    assert inputs_of(system) == [
        "depth_image",
        "target_mask",
        "instances",
        "camera",
        "action",
        "status",
    ]
    assert system.get_output_port().get_name() == "depth_image"
    assert system.get_name() == "search_memory"


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
    memory = Memory()
    memory.advance()
    memory.see(AFTER)
    memory.act(1, GripperStatus(GripperMode.IDLE, 1, outcome))
    expected = remembered(TargetMemory(TARGET_SIZE, FLOOR), **touched)
    assert (expected != AFTER.depth).any()
    for _ in range(2):  # before it stores the look, and after
        np.testing.assert_array_equal(memory.depth(), expected)
        memory.advance()
    assert memory.memory.touched == [{"lifted": "", "slipped": ""}, touched]


@pytest.mark.parametrize(
    "status",
    [
        GripperStatus(GripperMode.BUSY, 1),
        GripperStatus(GripperMode.IDLE, 0),  # not taken up yet
    ],
)
def test_it_looks_only_when_the_action_is_done(status: GripperStatus) -> None:
    memory = Memory()
    memory.advance()
    memory.act(1, status)
    memory.see(look([]))  # would make it forget
    memory.advance()
    memory.see(AFTER)
    memory.act(1, GripperStatus(GripperMode.IDLE, 1, Outcome.LIFTED))
    np.testing.assert_array_equal(
        memory.depth(), remembered(memory.memory, lifted="pen")
    )


def test_a_new_search_begins_without_memory() -> None:
    memory = Memory()
    memory.advance()
    memory.see(AFTER)
    memory.act(1, GripperStatus(GripperMode.IDLE, 1, Outcome.LIFTED))
    memory.advance()
    assert (memory.depth() != AFTER.depth).any()
    memory.system.SetDefaultContext(memory.context)
    np.testing.assert_array_equal(memory.depth(), AFTER.depth)
