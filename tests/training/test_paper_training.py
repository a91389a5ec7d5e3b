"""The paper's training, on a few small images and mostly a small network."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors.torch
import torch
from torch import Tensor, nn

from tests.dataset.whole import tiny_dataset
from xray_drake.dataset.reader import OccupancyDataset, is_held_out
from xray_drake.dataset.sample import Sample, depth_on_disk
from xray_drake.dataset.virtual import virtual_sample
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.occupancy.learned import build
from xray_drake.occupancy.learned.fcn_resnet50 import FCNResNet50
from xray_drake.occupancy.learned.inference import load_inference
from xray_drake.occupancy.learned.weights import WeightsError, read_card
from xray_drake.occupancy.metrics import PixelCounts, pixel_counts
from xray_drake.training.beginning import load_backbone
from xray_drake.training.box import box_size
from xray_drake.training.config import (
    TrainConfig,
    TrainingError,
    load_config,
)
from xray_drake.training.data import PassSampler, TrainingData
from xray_drake.training.paper import PaperTraining, input_mean, paper_items
from xray_drake.training.prepare import (
    PrepareConfig,
    open_prepared,
    plan,
    prepare_shard,
)
from xray_drake.training.run import CHECKPOINT, WEIGHTS, RunOptions, train

_SHAPE = (64, 96)
_HEAPS = 12
_SIZES = {
    "box_2to1": (0.0424, 0.0212, 0.005),
    "box_5to1": (0.0671, 0.0134, 0.005),
}


def _sample(heap_seed: int, target_name: str) -> Sample:
    """A target on the floor beside a plate."""
    height, width = _SHAPE
    camera = PinholeCamera(
        width=width,
        height=height,
        intrinsics=np.array([[105, 0, 47.5], [0, 105, 31.5], [0, 0, 1.0]]),
        X_WC=np.array(
            [[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.8], [0, 0, 0, 1]]
        ),
    )
    rng = np.random.default_rng(heap_seed)
    size = np.array(_SIZES[target_name])
    X_WT = np.eye(4)
    X_WT[:3, 3] = *rng.uniform(-0.05, 0.05, 2), size[2] / 2

    def around(center: np.ndarray, sides: Any, top: float) -> np.ndarray:
        p_W = camera.unproject(camera.plane_depth(top))[..., :2]
        return np.all(np.abs(p_W - center[:2]) <= np.array(sides) / 2, axis=-1)

    amodal = around(X_WT[:3, 3], size[:2], size[2])
    plate = around(X_WT[:3, 3] + [0.03, 0, 0], (0.05, 0.12), 0.03)
    modal = amodal & ~plate
    without = np.where(plate, camera.plane_depth(0.03), 0.8)
    depth = np.where(modal, camera.plane_depth(size[2]), without)
    occupancy = np.where(amodal, 1.0, np.where(plate, 0.4, 0.0))
    return Sample(
        depth=depth_on_disk(depth),
        depth_without_target=depth_on_disk(without),
        target_modal=modal,
        target_amodal=amodal,
        instances=np.where(modal, 1, np.where(plate, 2, 0)).astype(np.uint8),
        occupancy=occupancy,
        intrinsics=camera.intrinsics,
        X_WC=camera.X_WC,
        X_WT=X_WT,
        target_size=size,
        object_names=("plate",),
        target_name=target_name,
        heap_seed=heap_seed,
        view=0,
        num_dropped=1,
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve heaps with each of two boxes; of 0.3, two heaps are held out."""
    names = tuple(_SIZES)
    return tiny_dataset(
        tmp_path_factory.mktemp("dataset"),
        lambda i: _sample(i // len(names), names[i % len(names)]),
        2 * _HEAPS,
        shard_size=8,
        targets=names,
        seed=3,
    )


class _Small(nn.Module):
    """As the paper's network, seen from outside."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 4, 3, padding=1)
        self.classifier = nn.Conv2d(4, 1, 1)

    def forward(self, image: Tensor) -> Tensor:
        return self.classifier(torch.relu(self.conv1(image)))


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(build.ARCHITECTURES, "fcn_resnet50", _Small)


def _config(**changes: Any) -> TrainConfig:
    """The paper's, of an epoch of two steps."""
    return dataclasses.replace(
        load_config("paper"),
        **{
            "passes": 0.4,
            "items_per_epoch": 4,
            "batch_size": 2,
            "validation_share": 0.3,
            **changes,
        },
    )


def _train(folder: Path, out: Path, config: TrainConfig, **options: Any) -> Any:
    return train(
        [folder],
        config,
        RunOptions(
            out=out, workers=0, accelerator="cpu", progress=False, **options
        ),
    )


def _items(
    folder: Path, images: Any, target: str = "box_2to1"
) -> OccupancyDataset:
    return OccupancyDataset(
        folder, images=images, validation_share=0.3, targets=[target]
    )


def _data(*folders: Path, **changes: Any) -> TrainingData:
    config = _config(**changes)
    return TrainingData(*paper_items(folders, config), config, workers=0)


def _weights(path: Path) -> dict[str, Tensor]:
    return safetensors.torch.load_file(path / WEIGHTS)


def test_the_papers_numbers() -> None:
    config = load_config("paper")
    assert config.architecture == "fcn_resnet50"
    assert config.input == "augmented_depth"
    assert config.targets == ["box_2to1"]
    assert (config.optimizer, config.loss) == ("sgd", "mse")
    assert config.learning_rate == 1e-5
    assert config.momentum == 0.99
    assert config.weight_decay == 0.0005
    assert config.passes == 40
    assert config.validation_share == 0.2
    assert config.label_scale == 255
    assert not config.flips
    assert build.build_network(config.architecture, config.options)


def test_a_run(folder: Path, tmp_path: Path, small: None) -> None:
    card = _train(folder, tmp_path / "run", _config())
    assert card == read_card(tmp_path / "run" / WEIGHTS)
    assert card.architecture == "fcn_resnet50"
    assert card.input == "augmented_depth"
    assert card.targets == ("box_2to1",)
    assert card.box_size == _SIZES["box_2to1"]
    held_out = sum(is_held_out(seed, 0.3) for seed in range(_HEAPS))
    assert held_out == 2
    assert card.data["items to train on"] == _HEAPS - held_out
    assert card.data["items held out"] == held_out
    assert card.training["optimizer steps"] == 2
    assert card.training["label_scale"] == 255
    assert card.training["learning_rate"] == 1e-5
    assert not {"prepare", "virtual", "posterior_weight"} & set(card.training)
    images = _items(folder, "train")
    mean = torch.stack([item["input"] for item in images]).mean(dim=(0, 2, 3))
    np.testing.assert_allclose(card.training["input_mean"], mean, rtol=1e-5)
    figures = card.figures["held-out heaps, full resolution"]
    assert set(figures) == {
        "validation/loss",
        "validation/balanced_accuracy",
        "validation/iou",
    }


class _Guess(nn.Module):
    """Sees the target, and guesses under what is high."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 1, 1)
        nn.init.zeros_(self.conv1.bias)
        nn.init.constant_(self.conv1.weight, -320)
        self.conv1.weight.data[:, 0] = 200

    def forward(self, image: Tensor) -> Tensor:
        return self.conv1(image)


def test_the_logged_metrics_are_those_of_inference(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(build.ARCHITECTURES, "fcn_resnet50", _Guess)
    card = _train(folder, tmp_path, _config(learning_rate=1e-12))
    inference = load_inference(
        tmp_path / WEIGHTS,
        target_size=np.array(_SIZES["box_2to1"]),
        scaling=False,
    )
    items = _items(folder, "validation")
    counts = PixelCounts()
    for index in range(len(items)):
        sample = items.sample(index)
        found = inference.infer(
            sample.depth, sample.target_modal, sample.camera
        )
        answer = found.data
        assert answer.shape == _SHAPE
        assert answer.max() > 0.5
        counts += pixel_counts(sample.occupancy, answer)
    assert 0 < counts.iou < 1
    figures = card.figures["held-out heaps, full resolution"]
    assert figures["validation/iou"] == pytest.approx(counts.iou, abs=2e-3)
    assert figures["validation/balanced_accuracy"] == pytest.approx(
        counts.balanced_accuracy, abs=2e-3
    )


def test_the_steps_are_stochastic_gradient_descents(
    folder: Path, tmp_path: Path, small: None
) -> None:
    config = _config()
    _train(folder, tmp_path, config)
    items = _items(folder, "train")
    mean = torch.stack([item["input"] for item in items]).mean(dim=(0, 2, 3))
    torch.manual_seed(config.seed)
    net = _Small()
    optimizer = torch.optim.SGD(
        net.parameters(), 1e-5, momentum=0.99, weight_decay=0.0005
    )
    order = list(PassSampler(len(items), 4, config.seed))
    for step in range(2):
        batch = [items[index] for index in order[2 * step : 2 * step + 2]]
        image = torch.stack([item["input"] for item in batch])
        label = torch.stack([item["occupancy"] for item in batch])
        answer = net(image - mean[:, None, None])
        optimizer.zero_grad()
        torch.mean((answer - 255 * label) ** 2).backward()
        optimizer.step()
    trained = _weights(tmp_path)
    for name, value in net.state_dict().items():
        torch.testing.assert_close(trained[name], value, rtol=1e-4, atol=1e-5)


def test_a_run_that_is_resumed_ends_as_one_that_is_not(
    folder: Path, tmp_path: Path, small: None
) -> None:
    once = _train(folder, tmp_path / "once", _config(passes=0.8))
    _train(folder, tmp_path / "twice", _config())
    with pytest.raises(TrainingError, match="--resume"):
        _train(folder, tmp_path / "twice", _config())
    card = _train(folder, tmp_path / "twice", _config(passes=0.8), resume=True)
    assert card.training["optimizer steps"] == 4
    assert card.training["input_mean"] == once.training["input_mean"]
    first, second = _weights(tmp_path / "once"), _weights(tmp_path / "twice")
    for name, value in first.items():
        assert torch.equal(value, second[name])
    with pytest.raises(TrainingError, match="nothing to resume"):
        _train(folder, tmp_path / "none", _config(), resume=True)
    assert not (tmp_path / "none" / CHECKPOINT).exists()


def test_a_step_of_the_real_network(folder: Path) -> None:
    torch.manual_seed(0)
    data = _data(folder)
    net = FCNResNet50()
    mean = input_mean(data.train_items, _config())
    module = PaperTraining(net, _config(), 1, mean)
    module.log = lambda *args, **kwargs: None  # type: ignore[method-assign]
    optimizer = module.configure_optimizers()
    batch = next(iter(data.train_dataloader()))
    assert batch["input"].shape == (2, 3, *_SHAPE)
    before = {name: p.detach().clone() for name, p in net.named_parameters()}
    losses = []
    for index in range(2):
        loss = module.training_step(batch, index)
        losses.append(loss.item())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert losses[1] < losses[0]
    # About the mean square of the label in bytes.
    assert 1e2 < losses[0] < 255**2
    for name, parameter in net.named_parameters():
        assert torch.isfinite(parameter).all()
        assert not torch.equal(parameter, before[name]), name


def test_the_mean_is_of_as_many_images_as_are_said(folder: Path) -> None:
    items = _items(folder, "train")
    every = input_mean(items, _config())
    some = [
        input_mean(items, _config(input_mean_images=3, seed=seed))
        for seed in (1, 1, 2)
    ]
    assert torch.equal(some[0], some[1])
    assert not torch.equal(some[0], some[2])
    assert not torch.equal(some[0], every)
    torch.testing.assert_close(some[0], every, rtol=0.2, atol=0.05)


def test_heaps_are_on_one_side(folder: Path) -> None:
    data = _data(folder, folder, targets=[])
    sides = [
        {key.heap_seed for part in items.datasets for key in part.keys}
        for items in (data.train_items, data.validation_items)
    ]
    assert sides[0] & sides[1] == set()
    assert len(sides[0] | sides[1]) == _HEAPS
    assert data.num_train == 2 * 2 * len(sides[0])
    assert data.num_validation == 2 * 2 * len(sides[1])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"targets": ["box_9to1"]}, "no sample is to train on"),
        ({"validation_share": 1e-9}, "no sample is held out"),
        ({"validation_share": 1 - 1e-9}, "no sample is to train on"),
    ],
)
def test_too_little_data(
    folder: Path, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(TrainingError, match=message):
        _data(folder, **changes)


def test_image_and_label_are_flipped_together(folder: Path) -> None:
    config = _config(flips=True)
    data = _data(folder)
    batch = next(iter(data.train_dataloader()))
    batch["occupancy"] = batch["input"][:, :1]
    seen = []

    class Echo(nn.Module):
        def forward(self, image: Tensor) -> Tensor:
            seen.append(image)
            return 255 * image[:, :1]

    for seed in range(8):
        module = PaperTraining(
            Echo(), dataclasses.replace(config, seed=seed), 1, torch.zeros(3)
        )
        module.log = lambda *args, **kw: None  # type: ignore[method-assign]
        assert module.training_step(batch, 0) == 0
    different = {image.numpy().tobytes() for image in seen}
    assert 1 < len(different) <= 4
    module = PaperTraining(Echo(), _config(), 1, torch.zeros(3))
    assert module.flipped_axes() == []


def _backbone(**changes: Tensor) -> dict[str, Tensor]:
    return {
        "conv1.weight": torch.randn(4, 3, 3, 3),
        "conv1.bias": torch.randn(4),
        "fc.weight": torch.randn(5, 4),
        **changes,
    }


def test_a_backbone_is_loaded(
    folder: Path, tmp_path: Path, small: None
) -> None:
    path = tmp_path / "resnet50.safetensors"
    state = _backbone()
    safetensors.torch.save_file(state, path)
    torch.manual_seed(0)
    net = _Small()
    head = net.classifier.weight.detach().clone()
    load_backbone(net, path)
    assert torch.equal(net.conv1.weight, state["conv1.weight"])
    assert torch.equal(net.classifier.weight, head)
    config = _config(backbone=str(path), learning_rate=1e-12)
    card = _train(folder, tmp_path / "run", config)
    assert card.training["backbone"] == str(path)
    torch.testing.assert_close(
        _weights(tmp_path / "run")["conv1.weight"], state["conv1.weight"]
    )
    # What is resumed needs it no more.
    path.unlink()
    config.passes = 0.8
    _train(folder, tmp_path / "run", config, resume=True)


def test_the_real_backbone_has_torchvisions_names(tmp_path: Path) -> None:
    source, net = FCNResNet50(), FCNResNet50()
    state = {
        # As in older weights, without counters.
        name: value.half()
        for name, value in source.state_dict().items()
        if "classifier" not in name and "num_batches" not in name
    }
    assert "layer4.2.bn3.running_var" in state
    state["fc.weight"], state["fc.bias"] = torch.ones(10, 8), torch.ones(10)
    safetensors.torch.save_file(state, tmp_path / "resnet50.safetensors")
    load_backbone(net, tmp_path / "resnet50.safetensors")
    assert torch.equal(
        net.layer4[2].conv3.weight, state["layer4.2.conv3.weight"]
    )


def _write(changes: dict[str, Tensor | None]) -> Callable[[Path], None]:
    state = {k: v for k, v in _backbone(**changes).items() if v is not None}
    return lambda path: safetensors.torch.save_file(state, path)


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (lambda path: None, "no backbone can be read"),
        (lambda path: torch.save(_backbone(), path), "no backbone can be read"),
        (_write({"conv1.bias": None}), "it lacks conv1.bias"),
        (_write({"layer9.weight": torch.ones(1)}), "it has layer9.weight"),
        (_write({"classifier.bias": torch.ones(1)}), "it has classifier.bias"),
        (_write({"conv1.bias": torch.ones(3)}), r"\(3,\), not \(4,\)"),
    ],
)
def test_no_backbone(
    write: Callable[[Path], None], message: str, tmp_path: Path
) -> None:
    path = tmp_path / "resnet50.safetensors"
    write(path)
    net = _Small()
    before = net.conv1.weight.detach().clone()
    with pytest.raises(WeightsError, match=message) as error:
        load_backbone(net, path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)
    assert torch.equal(net.conv1.weight, before)


@pytest.mark.parametrize("ratio", [1, 2, 5, 10])
def test_the_networks_of_a_box(ratio: int) -> None:
    config = load_config(f"compact_{ratio}to1")
    assert config.targets == [f"box_{ratio}to1"]
    length, width, thickness = config.prepare.virtual_size
    assert length == pytest.approx(0.03 * ratio**0.5, abs=1e-5)
    assert width == pytest.approx(0.03 / ratio**0.5, abs=1e-5)
    assert thickness == 0.005
    net = build.build_network(config.architecture, config.options)
    assert sum(p.numel() for p in net.parameters()) < 500_000


def test_the_size_of_the_box(folder: Path) -> None:
    size = _SIZES["box_5to1"]

    def found(targets: list[str], *virtual: float) -> Any:
        config = TrainConfig(
            targets=targets, prepare=PrepareConfig(virtual_size=[*virtual])
        )
        return box_size([folder], config)

    assert found(["box_5to1"]) == size
    assert found(["box_5to1"], 0.067, 0.0134, 0.005) == size
    assert found([]) is None
    assert found(["box_2to1", "box_5to1"]) is None
    assert found(["lid"]) is None
    assert found(["box_3to1"]) is None
    with pytest.raises(TrainingError, match="box_5to1 in the dataset is"):
        found(["box_5to1"], 0.03, 0.03, 0.005)


def test_a_compact_network_of_a_box(folder: Path, tmp_path: Path) -> None:
    size = np.array(_SIZES["box_5to1"])
    made = virtual_sample(
        _sample(1, "box_2to1"), np.random.default_rng(0), size=size
    )
    assert made is not None
    np.testing.assert_array_equal(made.target_size, size)
    assert made.target_name == "virtual_box_67x13x5"

    config = dataclasses.replace(
        load_config("compact_5to1"),
        options={"widths": [8, 8, 8, 8], "depths": [1, 1, 1, 1]},
        passes=0.1,
        items_per_epoch=4,
        batch_size=2,
        validation_share=0.3,
        precision="32-true",
    )
    cache = tmp_path / "cache"
    cache.mkdir()
    jobs = plan([folder], cache, config.prepare, 0.3)
    for job in jobs:
        prepare_shard(*job, config.prepare, 0.3)
    shards = [open_prepared(path) for _, path in jobs]
    virtual = {
        name
        for shard in shards
        for name, real in zip(shard.targets, shard.real, strict=True)
        if not real
    }
    assert virtual == {"virtual_box_67x13x5"}

    card = _train(folder, tmp_path / "run", config, cache=cache)
    assert card.box_size == tuple(size)
    assert card.training["prepare"]["virtual_size"] == [0.06708, 0.01342, 0.005]
    assert "backbone" not in card.training
    # One of a folder is chosen by its box.
    inference = load_inference(
        tmp_path / "run", target_size=np.array([0.12, 0.024, 0.01])
    )
    sample = _sample(0, "box_5to1")
    found = inference.infer(sample.depth, sample.target_modal, sample.camera)
    assert found.data.shape == _SHAPE


def test_items_made_before_keep_their_names(folder: Path) -> None:
    """A cache outlives keys that change nothing."""
    config = PrepareConfig()
    names = {
        plan([folder], Path("cache"), each, 0.3)[0][1].name
        for each in (config, PrepareConfig(virtual_size=[]))
    }
    assert len(names) == 1
    other = PrepareConfig(virtual_size=[0.03, 0.03, 0.005])
    assert plan([folder], Path("cache"), other, 0.3)[0][1].name not in names
