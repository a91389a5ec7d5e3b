import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from xray_drake.grasping.candidates import (
    EQUAL_QUALITY,
    by_score,
    in_groups,
    is_among,
    quality_ranks,
)
from xray_drake.grasping.evidence import model as module
from xray_drake.grasping.evidence.model import ModelEvidence
from xray_drake.grasping.judgement import GRAVITY
from xray_drake.grasping.perturbation import PerturbationConfig, perturb
from xray_drake.grasping.planner import GraspPlanner
from xray_drake.messages import Grasp, GraspKind
from xray_drake.scene.object_model import object_from_pieces
from xray_drake.seeding import stream


def model_planner(objects, **options):
    return GraspPlanner(ModelEvidence(objects, **options))


def block(name, *extents, density=600.0):
    return object_from_pieces(
        name, [trimesh.creation.box(extents)], density=density
    )


def at(x, y, z, yaw=0.0):
    X = np.eye(4)
    X[:3, :3] = Rotation.from_euler("z", yaw).as_matrix()
    X[:3, 3] = x, y, z
    return X


FLAT = block("flat", 0.042, 0.021, 0.005)
PLATE = block("plate", 0.08, 0.08, 0.01)
HEAVY = block("heavy", 0.03, 0.03, 0.03, density=16_000)
CUBE = block("cube", 0.03, 0.03, 0.03)
ROOF = block("roof", 0.2, 0.2, 0.01)


@pytest.fixture(scope="module")
def planner():
    return model_planner([FLAT, PLATE, HEAVY, ROOF], seed=7)


def nominal(planner, grasp, poses, **changes):
    arguments = {"X_WG_perturbed": grasp.X_WG, "friction": 0.5} | changes
    return planner.judge(grasp, poses, **arguments)


@settings(max_examples=10, deadline=None)
@given(
    x=st.floats(-0.15, 0.15),
    y=st.floats(-0.10, 0.10),
    yaw=st.floats(-np.pi, np.pi),
)
def test_a_thin_box_on_the_floor_is_grasped_from_above(planner, x, y, yaw):
    poses = {"flat": at(x, y, 0.0025, yaw)}
    grasp = planner.plan("flat", poses).grasp
    assert grasp.kind is GraspKind.JAW
    assert grasp.object == "flat"
    assert grasp.quality > 0.3
    X = grasp.X_WG
    np.testing.assert_allclose(X[:3, :3] @ X[:3, :3].T, np.eye(3), atol=1e-9)
    assert X[2, 2] < -0.7
    # The tips, 3 mm beyond the origin, are above the floor but below the top.
    assert 0.003 <= X[2, 3] < 0.008
    np.testing.assert_allclose(poses["flat"] @ grasp.X_OG, X, atol=1e-12)
    # It is squeezed near its middle, across one of its sides.
    assert np.linalg.norm(grasp.X_OG[:2, 3]) < 0.015
    assert min(abs(grasp.width - side) for side in (0.021, 0.042)) < 0.002
    assert nominal(planner, grasp, poses).quality > 0


def test_a_plate_too_wide_for_the_jaw_is_sucked(planner):
    poses = {"plate": at(0.05, 0, 0.005)}
    grasp = planner.plan("plate", poses).grasp
    assert grasp.kind is GraspKind.SUCTION
    assert grasp.width == 0.0
    np.testing.assert_allclose(grasp.X_WG[:3, 2], [0, 0, -1], atol=1e-9)
    assert grasp.X_WG[2, 3] == pytest.approx(0.010, abs=1e-6)
    assert nominal(planner, grasp, poses).quality > 0


def test_beside_the_wall_and_in_the_corner(planner):
    poses = {"plate": at(0.205, 0.155, 0.005), "flat": at(0, -0.185, 0.0025)}
    for name in poses:
        assert planner.plan(name, poses)


def test_nothing_under_a_roof(planner):
    poses = {"flat": at(0, 0, 0.0025), "roof": at(0, 0, 0.03)}
    assert planner.plan("flat", poses).grasp.kind is GraspKind.NONE
    assert planner.plan("roof", poses)
    del poses["roof"]
    assert planner.plan("flat", poses)


