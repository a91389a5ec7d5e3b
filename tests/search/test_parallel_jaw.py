"""Searches with a gripper that has a wider jaw and no suction cup."""

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator

from tests.alone import Alone
from tests.gripper.cells import block, take
from tests.nominal import TOTE
from tests.poses import at
from tests.search.watching import TARGET, Watcher
from xray_drake.cell.gripper import CellGripper, load_gripper
from xray_drake.drawing.meshcat_layers import start_meshcat
from xray_drake.grasping.evidence.depth import DepthEvidence, SeenObject
from xray_drake.grasping.evidence.model import ModelEvidence
from xray_drake.grasping.perturbation import PerturbationConfig
from xray_drake.grasping.planner import GraspPlanner
from xray_drake.gripper.controller import GripperController
from xray_drake.gripper.mounted import add_gripper
from xray_drake.messages import GraspKind, Outcome
from xray_drake.scene.heap import Heap
from xray_drake.scene.targets import target_model
from xray_drake.search.diagram import build_search_diagram
from xray_drake.search.rollout import run_search
from xray_drake.station.scenario import Scenario
from xray_drake.testing.tiny import Observation

WIDE = block((0.12, 0.065, 0.05), 0.3, "wide")
"""No less wide than 50 mm wherever a jaw from above takes it."""


@pytest.fixture
def scenario(tiny_scenario: Scenario) -> Scenario:
    tiny_scenario.cell.gripper = CellGripper("parallel_85")
    return tiny_scenario


@pytest.fixture
def heap() -> Heap:
    """A wide block, and the target beside it."""
    return Heap(
        target=target_model(TARGET),
        objects=(WIDE,),
        poses={"wide": at(0.02, -0.03, 0.025), TARGET: at(0.1, 0.1, 0.0025)},
        seed=7,
        num_dropped=1,
        attempts=1,
        settle_time=0.0,
    )


def test_wider_than_50_mm_is_for_the_wider_jaw_alone() -> None:
    poses = {"wide": at(0.02, -0.03, 0.025)}
    grasps = {
        name: GraspPlanner(
            ModelEvidence(
                [WIDE],
                gripper=load_gripper(name, {"cup_radius": 0}),
                seed=1,
            )
        ).find_grasps("wide", poses)
        for name in ("yumi", "parallel_85")
    }
    assert not grasps["yumi"]
    assert grasps["parallel_85"]
    for grasp in grasps["parallel_85"]:
        assert grasp.kind is GraspKind.JAW
        assert 0.064 < grasp.width < 0.085


def test_depth_tells_of_no_suction_either(
    recorded_observation: Observation,
) -> None:
    seen = recorded_observation
    planner = GraspPlanner(
        DepthEvidence(gripper=load_gripper("parallel_85"), seed=1)
    )
    found = 0
    for label in seen.label_of.values():
        known = SeenObject(seen.labels == label, seen.depth, seen.camera)
        plan = planner.plan("it", known)
        found += bool(plan.grasp)
        assert plan.grasp.kind is not GraspKind.SUCTION
        assert all(r.kind is GraspKind.JAW for r in plan.rejections)
    assert found > 1


@pytest.mark.parametrize("execution", ["quasi_static", "contact"])
def test_it_brings_a_wide_block_to_the_tote(
    scenario: Scenario, heap: Heap, execution: str
) -> None:
    scenario.gripper.execution = execution
    exact = PerturbationConfig(position_sigma=0.0, angle_sigma=0.0)
    scenario.gripper.quasi_static.perturbation = exact
    scenario.policy.name = "largest"
    scenario.horizon = 1
    watcher = Watcher()
    diagram = build_search_diagram(scenario, heap=heap)
    record = run_search(diagram, observers=(watcher,))
    (action,) = record.actions
    assert (action.object, action.outcome) == ("wide", Outcome.LIFTED)
    assert action.grasp.kind is GraspKind.JAW
    assert action.grasp.width == pytest.approx(0.065, abs=2e-3)
    assert TOTE.holds(watcher.poses[-1]["wide"][:3, 3])
    names = {system.get_name() for system in diagram.GetSystems()}
    assert "suction_cup" not in names


def test_by_contact_it_refuses_a_suction_grasp(scenario: Scenario) -> None:
    plant = MultibodyPlant(0.005)
    gripper = add_gripper(plant, cell=scenario.cell)
    plant.Finalize()
    controller = Alone(
        GripperController(gripper=gripper),
        carrier_state=np.r_[gripper.carrier.home, np.zeros(6)],
        finger_state=np.zeros(4),
        action=take(GraspKind.SUCTION, "wide", (0.0, 0.0, 0.05)),
    )
    status = controller.advance_to(0.1)
    assert status.outcome is Outcome.FAILED
    assert status.reason == "the gripper has no suction cup"


def test_by_contact_it_is_shown_without_a_seal_light(
    scenario: Scenario, heap: Heap
) -> None:
    scenario.gripper.execution = "contact"
    meshcat = start_meshcat()
    diagram = build_search_diagram(scenario, heap=heap, meshcat=meshcat)
    assert not diagram.HasSubsystemNamed("seal_light")
    Simulator(diagram).Initialize()
    gripper = diagram.station.gripper
    assert gripper is not None
    assert gripper.X_BC is None
    assert meshcat.HasPath(f"/drake/{gripper.meshcat_path}")
    np.testing.assert_allclose(gripper.finger_travel, 0.0425)
