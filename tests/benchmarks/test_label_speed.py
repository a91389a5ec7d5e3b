"""Time of one label, 512×384, all candidates; at most 30 ms on one core.

    OMP_NUM_THREADS=1 pytest tests/benchmarks/test_label_speed.py \
        -o addopts="--import-mode=importlib" --benchmark-only
"""

import time

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from tests.occupancy.brute_force import render
from tests.occupancy.label_scenes import (
    lid_over,
    pose_target,
    render_target,
    walls,
)
from tests.occupancy.scenes import CAMERAS, occluders
from xray_drake.occupancy.label.ground_truth import Label, occupancy_label

# Time of the one thread's core, lest other processes on it count.
pytestmark = pytest.mark.benchmark(timer=time.process_time)

NAMES = ["box_1to1", "box_10to1", "lid", "flute"]
# The lowest camera sees the targets largest.
CAMERA = CAMERAS["low"]


def measure(
    benchmark: BenchmarkFixture,
    target: np.ndarray,
    p_WT: np.ndarray,
    scene: np.ndarray,
) -> Label:
    occupancy_label(target, scene, CAMERA, p_WT)  # compiles
    label = benchmark(occupancy_label, target, scene, CAMERA, p_WT)
    if benchmark.stats is not None:
        assert benchmark.stats.stats.median < 0.030
    return label


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    ("scene", "least"),
    [("empty bin", 0), ("heap", 100), ("full bin", 20_000)],
)
def test_hidden(
    benchmark: BenchmarkFixture, name: str, scene: str, least: int
) -> None:
    """In a full bin every candidate within it is accepted."""
    mesh, p_WT = pose_target(name, np.array([0.02, 0.01]), 0.4, 0.0, 0.9)
    depth = CAMERA.plane_depth(0.05).astype(np.float32)
    if scene != "full bin":
        rng = np.random.default_rng(0)
        number = 30 if scene == "heap" else 0
        others = occluders(rng, number, np.zeros(2), 0.06, 0.017)
        depth, _ = render(CAMERA, [*walls(), lid_over(mesh, 0.01), *others])
    label = measure(benchmark, render_target(CAMERA, mesh), p_WT, depth)
    assert label.accepted.sum() > least
    assert scene == "full bin" or not label.modal.any()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("share", [0.995, 1.0])
def test_leaning_in_a_full_bin(
    benchmark: BenchmarkFixture, name: str, share: float
) -> None:
    """A surface as high as the target: each pixel has to be compared."""
    tilt = np.deg2rad(40)
    mesh, p_WT = pose_target(name, np.array([0.02, 0.01]), 0.4, tilt, 0.9)
    target = render_target(CAMERA, mesh)
    height = share * mesh.bounds[1, 2]
    scene = CAMERA.plane_depth(height).astype(np.float32)
    scene[np.isfinite(target)] = 0.3
    assert not measure(benchmark, target, p_WT, scene).modal.any()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("shift", [0.4, 0.8, 10.0])
def test_seen(benchmark: BenchmarkFixture, name: str, shift: float) -> None:
    """A fragment, much, and all of it."""
    mesh, p_WT = pose_target(name, np.array([0.02, 0.01]), 0.4, 0.0, 0.9)
    rng = np.random.default_rng(1)
    others = occluders(rng, 12, np.array([-0.1, 0.1]), 0.03, 0.017)
    plate = lid_over(mesh, 0.0)
    plate.apply_translation([shift * mesh.extents[0], 0, 0])
    scene, _ = render(CAMERA, [*walls(), plate, *others])
    label = measure(benchmark, render_target(CAMERA, mesh), p_WT, scene)
    assert label.modal.any()
