"""The paper's training, on a few small images and mostly a small network."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors.torch
import torch
from torch import Tensor, nn

from tests.dataset.conftest import synthetic_sample
from tests.dataset.whole import tiny_dataset
from tests.training.making import SMALL, prepare_here, train_here
from xray_drake.dataset.sample import Sample
from xray_drake.dataset.virtual import is_virtual
from xray_drake.occupancy.learned import build
from xray_drake.occupancy.learned.fcn_resnet50 import FCNResNet50
from xray_drake.occupancy.learned.inference import load_inference
from xray_drake.occupancy.learned.weights import WeightsError, read_card
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
)
from xray_drake.training.run import WEIGHTS

_SHAPE = (64, 96)
_HEAPS = 12
_SIZES = {
    "box_2to1": (0.0424, 0.0212, 0.005),
    "box_5to1": (0.0671, 0.0134, 0.005),
}


def _sample(heap_seed: int, target_name: str) -> Sample:
    size = _SIZES[target_name]
    return synthetic_sample(
        heap_seed, shape=_SHAPE, target_name=target_name, size=size
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


def _data(*folders: Path, **changes: Any) -> TrainingData:
    config = _config(**changes)
    return TrainingData(*paper_items(folders, config), config, workers=0)


def _train(
    folder: Path, out: Path, *, resume: bool = False, **changes: Any
) -> Any:
    return train_here(folder, out, _config(**changes), workers=0, resume=resume)


def _mean(items: Any) -> Tensor:
    """Of the channels of all images."""
    images = torch.stack([items[i]["input"] for i in range(len(items))])
    return images.mean(dim=(0, 2, 3))


def _weights(path: Path) -> dict[str, Tensor]:
    return safetensors.torch.load_file(path / WEIGHTS)


def test_the_steps_are_stochastic_gradient_descents(
    folder: Path, tmp_path: Path, small: None
) -> None:
    card = _train(folder, tmp_path)
    items: Any = _data(folder).train_items
    mean = _mean(items)
    torch.manual_seed(_config().seed)
    net = _Small()
    optimizer = torch.optim.SGD(
        net.parameters(), 1e-5, momentum=0.99, weight_decay=0.0005
    )
    order = list(PassSampler(len(items), 4, _config().seed))
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
    # And the card says so.
    assert card == read_card(tmp_path / WEIGHTS)
    assert (card.architecture, card.input) == (
        "fcn_resnet50",
        "augmented_depth",
    )
    assert (card.targets, card.box_size) == (("box_2to1",), _SIZES["box_2to1"])
    assert card.data["items to train on"] == len(items) == _HEAPS - 2
    assert card.data["items held out"] == 2
    assert card.training["optimizer steps"] == 2
    assert card.training["label_scale"] == 255
    assert not {"prepare", "virtual", "posterior_weight"} & set(card.training)
    np.testing.assert_allclose(card.training["input_mean"], mean, rtol=1e-5)
    names = {"loss", "balanced_accuracy", "iou"}
    figures = card.figures["held-out heaps, full resolution"]
    assert set(figures) == {f"validation/{name}" for name in names}


def test_a_run_that_is_resumed_ends_as_one_that_is_not(
    folder: Path, tmp_path: Path, small: None
) -> None:
    once = _train(folder, tmp_path / "once", passes=0.8)
    _train(folder, tmp_path / "twice")
    card = _train(folder, tmp_path / "twice", passes=0.8, resume=True)
    assert card.training["optimizer steps"] == 4
    assert card.training["input_mean"] == once.training["input_mean"]
    second = _weights(tmp_path / "twice")
    for name, value in _weights(tmp_path / "once").items():
        assert torch.equal(value, second[name])


def test_a_step_of_the_real_network(folder: Path) -> None:
    """The loss begins at the mean square of the label in bytes, and sinks."""
    torch.manual_seed(0)
    data, net = _data(folder), FCNResNet50()
    module = _module(net, _mean(data.train_items))
    optimizer = module.configure_optimizers()
    batch = next(iter(data.train_dataloader()))
    assert batch["input"].shape == (2, 3, *_SHAPE)
    batch["occupancy"] = torch.full_like(batch["occupancy"], 0.3)
    before = {name: p.detach().clone() for name, p in net.named_parameters()}
    losses = []
    for index in range(2):
        loss = module.training_step(batch, index)
        losses.append(loss.item())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert losses[1] < losses[0] == pytest.approx((0.3 * 255) ** 2, rel=0.1)
    for name, parameter in net.named_parameters():
        assert torch.isfinite(parameter).all()
        assert not torch.equal(parameter, before[name]), name


def _module(net: nn.Module, mean: Tensor, **changes: Any) -> PaperTraining:
    """Without a trainer."""
    module = PaperTraining(net, _config(**changes), 1, mean)
    module.log = lambda *args, **kwargs: None  # type: ignore[method-assign]
    return module


def test_the_mean_is_of_as_many_images_as_are_said(folder: Path) -> None:
    items = _data(folder).train_items
    every = input_mean(items, _config()).float()
    torch.testing.assert_close(every, _mean(items))
    some = [
        input_mean(items, _config(input_mean_images=3, seed=seed)).float()
        for seed in (1, 1, 2)
    ]
    assert torch.equal(some[0], some[1])
    assert not torch.equal(some[0], some[2])
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
    with pytest.raises(TrainingError, match="no sample is to train on"):
        _data(folder, targets=["box_9to1"])


def test_image_and_label_are_flipped_together(folder: Path) -> None:
    batch = next(iter(_data(folder).train_dataloader()))
    batch["occupancy"] = batch["input"][:, :1]
    seen = []

    class Echo(nn.Module):
        def forward(self, image: Tensor) -> Tensor:
            seen.append(image)
            return 255 * image[:, :1]

    for seed in range(8):
        module = _module(Echo(), torch.zeros(3), flips=True, seed=seed)
        assert module.training_step(batch, 0) == 0
    assert 1 < len({image.numpy().tobytes() for image in seen}) <= 4


def _state(net: nn.Module) -> dict[str, Tensor]:
    """A backbone for it, as torchvision's, as older weights are."""
    state = {
        name: value.half()
        for name, value in net.state_dict().items()
        if "classifier" not in name and "num_batches" not in name
    }
    return {**state, "fc.weight": torch.ones(10, 8), "fc.bias": torch.ones(10)}


