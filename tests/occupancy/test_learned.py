import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from tests.masks import iou
from tests.nominal import BIN
from tests.occupancy.networks import OPTIONS, PAPERS, Mirror, card, compact
from tests.occupancy.scenes import make_camera
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.floor_grid import Floor
from xray_drake.occupancy.learned.augmented_depth import augmented_depth
from xray_drake.occupancy.learned.compact import OUTPUTS, CompactNet
from xray_drake.occupancy.learned.inference import (
    SUPPORT_THRESHOLD,
    LearnedInference,
    load_inference,
)
from xray_drake.occupancy.learned.inputs import (
    COARSE,
    FINE,
    geometry_input,
    size_features,
)
from xray_drake.occupancy.learned.weights import WeightsError, save_weights

WIDTH, HEIGHT = 96, 64
SHAPE = (HEIGHT, WIDTH)
SIZE = np.array([0.06, 0.03, 0.005])
CAMERA = make_camera(
    size=(WIDTH, HEIGHT), focal_length=105, center=(47, 32), tilt=5, azimuth=40
)


def save(path: Path, seed: int = 0, **change: Any) -> Path:
    save_weights(path, compact(seed).state_dict(), card(**change))
    return path


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "network.safetensors"


def scene() -> tuple[np.ndarray, np.ndarray]:
    """A block, a dark corner, and a target of which a part is seen."""
    depth = CAMERA.plane_depth(0.0)
    depth[20:40, 30:60] = CAMERA.plane_depth(0.04)[20:40, 30:60]
    depth[:5, :9] = 0.0
    mask = np.zeros(SHAPE, bool)
    mask[28:33, 60:64] = True
    return depth.astype(np.float32), mask


def by_hand(
    net: CompactNet, output: str, size: np.ndarray = SIZE
) -> np.ndarray:
    """What the network answers to the scene; not fused."""
    depth, mask = scene()
    fine, coarse = geometry_input(depth, mask, CAMERA, size[2], BIN.floor)
    told = size_features(size, mask, CAMERA)
    with torch.no_grad():
        logits = net(
            *(torch.from_numpy(each)[None] for each in (fine, coarse, told))
        )
    return torch.sigmoid(logits)[0, OUTPUTS.index(output)].numpy()


@pytest.mark.parametrize("output", OUTPUTS)
@pytest.mark.parametrize("size", [SIZE, np.array([0.1, 0.08, 0.012])])
@pytest.mark.parametrize(
    ("dtype", "least", "most", "mean"),
    [("float32", 0, 1e-5, 1e-6), ("bfloat16", 1e-3, 0.05, 5e-3)],
)
def test_the_answer_is_that_of_the_network_on_disk(
    path: Path,
    output: Any,
    size: np.ndarray,
    dtype: str,
    least: float,
    most: float,
    mean: float,
) -> None:
    save(path)
    inference = load_inference(
        path, target_size=size, output=output, dtype=dtype
    )
    distribution = inference.infer(*scene(), CAMERA)
    data = distribution.data
    assert data.shape == SHAPE
    assert data.dtype == np.float32
    assert data.min() >= 0
    assert data.max() <= 1
    assert np.ptp(data) > 0.3
    error = np.abs(data - by_hand(compact(), output, size))
    assert least <= error.max() < most
    assert error.mean() < mean
    assert distribution.support_threshold == SUPPORT_THRESHOLD == 0.02
    assert distribution.method == {"occupancy": "learned"}.get(output, output)
    again = inference.infer(*scene(), CAMERA)
    np.testing.assert_array_equal(again.data, data)


