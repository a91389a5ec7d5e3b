"""A search where all that a cell has is another's."""

from typing import Any

import numpy as np
import pytest
from pydrake.systems.framework import Context

from xray_drake.cell.bin import Bin, Tote
from xray_drake.scene.heap import Heap
from xray_drake.search.diagram import build_search_diagram
from xray_drake.search.rollout import run_search
from xray_drake.station.scenario import Scenario, parse_scenario
from xray_drake.testing.tiny import observe

CELL = """
horizon: 5
cell:
  bin: {length: 0.34, width: 0.30, wall_height: 0.08, wall_slope: 12}
  tote: {position: [-0.1, 0.5, 0.0], length: 0.4, width: 0.3}
  overhead:
    name: ceiling
    width: 380
    height: 250
    X_PB:
      translation: [0.12, 0, 0.68]
      rotation: !Rpy {deg: [180, 10, 0]}
  cameras:
    side:
      width: 64
      height: 48
      X_PB:
        base_frame: world
        translation: [0, -0.8, 0.5]
        rotation: !Rpy {deg: [-120, 0, 0]}
perception: {segmenter: depth, detector: hsv}
gripper: {grasps: depth}
policy: {target_first: false, name: memory}
"""


@pytest.fixture
def scenario() -> Scenario:
    return parse_scenario(CELL, "cell")


def test_a_search_in_another_cell(scenario: Scenario, tiny_heap: Heap) -> None:
    diagram = build_search_diagram(scenario, heap=tiny_heap)
    seen = observe(diagram)
    assert seen.depth.shape == (250, 380)
    context = diagram.CreateDefaultContext()
    side = diagram.GetOutputPort("side.depth_image").Eval(context).data
    assert side.shape == (48, 64, 1) and np.isfinite(side).any()

    occupancy = diagram.GetOutputPort("occupancy_inference.occupancy")
    support = occupancy.Eval(context).support()
    floor = seen.camera.unproject(seen.camera.plane_depth(0.0))[..., :2]
    outside = (np.abs(floor) > [0.173, 0.153]).any(axis=-1)
    assert support.any() and not (support & outside).any()

    # Neither floor nor sloping walls are objects.
    masks = diagram.GetOutputPort("instance_segmenter.instances").Eval(context)
    shown = {
        name
        for mask in map(masks.mask, masks.names)
        for name, label in seen.label_of.items()
        if (seen.labels[mask] == label).mean() > 0.5
    }
    assert len(shown) == len(masks.names) >= 4

    record = run_search(diagram)
    lifted = [action for action in record.actions if action.lifted]
    assert lifted, record.end


def test_objects_go_to_the_tote_and_the_gripper_home(
    scenario: Scenario, tiny_heap: Heap
) -> None:
    places: list[np.ndarray] = []

    class Watcher:
        def decided(self, *_: object) -> None: ...

        def ended(self, diagram: Any, context: Context, record: Any) -> None:
            if record.lifted:
                name = record.lifted[0]
                index = diagram.station.labels[name]
                poses = diagram.GetOutputPort("cheat.body_poses").Eval(context)
                places.append(poses[index].translation())

    diagram = build_search_diagram(scenario, heap=tiny_heap)
    run_search(diagram, observers=[Watcher()])
    tote = Tote(position=[-0.1, 0.5, 0.0], length=0.4, width=0.3)
    # The target is not brought anywhere: the search ends as it is lifted.
    assert tote.is_under(places[0])
    gripper = diagram.GetOutputPort("gripper_controller.position").Eval(
        diagram.CreateDefaultContext()
    )
    box = Bin(length=0.34, width=0.3, wall_height=0.08, wall_slope=12)
    np.testing.assert_allclose(
        gripper[4:6], [0.0, box.outside[1] + 0.1], atol=1e-9
    )
