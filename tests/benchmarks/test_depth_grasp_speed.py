"""Time of one grasp from a 512×384 depth image; at most 150 ms on one core.

    OMP_NUM_THREADS=1 pytest tests/benchmarks/test_depth_grasp_speed.py \
        -o addopts="--import-mode=importlib" --benchmark-only
"""

import time
from collections.abc import Iterator

import cv2
import numpy as np
import pytest
import trimesh
from pytest_benchmark.fixture import BenchmarkFixture

from tests.grasping.depth_scenes import block, clutter, see
from tests.occupancy.scenes import CAMERAS
from tests.poses import at
from xray_drake.grasping.evidence.depth import DepthEvidence, SeenObject
from xray_drake.grasping.planner import GraspPlanner

# Time of the one thread's core, lest other processes on it count.
pytestmark = pytest.mark.benchmark(timer=time.process_time)

CAMERA = CAMERAS["tilted"]


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    yield
    cv2.setNumThreads(threads)


def time_plan(
    benchmark: BenchmarkFixture, meshes: list[trimesh.Trimesh]
) -> None:
    depth, mask = see(CAMERA, *meshes)
    planner = GraspPlanner(DepthEvidence())
    seen = SeenObject(mask, depth, CAMERA)
    grasp = benchmark(planner.plan, "it", seen)
    assert grasp.quality > 0


def test_a_thin_box_alone(benchmark: BenchmarkFixture) -> None:
    time_plan(benchmark, [block([0.042, 0.021, 0.005], at(0, 0, 0.0025))])


def test_a_large_plate_alone(benchmark: BenchmarkFixture) -> None:
    time_plan(benchmark, [block([0.12, 0.08, 0.01], at(0, 0, 0.005))])


@pytest.mark.parametrize("seed", [0, 3, 4])
def test_a_block_in_a_heap(benchmark: BenchmarkFixture, seed: int) -> None:
    rng = np.random.default_rng(seed)
    time_plan(benchmark, clutter(rng, 14, spread=0.08))