@pytest.mark.parametrize(
    ("of", "settings", "words"),
    [
        ({}, {"dtype": "float16"}, "'float16': float32, bfloat16"),
        (PAPERS, {"dtype": "bfloat16"}, "fcn_resnet50 computes in float32"),
        ({}, {"output": "both"}, "no output is called 'both': occupancy, post"),
        (PAPERS, {"output": "posterior"}, "fcn_resnet50 has no posterior"),
    ],
)
def test_what_a_network_has_not_got(
    of: dict[str, Any], settings: dict[str, Any], words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        LearnedInference(Mirror(), card(**of), SIZE, **settings)


@pytest.mark.parametrize("box_size", [None, (0.03, 0.03, 0.005)])
def test_inputs_and_network_stay_as_they_are(box_size: Any) -> None:
    net = compact().train()
    before = {name: t.clone() for name, t in net.state_dict().items()}
    depth, mask = scene()
    depth.setflags(write=False)
    mask.setflags(write=False)
    size = np.array([0.12, 0.03, 0.005])
    inference = LearnedInference(net, card(box_size=box_size), size)
    first = inference.infer(depth, mask, CAMERA).data
    size[:] = 1.0
    np.testing.assert_array_equal(
        inference.infer(depth, mask, CAMERA).data, first
    )
    for name, tensor in net.state_dict().items():
        assert torch.equal(tensor, before[name]), name


def test_the_papers_network_sees_the_augmented_depth_less_its_mean() -> None:
    depth, mask = scene()
    mean = [0.25, -0.5, 1.5]
    net = Mirror(gain=200.0, offset=30.0)
    inference = LearnedInference(
        net,
        card(**PAPERS, training={"input_mean": mean, "label_scale": 255.0}),
        SIZE,
    )
    distribution = inference.infer(depth, mask, CAMERA)
    expected = augmented_depth(depth, mask) - np.reshape(mean, (3, 1, 1))
    np.testing.assert_allclose(net.image[0], expected, atol=1e-6)
    answer = (200 * expected[0] + 30) / 255
    assert answer.min() < 0
    np.testing.assert_allclose(
        distribution.data, np.clip(answer, 0, 1), atol=1e-6
    )
    assert distribution.method == "learned"


@pytest.mark.parametrize("of", [{}, PAPERS], ids=["compact", "papers"])
@pytest.mark.parametrize("factor", [0.6, 1.0, 1.5, 2.0])
@pytest.mark.parametrize("scaling", [True, False])
def test_a_network_of_one_box_sees_every_target_as_large_as_that(
    of: dict[str, Any], factor: float, scaling: bool
) -> None:
    box = (0.042, 0.0214, 0.005)
    size = factor * np.array([0.06, 0.015, 0.01])
    net, made = Mirror(), card(**of, box_size=box)
    inference = LearnedInference(net, made, size, scaling=scaling)
    depth, mask = scene()
    mask[:] = False
    mask[16:36, 30:66] = True
    data = inference.infer(depth, mask, CAMERA).data
    # Where the mirror saw the mask is where it answers.
    assert iou(data > 0.5, mask) > 0.85
    channel = 0 if of else FINE.index("modal")
    share = float(net.image[0, channel].mean()) / mask.mean()
    s = factor if scaling else 1.0
    assert share == pytest.approx(s**-2, rel=0.1)
    if not of:
        # It knows one length and one width, but every thickness.
        told = size_features(np.array([*box[:2], size[2]]), mask, CAMERA)
        np.testing.assert_allclose(net.size[0, :3], told[:3], rtol=1e-6)


@pytest.mark.parametrize("factor", [0.6, 1.6, 2.0])
def test_a_bare_floor_stays_one_when_it_is_scaled(factor: float) -> None:
    """Heights are those of the camera that would have seen the scaled image."""
    net = Mirror()
    size = np.array([factor * 0.06, factor * 0.015, 0.005])
    inference = LearnedInference(
        net, card(box_size=(0.042, 0.0214, 0.005)), size
    )
    depth = CAMERA.plane_depth(0.0).astype(np.float32)
    inference.infer(depth, np.zeros(SHAPE, bool), CAMERA)
    cover = net.image[0, FINE.index("cover")].numpy()
    assert cover.max() == 0
    coarse = dict(zip(COARSE, net.coarse[0].numpy(), strict=True))
    heights = coarse["height"][coarse["reading"] == 1]
    assert np.ptp(heights) < 0.01


def test_a_network_of_all_sizes_sees_the_image_as_it_is() -> None:
    net = Mirror()
    size = np.array([0.12, 0.05, 0.01])
    depth, mask = scene()
    LearnedInference(net, card(), size).infer(depth, mask, CAMERA)
    images = geometry_input(depth, mask, CAMERA, 0.01, BIN.floor)
    np.testing.assert_array_equal(net.image[0], images.fine)
    np.testing.assert_array_equal(net.coarse[0], images.coarse)
    np.testing.assert_array_equal(
        net.size[0], size_features(size, mask, CAMERA)
    )


@pytest.mark.parametrize(
    ("mask", "camera", "words"),
    [
        ((96, 64), CAMERA, r"target mask is \(96, 64\)"),
        ((64, 96), make_camera(size=(96, 40)), r"mask is \(64, 96\)"),
    ],
)
def test_images_of_wrong_shapes(
    mask: tuple[int, int], camera: PinholeCamera, words: str
) -> None:
    inference = LearnedInference(Mirror(), card(), SIZE)
    with pytest.raises(ValueError, match=words) as error:
        inference.infer(np.full(camera.shape, 0.7), np.zeros(mask), camera)
    assert "\n" not in str(error.value)


def test_a_network_is_told_the_floor_of_the_configuration() -> None:
    depth, mask = scene()
    told = []
    for floor in (None, Floor((-0.05, 0.05), (-0.04, 0.04))):
        net = Mirror()
        inference = LearnedInference(net, card(), SIZE, floor=floor)
        inference.infer(depth, mask, CAMERA)
        told.append(net.coarse[0, COARSE.index("floor")])
    assert 0 < told[1].sum() < told[0].sum()


def _message(path: Path, size: np.ndarray = SIZE) -> str:
    with pytest.raises(ValueError) as error:
        load_inference(path, target_size=size).infer(*scene(), CAMERA)
    message = str(error.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"architecture": "unet"}, "'unet': compact, fcn_resnet50, windowed"),
        ({"options": {"width": 3}}, "unexpected keyword argument 'width'"),
        ({"options": {"widths": [8, 8]}}, "unpack"),
        ({"options": {"widths": [8, 8, 8, -8]}}, "negative dimension"),
        ({"options": {**OPTIONS, "depths": [1, 1, 1, 1.5]}}, "float"),
        ({"options": {**OPTIONS, "depths": [1, 1]}}, "index out of range"),
        ({"options": {**OPTIONS, "depths": [1, 1, 1, 2]}}, "state_dict"),
        ({"options": {}}, "state_dict"),
        ({"options": {**OPTIONS, "size_features": 3}}, "state_dict"),
        ({"input": "augmented_depth"}, "forward() missing 2 required"),
    ],
)
def test_weights_of_another_network_are_one_line(
    path: Path, change: dict[str, Any], words: str
) -> None:
    message = _message(save(path, **change))
    assert message.startswith(f"{path} does not fit this version's")
    assert words in message
    assert "train it again with 'xray-drake train'" in message
    with pytest.raises(WeightsError):
        load_inference(path, target_size=SIZE)