def test_nothing_between_high_posts(planner):
    """They stand 1 mm from all four sides: no room for a fingertip."""
    tight = [
        object_from_pieces(
            f"wall_{i}", [trimesh.creation.box(size)], density=500.0
        )
        for i, size in enumerate(
            [[0.02, 0.12, 0.10]] * 2 + [[0.12, 0.02, 0.1]] * 2
        )
    ]
    dx, dy = 0.021 + 0.011, 0.0105 + 0.011
    poses = {
        "flat": at(0, 0, 0.0025),
        "wall_0": at(dx, 0, 0.05),
        "wall_1": at(-dx, 0, 0.05),
        "wall_2": at(0, dy, 0.05),
        "wall_3": at(0, -dy, 0.05),
    }
    planner = model_planner([FLAT, *tight])
    assert not planner.plan("flat", poses)
    assert planner.plan("flat", {"flat": poses["flat"]})


def test_a_plan_says_why_candidates_failed(planner):
    """Each kind's commonest reason first; of the weak ones the strongest."""
    plan = planner.plan("plate", {"plate": at(0, 0, 0.005)})
    reasons = {(r.kind, r.reason): r.candidates for r in plan.rejections}
    assert reasons[GraspKind.JAW, "too wide"] > 20
    assert reasons[GraspKind.SUCTION, "cup does not seal"] > 20
    counts = [r.candidates for r in plan.rejections if r.kind is GraspKind.JAW]
    assert counts == sorted(counts, reverse=True)

    under = {"flat": at(0, 0, 0.0025), "roof": at(0, 0, 0.03)}
    hit = {r.reason for r in planner.plan("flat", under).rejections}
    assert "jaw hits roof" in hit

    iron = block("iron", 0.08, 0.08, 0.03, density=7800)
    plan = model_planner([iron]).plan("iron", {"iron": at(0, 0, 0.015)})
    assert "holds 14.00 of 14.69 N" in plan.why_not(9)

    first = planner.plan("plate", {"plate": at(0, 0, 0.005)}).grasp
    again = planner.plan("plate", {"plate": at(0, 0, 0.005)}, excluded=[first])
    assert "failed before" in again.why_not(9)


@pytest.mark.parametrize("name", ["flat", "plate"])
def test_excluded_grasps_are_not_returned(planner, name):
    poses = {name: at(0.02, 0.01, 0.0025 if name == "flat" else 0.005, 0.3)}
    excluded = []
    for _ in range(4):
        grasp = planner.plan(name, poses, excluded=excluded).grasp
        assert grasp
        assert not is_among(
            excluded, grasp.kind, grasp.X_OG, position=0.005, angle=0.175
        )
        excluded.append(grasp)


def test_plans_follow_from_seed_and_heap_alone():
    poses = {"flat": at(0, 0.05, 0.0025, 1.0), "plate": at(0, -0.05, 0.005)}
    first = model_planner([FLAT, PLATE], seed=3)
    second = model_planner([PLATE, FLAT], seed=3)
    second.plan("plate", poses)
    a = first.plan("flat", poses).grasp
    b = second.plan("flat", poses).grasp
    np.testing.assert_array_equal(a.X_WG, b.X_WG)
    assert (a.width, a.quality) == (b.width, b.quality)
    other = ModelEvidence([FLAT], seed=4).samples("flat")[0]
    assert not np.array_equal(
        first.evidence.samples("flat")[0].first, other.first
    )


