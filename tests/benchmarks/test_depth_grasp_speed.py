"""Time of one grasp from a 512×384 depth image; at most 150 ms on one core.

    OMP_NUM_THREADS=1 pytest tests/benchmarks/test_depth_grasp_speed.py \
        -o addopts="--import-mode=importlib" --benchmark-only
"""

import time

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from tests.grasping.depth_scenes import block, clutter, see
from tests.occupancy.scenes import CAMERAS
from tests.poses import at
from xray_drake.grasping.evidence.depth import DepthEvidence, SeenObject
from xray_drake.grasping.planner import GraspPlanner

# Time of the one thread's core, lest other processes on it count.
pytestmark = pytest.mark.benchmark(timer=time.process_time)

CAMERA = CAMERAS["tilted"]


SCENES = {
    "thin box": [block([0.042, 0.021, 0.005], at(0, 0, 0.0025))],
    "large plate": [block([0.12, 0.08, 0.01], at(0, 0, 0.005))],
    **{
        f"heap {seed}": clutter(np.random.default_rng(seed), 14, spread=0.08)
        for seed in (0, 3, 4)
    },
}


@pytest.mark.parametrize("scene", SCENES)
def test_a_plan(benchmark: BenchmarkFixture, scene: str) -> None:
    depth, mask = see(CAMERA, *SCENES[scene])
    planner = GraspPlanner(DepthEvidence())
    plan = benchmark(planner.plan, "it", SeenObject(mask, depth, CAMERA))
    assert plan.grasp.quality > 0