def test_a_network_that_is_told_less_of_the_size_is_one_line(
    path: Path,
) -> None:
    made = card(options={**OPTIONS, "size_features": 3})
    save_weights(path, compact(size_features=3).state_dict(), made)
    assert "does not fit this version's 'compact'" in _message(path)


def test_a_target_without_a_size_is_one_line(path: Path) -> None:
    for size in ([0.06, 0.03], [0.06, np.nan, 0.005]):
        message = _message(save(path), np.array(size))
        assert "is no size of a target" in message


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Networks of boxes 1:1, 2:1, 5:1 and 10:1, and one of all sizes."""
    folder = tmp_path_factory.mktemp("networks")
    for ratio in (1, 2, 5, 10):
        box = (0.03 * ratio**0.5, 0.03 / ratio**0.5, 0.005)
        save(folder / f"{ratio}.safetensors", seed=ratio, box_size=box)
    save(folder / "all.safetensors")
    return folder


@pytest.mark.parametrize(
    ("size", "ratio"),
    [
        ((0.060, 0.057, 0.010), 1),  # lid
        ((0.099, 0.03, 0.01), 5),  # 3.3:1, by its logarithm
        ((0.03, 0.15, 0.01), 5),  # width and length swapped
    ],
)
def test_of_a_folder_the_network_of_the_nearest_ratio_is_taken(
    folder: Path, size: tuple[float, float, float], ratio: int
) -> None:
    target = np.array(size)
    inference = load_inference(folder, target_size=target)
    box = inference.card.box_size
    assert box is not None
    assert box[0] / box[1] == pytest.approx(ratio)
    alone = load_inference(
        folder / f"{ratio}.safetensors", target_size=target
    ).infer(*scene(), CAMERA)
    np.testing.assert_array_equal(
        inference.infer(*scene(), CAMERA).data, alone.data
    )
    unscaled = load_inference(folder, target_size=target, scaling=False)
    data = unscaled.infer(*scene(), CAMERA).data
    assert np.abs(data - alone.data).max() > 0.05


def test_a_folder_without_a_network_of_one_box_is_one_line(
    tmp_path: Path,
) -> None:
    assert "holds no network of a single box" in _message(tmp_path)
    save(tmp_path / "all.safetensors")
    assert "holds no network of a single box" in _message(tmp_path)
    (tmp_path / "bad.safetensors").write_bytes(b"rubbish")
    assert f"{tmp_path / 'bad.safetensors'} is not safet" in _message(tmp_path)


def test_a_file_that_was_written_again_is_read_again(path: Path) -> None:
    answers = []
    for seed in (1, 2, 2):
        save(path, seed)
        # Clocks of file systems are coarse.
        os.utime(path, ns=(0, seed * 10**9))
        inference = load_inference(path, target_size=SIZE)
        answers.append(inference.infer(*scene(), CAMERA).data)
    assert np.abs(answers[0] - answers[1]).max() > 0.1
    np.testing.assert_array_equal(answers[1], answers[2])


def test_networks_training_and_virtual_targets_need_no_drake() -> None:
    script = (
        "import sys\n"
        "sys.modules['pydrake'] = None\n"
        "import xray_drake.dataset.virtual\n"
        "assert 'torch' not in sys.modules\n"
        "import xray_drake.occupancy.learned.inference\n"
        "assert 'lightning' not in sys.modules\n"
        "import xray_drake.training.run\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True)
