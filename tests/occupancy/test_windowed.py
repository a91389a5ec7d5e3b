from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from tests.nominal import BIN
from tests.occupancy.networks import OPTIONS, card, randomized
from tests.occupancy.scenes import make_camera
from xray_drake.occupancy.learned.build import build_network
from xray_drake.occupancy.learned.compact import OUTPUTS
from xray_drake.occupancy.learned.inference import (
    LearnedInference,
    load_inference,
)
from xray_drake.occupancy.learned.inputs import geometry_input, size_features
from xray_drake.occupancy.learned.weights import WeightsError, save_weights
from xray_drake.occupancy.learned.window import target_window
from xray_drake.occupancy.learned.windowed import WindowedNet

CAMERA = make_camera(
    size=(256, 192), focal_length=276, center=(128, 95), tilt=5, azimuth=40
)
SIZE = np.array([0.04, 0.03, 0.005])
PARTS = {"whole": OPTIONS, "near": {**OPTIONS, "depths": [2, 1, 1, 1]}}
CARD = card(architecture="windowed", options=PARTS)


def network() -> WindowedNet:
    torch.manual_seed(0)
    net = build_network("windowed", PARTS)
    assert isinstance(net, WindowedNet)
    return randomized(net)


def scene(*, seen: bool) -> tuple[np.ndarray, np.ndarray]:
    depth = CAMERA.plane_depth(0.0)
    depth[60:120, 90:150] = CAMERA.plane_depth(0.04)[60:120, 90:150]
    mask = np.zeros(CAMERA.shape, bool)
    mask[84:90, 150:154] = seen
    return depth.astype(np.float32), mask


def asked(part: nn.Module, mask: np.ndarray) -> tuple[torch.Tensor, ...]:
    images = geometry_input(
        scene(seen=True)[0], mask, CAMERA, SIZE[2], BIN.floor
    )
    told = size_features(SIZE, mask, CAMERA)
    return tuple(torch.from_numpy(each)[None] for each in (*images, told))


def infer(net: WindowedNet, *, seen: bool, **options: Any) -> np.ndarray:
    inference = LearnedInference(net, CARD, SIZE, **options)
    return inference.infer(*scene(seen=seen), CAMERA).data


@torch.no_grad()
@pytest.mark.parametrize("output", OUTPUTS)
def test_a_hidden_target_is_sought_in_the_whole_image(output: Any) -> None:
    net = network()
    _, mask = scene(seen=False)
    expected = torch.sigmoid(net.whole(*asked(net.whole, mask)))
    channel = OUTPUTS.index(output)
    np.testing.assert_allclose(
        infer(net, seen=False, output=output), expected[0, channel], atol=1e-5
    )


@torch.no_grad()
@pytest.mark.parametrize("output", OUTPUTS)
def test_one_that_is_seen_is_sought_in_its_window(output: Any) -> None:
    net = network()
    _, mask = scene(seen=True)
    fine, coarse, told = asked(net.near, mask)
    window = target_window(mask, told[0].numpy())
    assert window.width < CAMERA.width
    part = torch.sigmoid(
        net(
            torch.from_numpy(window.of(fine.numpy()).copy()),
            torch.from_numpy(window.of_coarse(coarse.numpy()).copy()),
            told,
        )
    )
    expected = np.zeros(CAMERA.shape, np.float32)
    channel = OUTPUTS.index(output)
    expected[window.rows, window.columns] = part[0, channel]
    data = infer(net, seen=True, output=output)
    assert np.ptp(window.of(data)) > 0.3
    np.testing.assert_allclose(data, expected, atol=2e-3)


def test_weights_of_both_parts_are_read(tmp_path: Path) -> None:
    net = network()
    path = tmp_path / "windowed.safetensors"
    save_weights(path, net.state_dict(), CARD)
    loaded = load_inference(path, target_size=SIZE)
    for seen in (False, True):
        data = loaded.infer(*scene(seen=seen), CAMERA).data
        np.testing.assert_allclose(data, infer(net, seen=seen), atol=0.05)
    state = {k: v for k, v in net.state_dict().items() if "near." not in k}
    save_weights(path, state, CARD)
    with pytest.raises(WeightsError, match="does not fit this version's"):
        load_inference(path, target_size=SIZE)
