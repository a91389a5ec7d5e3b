"""Contexts of one diagram, used in turn, do not disturb each other."""

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator

from xray_drake.messages import GripperStatus, SearchAction
from xray_drake.search.diagram import SearchDiagram
from xray_drake.search.monitor import attach_monitor

SLICE = 0.15
END = 0.6
"""s; by then it has decided, planned and judged a grasp, and lifts."""


class Search:
    """One simulation of a diagram, with or without a block on the book."""

    def __init__(self, diagram: SearchDiagram, *, block_on_book: bool) -> None:
        self.diagram = diagram
        plant = diagram.station.plant
        root = diagram.CreateDefaultContext()
        if block_on_book:
            p_WO = diagram.heap.poses["book"][:3, 3] + [0.0, 0.0, 0.04]
            plant.SetFreeBodyPose(
                plant.GetMyMutableContextFromRoot(root),
                diagram.station.objects["block"].body,
                RigidTransform(p_WO),
            )
        self.simulator = Simulator(diagram, root)
        attach_monitor(self.simulator, diagram)
        self.seen: list[np.ndarray] = []

    def advance(self) -> None:
        root = self.simulator.get_context()
        self.simulator.AdvanceTo(root.get_time() + SLICE)
        plant = self.diagram.station.plant
        action, status = (
            self.diagram.GetOutputPort(port).Eval(root)
            for port in ("search_policy.action", "gripper_controller.status")
        )
        assert isinstance(action, SearchAction)
        assert isinstance(status, GripperStatus)
        self.seen += [
            plant.GetPositionsAndVelocities(plant.GetMyContextFromRoot(root)),
            np.array(action.grasp.X_WG),
            np.array([c.score for c in action.ranking]),
            np.array([action.number, status.mode.value, status.held]),
        ]

    def run(self) -> list[np.ndarray]:
        while self.simulator.get_context().get_time() < END - 1e-9:
            self.advance()
        return self.seen


def test_two_searches_of_one_diagram_take_turns(
    tiny_diagram: SearchDiagram,
) -> None:
    """Planner and judge of both ask one collision scene."""
    alone = [
        Search(tiny_diagram, block_on_book=on).run() for on in (False, True)
    ]
    both = [Search(tiny_diagram, block_on_book=on) for on in (False, True)]
    for _ in range(round(END / SLICE)):
        for search in both:
            search.advance()
    for search, expected in zip(both, alone, strict=True):
        assert search.seen[-1][0] == "1"
        for a, b in zip(search.seen, expected, strict=True):
            np.testing.assert_array_equal(a, b)
    assert both[0].seen[-1][-1] == "book"
    assert not np.array_equal(alone[0][-1], alone[1][-1])
