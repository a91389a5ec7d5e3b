"""A whole search without ground truth on the way, on the tiny heap."""

import json

import numpy as np
import pytest

from tests.search.watching import TARGET
from xray_drake.messages import GraspKind, Outcome, SearchAction
from xray_drake.scene.heap import Heap
from xray_drake.search.diagram import build_search_diagram
from xray_drake.search.rollout import run_search
from xray_drake.station.scenario import Scenario


def test_the_target_is_dug_out(
    blind_scenario: Scenario, tiny_heap: Heap
) -> None:
    found = run_search(build_search_diagram(blind_scenario, heap=tiny_heap))
    assert found.end == "success"
    names = {TARGET, *found.objects}
    for action in found.actions:
        assert action.segment.startswith("segment_")
        assert action.segment == action.grasp.object
        assert action.object in names
        # Here the detector is never wrong.
        assert action.is_target == (action.object == TARGET)
    lifted = [a.object for a in found.actions if a.outcome is Outcome.LIFTED]
    assert "book" in lifted[:-1]  # it lay on the target
    assert lifted[-1] == TARGET
    assert len(set(lifted)) == len(lifted)
    data = found.to_dict()
    assert json.loads(json.dumps(data)) == data


def test_every_object_is_grasped_where_it_is(
    blind_scenario: Scenario, tiny_heap: Heap
) -> None:
    """Names of the masks are true here, and grasps from depth."""
    blind_scenario.perception.segmenter = "ground_truth"
    diagram = build_search_diagram(blind_scenario, heap=tiny_heap)
    context = diagram.CreateDefaultContext()
    policy = diagram.GetSubsystemByName("search_policy")
    body = diagram.GetSubsystemByName("grasped_body")
    inputs = body.GetMyContextFromRoot(context)
    kinds = {"book": GraspKind.SUCTION, "block": None, "plank": None}
    grasps = policy.grasps(policy.GetMyContextFromRoot(context), list(kinds))
    for name, kind in kinds.items():
        grasp = grasps[name]
        assert grasp.quality > 0.3
        assert kind in (None, grasp.kind)
        body.GetInputPort("action").FixValue(
            inputs, SearchAction(number=1, grasp=grasp)
        )
        on = body.GetOutputPort("action").Eval(inputs).grasp
        assert on.object == name
        X_WO = tiny_heap.poses[name]
        np.testing.assert_allclose(X_WO @ on.X_OG, grasp.X_WG, atol=1e-3)


@pytest.mark.parametrize("policy", ["combined", "oracle", "random"])
def test_every_kind_of_policy_plans_from_depth(
    blind_scenario: Scenario, tiny_heap: Heap, policy: str
) -> None:
    """With memory and outlook, with truth, and with neither."""
    blind_scenario.policy.name = policy
    blind_scenario.horizon = 2
    diagram = build_search_diagram(blind_scenario, heap=tiny_heap)
    system = diagram.GetSubsystemByName("search_policy")
    assert not system.HasInputPort("body_poses")
    assert diagram.AreConnected(
        diagram.GetSubsystemByName("depth_sensor").GetOutputPort("depth_image"),
        system.GetInputPort("seen_depth_image"),
    )
    record = run_search(diagram)
    assert record.actions
    for action in record.actions:
        assert action.grasp
        assert action.object in {TARGET, *record.objects}
