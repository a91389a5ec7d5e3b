"""Time of exact inference for one 512×384 image, all orientations.

    OMP_NUM_THREADS=1 pytest tests/benchmarks/test_exact_speed.py \
        -o addopts="--import-mode=importlib" --benchmark-only
"""

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from tests.occupancy.brute_force import render
from tests.occupancy.scenes import CAMERAS, lying, occluders
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.occupancy.geometric.inference import GeometricInference
from xray_drake.scene.object_model import ObjectModel
from xray_drake.scene.targets import target_model

NAMES = ["box_2to1", "box_10to1", "lid", "flute"]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    ("scene", "least"), [("heap", 1), ("full bin", 90_000)]
)
def test_hidden(
    benchmark: BenchmarkFixture, name: str, scene: str, least: int
) -> None:
    camera = CAMERAS["nominal" if scene == "full bin" else "tilted"]
    depth = camera.plane_depth(0.05).astype(np.float32)
    if scene == "heap":
        rng = np.random.default_rng(0)
        heap = occluders(rng, 14, np.zeros(2), 0.045, 0.017)
        depth, _ = render(camera, heap)
    nothing = np.zeros(camera.shape, bool)
    inference = GeometricInference(target_model(name))
    result = benchmark(inference.infer, depth, nothing, camera)
    assert result.support_size() >= least


def partly_seen(
    name: str, share: str
) -> tuple[ObjectModel, np.ndarray, np.ndarray, PinholeCamera]:
    """Returns a target, depth, the target's mask and the camera."""
    camera = CAMERAS["tilted"]
    target = target_model(name)
    mesh = lying(target.visual, 0.02, 0.01, 0.4)
    length = target.extents[0]
    rng = np.random.default_rng(1)
    others = occluders(rng, 10, np.array([-0.02, 0.07]), 0.03, 0.017)
    plate = others[0].copy()
    plate.vertices = mesh.bounding_box.vertices
    plate.faces = mesh.bounding_box.faces
    shift = 0.3 * length if share == "fragment" else 0.6 * length
    plate.apply_translation([shift * np.cos(0.4), shift * np.sin(0.4), 0.02])
    depth, label = render(camera, [mesh, plate, *others])
    return target, depth, label == 0, camera


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("share", ["much", "fragment"])
@pytest.mark.parametrize("method", ["geometric", "geometric_label"])
def test_partly_seen(
    benchmark: BenchmarkFixture, name: str, share: str, method: str
) -> None:
    target, depth, mask, camera = partly_seen(name, share)
    inference = GeometricInference(target, method=method)
    result = benchmark(inference.infer, depth, mask, camera)
    assert result.support_size() >= np.count_nonzero(mask)
    assert result.data.max() > 0.8
