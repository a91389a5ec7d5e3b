"""Time of learned inference, 512×384, on two threads; the paper: 6 ms a GPU.

    pytest tests/benchmarks/test_network_speed.py \
        -o addopts="--import-mode=importlib" --benchmark-only
"""

import numpy as np
import pytest
import torch
from pytest_benchmark.fixture import BenchmarkFixture

from tests.occupancy.brute_force import render
from tests.occupancy.scenes import CAMERAS, occluders
from xray_drake.choices import DTYPES
from xray_drake.occupancy.learned.build import build_network, channels_last
from xray_drake.occupancy.learned.inference import (
    default_weights,
    load_inference,
)
from xray_drake.occupancy.learned.weights import read_card

SIZE = np.array([0.0424, 0.0212, 0.005])


THREADS = 2


@pytest.mark.parametrize("seen", [False, True], ids=["hidden", "seen"])
@pytest.mark.parametrize("dtype", DTYPES)
def test_inference_of_an_image(
    benchmark: BenchmarkFixture, dtype: str, seen: bool
) -> None:
    camera = CAMERAS["nominal"]
    rng = np.random.default_rng(0)
    depth, _ = render(camera, occluders(rng, 14, np.zeros(2), 0.045, 0.017))
    inference = load_inference(default_weights(), target_size=SIZE, dtype=dtype)
    mask = np.zeros(camera.shape, bool)
    mask[200:206, 250:256] = seen
    answer = benchmark(inference.infer, depth, mask, camera)
    assert answer.data.shape == camera.shape


@pytest.mark.parametrize(
    ("part", "height", "width"), [("whole", 384, 512), ("near", 128, 128)]
)
@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_forward_pass_alone(
    benchmark: BenchmarkFixture,
    dtype: torch.dtype,
    part: str,
    height: int,
    width: int,
) -> None:
    card = read_card(default_weights())
    both = build_network(card.architecture, card.options).fused()  # type: ignore[operator]
    net = channels_last(getattr(both, part).to(dtype))
    fine = torch.rand(1, 2, height, width)
    coarse = torch.rand(1, 3, height // 4, width // 4)
    inputs = [each.to(dtype) for each in (fine, coarse, torch.rand(1, 5))]
    with torch.inference_mode():
        answer = benchmark(net, *inputs)
    assert answer.shape == (1, 2, height, width)
