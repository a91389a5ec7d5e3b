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
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.occupancy.label.ground_truth import Label, occupancy_label

# Time of the one thread's core, lest other processes on it count.
pytestmark = pytest.mark.benchmark(timer=time.process_time)

NAMES = ["box_1to1", "box_10to1", "lid", "flute"]
# The lowest camera sees the targets largest.
CAMERA = CAMERAS["low"]


def posed(
    name: str, tilt: float = 0.0
) -> tuple[np.ndarray, PinholeCamera, np.ndarray, list]:
    mesh, p_WT = pose_target(name, np.array([0.02, 0.01]), 0.4, tilt, 0.9)
    return render_target(CAMERA, mesh), CAMERA, p_WT, [mesh]


def measure(
    benchmark: BenchmarkFixture, name: str, scene: np.ndarray, tilt: float = 0.0
) -> Label:
    target, camera, p_WT, _ = posed(name, tilt)
    occupancy_label(target, scene, camera, p_WT)  # compiles
    label = benchmark(occupancy_label, target, scene, camera, p_WT)
    if benchmark.stats is not None:
        assert benchmark.stats.stats.median < 0.030
    return label


@pytest.mark.parametrize("name", NAMES)
def test_hidden_in_an_empty_bin(benchmark: BenchmarkFixture, name: str) -> None:
    _, _, _, (mesh,) = posed(name)
    scene, _ = render(CAMERA, [*walls(), lid_over(mesh, 0.015)])
    label = measure(benchmark, name, scene)
    assert not label.modal.any()


@pytest.mark.parametrize("name", NAMES)
def test_hidden_in_a_heap(benchmark: BenchmarkFixture, name: str) -> None:
    rng = np.random.default_rng(0)
    _, _, _, (mesh,) = posed(name)
    others = occluders(rng, 30, np.zeros(2), 0.06, 0.017)
    scene, _ = render(CAMERA, [*walls(), lid_over(mesh, 0.01), *others])
    label = measure(benchmark, name, scene)
    assert label.accepted.sum() > 100


@pytest.mark.parametrize("name", NAMES)
def test_hidden_in_a_full_bin(benchmark: BenchmarkFixture, name: str) -> None:
    """Every candidate within the bin is accepted."""
    scene = CAMERA.plane_depth(0.05).astype(np.float32)
    label = measure(benchmark, name, scene)
    assert label.accepted.sum() > 20_000


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("share", [0.995, 1.0])
def test_leaning_in_a_full_bin(
    benchmark: BenchmarkFixture, name: str, share: float
) -> None:
    """A surface as high as the target: each pixel has to be compared."""
    tilt = np.deg2rad(40)
    target, _, _, (mesh,) = posed(name, tilt)
    height = share * mesh.bounds[1, 2]
    scene = CAMERA.plane_depth(height).astype(np.float32)
    scene[np.isfinite(target)] = 0.3
    label = measure(benchmark, name, scene, tilt)
    assert not label.modal.any()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("shift", [0.4, 0.8, 10.0])
def test_seen(benchmark: BenchmarkFixture, name: str, shift: float) -> None:
    """A fragment, much, and all of it."""
    _, _, _, (mesh,) = posed(name)
    rng = np.random.default_rng(1)
    others = occluders(rng, 12, np.array([-0.1, 0.1]), 0.03, 0.017)
    plate = lid_over(mesh, 0.0)
    plate.apply_translation([shift * mesh.extents[0], 0, 0])
    scene, _ = render(CAMERA, [*walls(), plate, *others])
    label = measure(benchmark, name, scene)
    assert label.modal.any()