@pytest.mark.parametrize(
    ("name", "X_WO"),
    [
        ("flat", at(0.02, 0.01, 0.0025)),
        ("plate", at(0.05, 0, 0.005)),
        ("cube", at(0, 0, 0.015, 0.3)),
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
    poses = {"heavy": at(0, 0, 0.015)}
    needed = (
        HEAVY.mass * GRAVITY / (2 * planner.evidence.gripper.parameters.force)
    )
    X_WG = np.diag([1.0, -1.0, -1.0, 1.0])
    # The middle of the pads, 2 mm behind the origin, at the centre of mass.
    X_WG[2, 3] = 0.015 - 0.002
    grasp = Grasp(GraspKind.JAW, "heavy", X_WG, width=0.03, quality=1.0)
    raised = X_WG.copy()
    raised[2, 3] += planner.evidence.config.judgement.overtravel
    judged = nominal(
        planner, grasp, poses, X_WG_perturbed=raised, friction=factor * needed
    )
    assert (judged.quality > 0) == lifted
    assert ("holds" in judged.reason) != lifted


def test_a_cup_cannot_hold_more_than_its_vacuum():
    planner = model_planner(
        [
            block("light", 0.08, 0.08, 0.02),
            block("iron", 0.08, 0.08, 0.03, density=7800),
        ]
    )
    poses = {"light": at(0.1, 0, 0.01), "iron": at(-0.1, 0, 0.015)}
    assert planner.plan("light", poses).grasp.kind is GraspKind.SUCTION
    assert planner.plan("iron", poses).grasp.kind is GraspKind.NONE


@pytest.mark.parametrize(
    ("shift", "reason"),
    [
        ((0.05, 0, 0), "misses"),
        ((0, 0, 0.012), "misses"),
        ((0, 0, -0.015), "hits floor"),
    ],
)
def test_what_a_displaced_jaw_meets(planner, shift, reason):
    poses = {"flat": at(0, 0, 0.0025)}
    down = np.diag([1.0, -1.0, -1.0, 1.0])
    down[2, 3] = 0.0035
    grasp = Grasp(GraspKind.JAW, "flat", down, width=0.021, quality=1.0)
    assert nominal(planner, grasp, poses).quality > 0
    X_WG = down.copy()
    X_WG[:3, 3] += shift
    judged = nominal(planner, grasp, poses, X_WG_perturbed=X_WG)
    assert judged.quality == 0
    assert reason in judged.reason


def test_the_jaw_stops_at_the_floor(planner):
    poses = {"flat": at(0, 0, 0.0025)}
    grasp = planner.plan("flat", poses).grasp
    X_WG = grasp.X_WG.copy()
    X_WG[2, 3] -= 0.003
    judged = nominal(planner, grasp, poses, X_WG_perturbed=X_WG)
    assert judged.quality > 0
    assert judged.X_WG[2, 3] == pytest.approx(0.0035, abs=1e-4)


def test_a_jaw_that_closes_on_a_neighbour_fails():
    """A wire beside the target, inside the opening and outside the contacts."""
    wire = block("wire", 0.03, 0.002, 0.005)
    planner = model_planner([FLAT, wire])
    alone = {"flat": at(0, 0, 0.0025)}
    X_WG = np.diag([1.0, -1.0, -1.0, 1.0])
    X_WG[2, 3] = 0.0035
    grasp = Grasp(GraspKind.JAW, "flat", X_WG, width=0.021, quality=1.0)
    assert nominal(planner, grasp, alone).quality > 0
    between = alone | {"wire": at(0, 0.0105 + 0.003, 0.0025)}
    judged = nominal(planner, grasp, between)
    assert judged.quality == 0
    assert "closes on wire" in judged.reason


@pytest.mark.parametrize(
    ("shift", "reason"),
    [
        ((0.03, 0, 0), "seal"),
        ((0, 0, 0.008), "reach"),
        ((0, 0, 0.005), ""),
        ((0, 0, -0.008), ""),
        ((0, 0, -0.012), "too early"),
    ],
)
def test_what_a_displaced_cup_meets(planner, shift, reason):
    """2 mm overtravel and 4 mm bellows reach up, 4 + 6 mm give way down."""
    poses = {"plate": at(0, 0, 0.005)}
    X_WG = np.diag([1.0, -1.0, -1.0, 1.0])
    X_WG[:3, 3] = np.array([0, 0, 0.01]) + shift
    grasp = Grasp(GraspKind.SUCTION, "plate", X_WG, quality=1.0)
    judged = nominal(planner, grasp, poses)
    assert (judged.quality > 0) == (reason == "")
    assert reason in judged.reason


def test_no_grasp_cannot_be_judged(planner):
    with pytest.raises(ValueError, match="no grasp"):
        nominal(planner, Grasp(), {})
    with pytest.raises(KeyError):
        planner.plan("flat", {"plate": at(0, 0, 0.005)})


def test_most_perturbed_grasps_on_a_thin_box_succeed(planner):
    poses = {"flat": at(0, 0, 0.0025)}
    grasp = planner.plan("flat", poses).grasp
    rng = np.random.default_rng(0)
    lifted = 0
    for _ in range(60):
        X_WG, friction = perturb(grasp, rng, PerturbationConfig())
        judged = planner.judge(
            grasp, poses, X_WG_perturbed=X_WG, friction=friction
        )
        lifted += judged.quality > 0
    assert 0.8 * 60 <= lifted < 60


def test_perturbations_have_the_size_asked_for():
    grasp = Grasp(GraspKind.JAW, "x", at(0.1, 0.2, 0.3, 0.5))
    config = PerturbationConfig(friction=0.1)
    rng = np.random.default_rng(0)
    poses, frictions = zip(
        *[perturb(grasp, rng, config) for _ in range(2000)], strict=True
    )
    shift = np.array([X[:3, 3] - grasp.X_WG[:3, 3] for X in poses])
    np.testing.assert_allclose(shift.std(axis=0), 0.0025, rtol=0.1)
    angle = [
        Rotation.from_matrix(X[:3, :3] @ grasp.X_WG[:3, :3].T).magnitude()
        for X in poses
    ]
    assert np.sqrt(np.mean(np.square(angle))) == pytest.approx(0.05, rel=0.1)
    assert min(frictions) > 0.05
    still = PerturbationConfig(
        position_sigma=0.0, angle_sigma=0.0, friction_sigma=0.0
    )
    X_WG, friction = perturb(grasp, rng, still)
    np.testing.assert_allclose(X_WG, grasp.X_WG)
    assert friction == 0.5


def test_a_half_turn_is_the_same_jaw_but_not_a_quarter():
    grasp = Grasp(GraspKind.JAW, "x", X_OG=at(0, 0, 0))
    options = {"position": 0.005, "angle": 0.175}
    for yaw, same in [(0, True), (np.pi, True), (np.pi / 2, False)]:
        X_OG = at(0.001, 0, 0, yaw)
        assert is_among([grasp], GraspKind.JAW, X_OG, **options) == same
    far = at(0.006, 0, 0)
    assert not is_among([grasp], GraspKind.JAW, far, **options)
    assert not is_among([grasp], GraspKind.SUCTION, at(0, 0, 0), **options)


def test_each_group_has_its_best_first():
    score = np.array([0.9, 0.8, 0.1, 0.7, 0.2])
    group = np.array([0, 0, 1, 0, 1])
    np.testing.assert_array_equal(in_groups(score, group), [0, 4, 1, 2, 3])
    assert len(in_groups(score[:0], group[:0])) == 0


def test_scores_that_differ_by_rounding_keep_their_order():
    score = np.array([0.3, 0.1 + 0.2, 0.7, 0.3 - 1e-16])
    assert by_score(score).tolist() == [2, 0, 1, 3]
    first = np.array([0, 1, 1, 0])
    assert by_score(score, first).tolist() == [0, 3, 2, 1]


@given(st.lists(st.floats(0, 1), max_size=12).map(np.array))
def test_ranks_of_qualities(quality):
    """None is better than one of a higher rank, but for what is equal; and in
    one rank all are equal to the highest."""
    ranks = quality_ranks(quality)
    assert sorted(set(ranks.tolist())) == list(range(len(set(ranks.tolist()))))
    for rank in set(ranks.tolist()):
        own = quality[ranks == rank]
        assert np.ptp(own) <= EQUAL_QUALITY + 1e-12
        assert (quality[ranks > rank] < own.max() - EQUAL_QUALITY).all()


def test_the_only_grasp_is_taken_however_weak():
    """A cup over the centre of mass holds 14 N, and no perturbed one does."""
    side, weight = 0.06, 13.995
    weak = block("weak", *[side] * 3, density=weight / GRAVITY / side**3)
    grasp = model_planner([weak]).plan("weak", {"weak": at(0, 0, 0.03)}).grasp
    assert grasp.kind is GraspKind.SUCTION
    assert 0 < grasp.quality < EQUAL_QUALITY