@pytest.mark.parametrize("kind", [_Small, FCNResNet50])
def test_a_backbone_is_loaded(kind: type[nn.Module], tmp_path: Path) -> None:
    source, net = kind(), kind()
    state = _state(source)
    assert kind is _Small or "layer4.2.bn3.running_var" in state
    safetensors.torch.save_file(state, tmp_path / "resnet50.safetensors")
    before = {k: v.clone() for k, v in net.state_dict().items()}
    load_backbone(net, tmp_path / "resnet50.safetensors")
    for name, value in net.state_dict().items():
        assert torch.equal(value, state.get(name, before[name]).float()), name


def test_a_run_begins_with_a_backbone(
    folder: Path, tmp_path: Path, small: None
) -> None:
    path = tmp_path / "resnet50.safetensors"
    state = _state(_Small())
    safetensors.torch.save_file(state, path)
    change = {"backbone": str(path), "learning_rate": 1e-12}
    card = _train(folder, tmp_path / "run", **change)
    assert card.training["backbone"] == str(path)
    trained = _weights(tmp_path / "run")["conv1.weight"]
    torch.testing.assert_close(trained, state["conv1.weight"].float())
    # What is resumed needs it no more.
    path.unlink()
    _train(folder, tmp_path / "run", resume=True, passes=0.8, **change)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (None, "no backbone can be read"),
        ("rubbish", "no backbone can be read"),
        ({"conv1.bias": None}, "it lacks conv1.bias"),
        ({"layer9.weight": torch.ones(1)}, "it has layer9.weight"),
        ({"classifier.bias": torch.ones(1)}, "it has classifier.bias"),
        ({"conv1.bias": torch.ones(3)}, r"\(3,\), not \(4,\)"),
    ],
)
def test_no_backbone(changes: Any, message: str, tmp_path: Path) -> None:
    path = tmp_path / "resnet50.safetensors"
    net = _Small()
    if isinstance(changes, dict):
        state = {**_state(net), **changes}
        kept = {
            name: value for name, value in state.items() if value is not None
        }
        safetensors.torch.save_file(kept, path)
    elif changes:
        path.write_text(changes)
    before = net.conv1.weight.detach().clone()
    with pytest.raises(WeightsError, match=message) as error:
        load_backbone(net, path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)
    assert torch.equal(net.conv1.weight, before)


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
    config = dataclasses.replace(
        load_config("compact_5to1"),
        options=SMALL,
        passes=0.1,
        items_per_epoch=4,
        batch_size=2,
        validation_share=0.3,
        precision="32-true",
    )
    files = prepare_here(folder, tmp_path / "cache", config)
    targets = {n for path in files for n in open_prepared(path).targets}
    virtual = {name for name in targets if is_virtual(name)}
    assert virtual == {"virtual_box_67x13x5"}

    out, cache = tmp_path / "run", tmp_path / "cache"
    card = train_here(folder, out, config, cache=cache)
    assert card.box_size == _SIZES["box_5to1"]
    assert card.training["prepare"]["virtual_size"] == [0.06708, 0.01342, 0.005]
    assert "backbone" not in card.training
    # One of a folder is chosen by its box.
    inference = load_inference(out, target_size=np.array([0.12, 0.024, 0.01]))
    sample = _sample(0, "box_5to1")
    found = inference.infer(sample.depth, sample.target_modal, sample.camera)
    assert found.data.shape == _SHAPE
