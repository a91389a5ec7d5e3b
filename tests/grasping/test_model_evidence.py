"""Evidence of models, and how it judges grasps."""

import numpy as np
import pytest

from tests.grasping.depth_scenes import model_block as block
from tests.poses import at, downwards
from xray_drake.grasping.candidates import EQUAL_QUALITY
from xray_drake.grasping.evidence import model as module
from xray_drake.grasping.evidence.model import ModelEvidence
from xray_drake.grasping.judgement import GRAVITY
from xray_drake.grasping.perturbation import PerturbationConfig, perturb
from xray_drake.grasping.planner import GraspPlanner
from xray_drake.messages import Grasp, GraspKind
from xray_drake.seeding import stream

FLAT = block("flat", 0.042, 0.021, 0.005)
PLATE = block("plate", 0.08, 0.08, 0.01)
HEAVY = block("heavy", 0.03, 0.03, 0.03, density=16_000)
CUBE = block("cube", 0.03, 0.03, 0.03)
LYING = {"flat": at(0, 0, 0.0025), "plate": at(0, 0, 0.005)}


def model_planner(objects, **options):
    return GraspPlanner(ModelEvidence(objects, **options))


@pytest.fixture(scope="module")
def planner():
    return model_planner([FLAT, PLATE, HEAVY], seed=7)


def nominal(planner, grasp, poses, **changes):
    arguments = {"X_WG_perturbed": grasp.X_WG, "friction": 0.5} | changes
    return planner.judge(grasp, poses, **arguments)


def jaw_on(name, z, width):
    """A grasp straight down on an object at the origin."""
    X_WG = downwards(0, 0, z)
    return Grasp(GraspKind.JAW, name, X_WG, width=width, quality=1.0)


def test_beside_the_wall_and_in_the_corner(planner):
    poses = {"plate": at(0.205, 0.155, 0.005), "flat": at(0, -0.185, 0.0025)}
    for name in poses:
        assert planner.plan(name, poses)


@pytest.mark.parametrize(
    ("name", "X_WO"),
    [
        ("flat", at(0.02, 0.01, 0.0025)),
        ("plate", at(0.05, 0, 0.005)),
        ("cube", at(0, 0, 0.015, yaw=0.3)),
    ],
)
def test_no_plan_hangs_on_the_last_digit_of_a_pose(name, X_WO):
    planner = model_planner([FLAT, PLATE, CUBE], seed=7)
    grasp = planner.plan(name, {name: X_WO}).grasp
    assert grasp
    for seed in range(4):
        other = X_WO.copy()
        rng = np.random.default_rng(seed)
        other[:3] += 1e-13 * rng.normal(size=(3, 4))
        again = planner.plan(name, {name: other}).grasp
        assert again.kind is grasp.kind
        np.testing.assert_allclose(again.X_WG, grasp.X_WG, atol=1e-4)


def test_grasps_and_the_cloud_that_judges_them_are_drawn_apart(monkeypatch):
    """Else the cloud tends to lie where the grasps do."""
    asked = []

    def recorded(seed, purpose, *numbers):
        asked.append((seed, purpose, *numbers))
        return stream(seed, purpose, *numbers)

    monkeypatch.setattr(module, "stream", recorded)
    model_planner([FLAT]).plan("flat", {"flat": at(0, 0, 0.0025)})
    drawn = [names for names in asked if names[1] != "rehearsal"]
    assert len(drawn) == len(set(drawn)) == 2


@pytest.mark.parametrize(("factor", "lifted"), [(1.05, True), (0.95, False)])
def test_a_heavy_box_slips_below_the_friction_it_needs(planner, factor, lifted):
    """Two pads hold 2 μ F; the axis passes through the centre of mass."""
    evidence = planner.evidence
    force = evidence.gripper.spec.force
    friction = factor * HEAVY.mass * GRAVITY / (2 * force)
    # The middle of the pads, 2 mm behind the origin, at the centre of mass.
    grasp = jaw_on("heavy", 0.015 - 0.002, 0.03)
    raised = at(0, 0, evidence.config.judgement.overtravel) @ grasp.X_WG
    poses = {"heavy": at(0, 0, 0.015)}
    judged = nominal(
        planner, grasp, poses, X_WG_perturbed=raised, friction=friction
    )
    assert (judged.quality > 0) == lifted
    assert ("holds" in judged.reason) != lifted


