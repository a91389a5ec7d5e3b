"""The planner, on blocks that are known as models and by a depth image."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.grasping.depth_scenes import block, model_block, see
from tests.occupancy.scenes import CAMERAS
from tests.poses import at
from xray_drake.grasping.candidates import (
    EQUAL_QUALITY,
    by_score,
    in_groups,
    is_among,
    quality_ranks,
)
from xray_drake.grasping.evidence.depth import (
    DepthEvidence,
    DepthPlannerConfig,
    SeenObject,
)
from xray_drake.grasping.evidence.model import ModelEvidence, ModelPlannerConfig
from xray_drake.grasping.perturbation import PerturbationConfig, perturb
from xray_drake.grasping.planner import GraspPlanner
from xray_drake.messages import Grasp, GraspKind

FLAT = (0.042, 0.021, 0.005)
PLATE = (0.08, 0.08, 0.01)


class ByModels:
    """Plans on the first of some blocks, each (extents, 4×4 X_WO)."""

    def __init__(self, camera="nominal", *, density=600.0, seed=3, **config):
        self.density, self.seed = density, seed
        self.config = ModelPlannerConfig(**config)

    def plan(self, *blocks, **options):
        models = [
            model_block(f"block_{i}", *extents, density=self.density)
            for i, (extents, _) in enumerate(blocks)
        ]
        evidence = ModelEvidence(models, config=self.config, seed=self.seed)
        poses = {f"block_{i}": X for i, (_, X) in enumerate(blocks)}
        return GraspPlanner(evidence).plan("block_0", poses, **options)


class ByDepth:
    """The same, by what a camera sees."""

    def __init__(self, camera="nominal", *, density=500.0, seed=3, **config):
        self.camera = CAMERAS[camera]
        self.planner = GraspPlanner(
            DepthEvidence(
                config=DepthPlannerConfig(density=density, **config), seed=seed
            )
        )

    def plan(self, *blocks, **options):
        depth, mask = see(self.camera, *(block(*each) for each in blocks))
        seen = SeenObject(mask, depth, self.camera)
        return self.planner.plan("block_0", seen, **options)


EVIDENCE = pytest.mark.parametrize("known", [ByModels, ByDepth])
ALIKE = {
    ByModels: {"position": 0.005, "angle": 0.175},
    ByDepth: {"position": 0.010, "angle": 0.5},
}


@pytest.mark.parametrize(
    ("known", "camera"),
    [
        (ByModels, ""),
        (ByDepth, "nominal"),
        (ByDepth, "tilted"),
        (ByDepth, "low"),
    ],
)
@settings(max_examples=4)
@given(
    x=st.floats(-0.15, 0.15),
    y=st.floats(-0.10, 0.10),
    yaw=st.floats(-np.pi, np.pi),
)
def test_a_thin_box_on_the_floor_is_grasped_from_above(
    known, camera, x, y, yaw
):
    X_WO = at(x, y, 0.0025, yaw=yaw)
    grasp = known(camera).plan((FLAT, X_WO)).grasp
    assert (grasp.kind, grasp.object) == (GraspKind.JAW, "block_0")
    X = grasp.X_WG
    np.testing.assert_allclose(X[:3, :3] @ X[:3, :3].T, np.eye(3), atol=1e-9)
    assert X[2, 2] < -0.7
    # The tips, 3 mm beyond the origin, are above the floor but below the top.
    assert 0.003 <= X[2, 3] < 0.008
    # It is squeezed across one of its sides.
    assert min(abs(grasp.width - side) for side in FLAT[:2]) < 0.004
    if known is ByModels:
        assert grasp.quality > 0.3
        np.testing.assert_allclose(X_WO @ grasp.X_OG, X, atol=1e-12)
        assert np.linalg.norm(grasp.X_OG[:2, 3]) < 0.015


@pytest.mark.parametrize(
    ("known", "camera"),
    [(ByModels, ""), (ByDepth, "nominal"), (ByDepth, "tilted")],
)
def test_a_plate_too_wide_for_the_jaw_is_sucked(known, camera):
    plan = known(camera).plan((PLATE, at(0.05, 0, 0.005)))
    grasp = plan.grasp
    assert (grasp.kind, grasp.width) == (GraspKind.SUCTION, 0.0)
    assert grasp.quality > 0.5
    np.testing.assert_allclose(grasp.X_WG[:3, 2], [0, 0, -1], atol=0.02)
    np.testing.assert_allclose(grasp.X_WG[:3, 3], [0.05, 0, 0.01], atol=0.006)
    assert "too wide" in plan.why_not()


ROOFS = [((0.2, 0.2, 0.01), at(s * 0.107, 0, 0.05)) for s in (1, -1)]
"""Over a slot too narrow for the fingers."""

POSTS = [
    (size, at(side * x, side * y, 0.05))
    for size, x, y in (
        ((0.02, 0.12, 0.10), 0.021 + 0.011, 0),
        ((0.12, 0.02, 0.10), 0, 0.0105 + 0.011),
    )
    for side in (1, -1)
]
"""They stand 1 mm from all four sides: no room for a fingertip."""


@EVIDENCE
@pytest.mark.parametrize("around", [ROOFS, POSTS], ids=["roofs", "posts"])
def test_nothing_where_the_gripper_has_no_room(known, around):
    flat = FLAT, at(0, 0, 0.0025)
    assert not known().plan(flat, *around)
    assert known().plan(flat)
    if around is ROOFS:
        roof = known().plan(ROOFS[0], flat).grasp
        assert roof.kind is GraspKind.SUCTION


@pytest.mark.parametrize(
    ("known", "scene"),
    [
        (ByModels, (FLAT, at(0.02, 0.01, 0.0025, yaw=0.3))),
        (ByModels, (PLATE, at(0, 0, 0.005))),
        (ByDepth, (FLAT, at(0.02, 0.01, 0.0025, yaw=0.3))),
    ],
)
def test_excluded_grasps_are_not_returned(known, scene):
    excluded = []
    for _ in range(4):
        plan = known().plan(scene, excluded=excluded)
        grasp = plan.grasp
        assert grasp
        assert not is_among(excluded, grasp.kind, grasp.X_OG, **ALIKE[known])
        assert ("failed before" in plan.why_not(9)) == bool(excluded)
        excluded.append(grasp)


@EVIDENCE
@pytest.mark.parametrize(
    ("changes", "extents", "reason"),
    [
        ({"density": 1e5}, PLATE, "suction: "),
        ({"density": 1e5}, PLATE, "holds "),
        ({}, (0.08, 0.02, 0.01), "cup does not seal"),
        ({"max_tilt": 0.1}, FLAT, "approach too tilted"),
    ],
)
def test_a_plan_says_why_candidates_failed(known, changes, extents, reason):
    plan = known(**changes).plan((extents, at(0, 0, 0.5 * extents[2])))
    assert reason in plan.why_not(9)
    for kind in GraspKind:
        counts = [r.candidates for r in plan.rejections if r.kind is kind]
        assert counts == sorted(counts, reverse=True)
        assert all(counts)


def test_of_the_candidates_too_weak_the_strongest_is_told():
    iron = ByModels(density=7800.0)
    plan = iron.plan(((0.08, 0.08, 0.03), at(0, 0, 0.015)))
    assert not plan
    assert "holds 14.00 of 14.69 N" in plan.why_not(9)


def test_perturbations_have_the_size_asked_for():
    grasp = Grasp(GraspKind.JAW, "x", at(0.1, 0.2, 0.3, yaw=0.5))
    config = PerturbationConfig(friction=0.1)
    rng = np.random.default_rng(0)
    drawn = [perturb(grasp, rng, config) for _ in range(2000)]
    error = np.array([X @ np.linalg.inv(grasp.X_WG) for X, _ in drawn])
    shift = np.array([X[:3, 3] for X, _ in drawn]) - grasp.X_WG[:3, 3]
    np.testing.assert_allclose(shift.std(axis=0), 0.0025, rtol=0.1)
    angle = Rotation.from_matrix(error[:, :3, :3]).magnitude()
    assert np.sqrt(np.mean(angle**2)) == pytest.approx(0.05, rel=0.1)
    assert min(friction for _, friction in drawn) > 0.05
    none = PerturbationConfig(
        position_sigma=0.0, angle_sigma=0.0, friction_sigma=0.0
    )
    X_WG, friction = perturb(grasp, rng, none)
    np.testing.assert_allclose(X_WG, grasp.X_WG)
    assert friction == 0.5


@pytest.mark.parametrize(
    ("kind", "X_OG", "same"),
    [
        (GraspKind.JAW, at(0.001), True),
        (GraspKind.JAW, at(0.001, yaw=np.pi), True),
        (GraspKind.JAW, at(0.001, yaw=np.pi / 2), False),
        (GraspKind.JAW, at(0.006), False),
        (GraspKind.SUCTION, at(), False),
    ],
)
def test_a_half_turn_is_the_same_jaw_but_not_a_quarter(kind, X_OG, same):
    grasp = Grasp(GraspKind.JAW, "x", X_OG=at())
    found = is_among([grasp], kind, X_OG, position=0.005, angle=0.175)
    assert found is same


def test_each_group_has_its_best_first():
    score = np.array([0.9, 0.8, 0.1, 0.7, 0.2])
    group = np.array([0, 0, 1, 0, 1])
    assert in_groups(score, group).tolist() == [0, 4, 1, 2, 3]
    assert in_groups(score[:0], group[:0]).tolist() == []


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