JAW = jaw_on("flat", 0.0035, 0.021)
CUP = Grasp(GraspKind.SUCTION, "plate", downwards(0, 0, 0.01), quality=1.0)


@pytest.mark.parametrize(
    ("grasp", "shift", "reason"),
    [
        (JAW, (0, 0, 0), ""),
        (JAW, (0.05, 0, 0), "misses"),
        (JAW, (0, 0, 0.012), "misses"),
        (JAW, (0, 0, -0.015), "hits floor"),
        # 2 mm overtravel and 4 mm bellows reach up, 4 + 6 mm give way down.
        (CUP, (0.03, 0, 0), "seal"),
        (CUP, (0, 0, 0.008), "reach"),
        (CUP, (0, 0, 0.005), ""),
        (CUP, (0, 0, -0.008), ""),
        (CUP, (0, 0, -0.012), "too early"),
    ],
)
def test_what_a_displaced_gripper_meets(planner, grasp, shift, reason):
    poses = {grasp.object: LYING[grasp.object]}
    X_WG = at(*shift) @ grasp.X_WG
    judged = nominal(planner, grasp, poses, X_WG_perturbed=X_WG)
    assert (judged.quality > 0) == (reason == "")
    assert reason in judged.reason


def test_the_jaw_stops_at_the_floor(planner):
    poses = {"flat": LYING["flat"]}
    grasp = planner.plan("flat", poses).grasp
    X_WG = at(0, 0, -0.003) @ grasp.X_WG
    judged = nominal(planner, grasp, poses, X_WG_perturbed=X_WG)
    assert judged.quality > 0
    assert judged.X_WG[2, 3] == pytest.approx(0.0035, abs=1e-4)


def test_a_jaw_that_closes_on_a_neighbour_fails():
    """A wire beside the target, inside the opening and outside the contacts."""
    planner = model_planner([FLAT, block("wire", 0.03, 0.002, 0.005)])
    alone = {"flat": LYING["flat"]}
    assert nominal(planner, JAW, alone).quality > 0
    between = alone | {"wire": at(0, 0.0105 + 0.003, 0.0025)}
    judged = nominal(planner, JAW, between)
    assert judged.quality == 0
    assert "closes on wire" in judged.reason


def test_no_grasp_cannot_be_judged(planner):
    with pytest.raises(ValueError, match="no grasp"):
        nominal(planner, Grasp(), {})
    with pytest.raises(KeyError):
        planner.plan("flat", {"plate": at(0, 0, 0.005)})


def test_most_perturbed_grasps_on_a_thin_box_succeed(planner):
    poses = {"flat": LYING["flat"]}
    grasp = planner.plan("flat", poses).grasp
    rng = np.random.default_rng(0)
    lifted = 0
    for _ in range(60):
        X, mu = perturb(grasp, rng, PerturbationConfig())
        judged = nominal(planner, grasp, poses, X_WG_perturbed=X, friction=mu)
        lifted += judged.quality > 0
    assert 0.8 * 60 <= lifted < 60


def test_the_only_grasp_is_taken_however_weak():
    """A cup over the centre of mass holds 14 N, and no perturbed one does."""
    side, weight = 0.06, 13.995
    weak = block("weak", *[side] * 3, density=weight / GRAVITY / side**3)
    grasp = model_planner([weak]).plan("weak", {"weak": at(0, 0, 0.03)}).grasp
    assert grasp.kind is GraspKind.SUCTION
    assert 0 < grasp.quality < EQUAL_QUALITY


def test_plans_follow_from_seed_and_heap_alone():
    poses = {"flat": at(0, 0.05, 0.0025, yaw=1.0), "plate": at(0, -0.05, 0.005)}
    first = model_planner([FLAT, PLATE], seed=3)
    second = model_planner([PLATE, FLAT], seed=3)
    second.plan("plate", poses)
    a = first.plan("flat", poses).grasp
    b = second.plan("flat", poses).grasp
    np.testing.assert_array_equal(a.X_WG, b.X_WG)
    assert (a.width, a.quality) == (b.width, b.quality)
    other = ModelEvidence([FLAT], seed=4).samples("flat")[0]
    own = first.evidence.samples("flat")[0]
    assert not np.array_equal(own.first, other.first)
