"""The compact network's training, with networks that guess in its place."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional

from tests.dataset.conftest import synthetic_sample
from tests.dataset.whole import tiny_dataset
from tests.training.making import prepare_here, train_here
from xray_drake.dataset.reader import OccupancyDataset, is_held_out
from xray_drake.occupancy.learned import build
from xray_drake.occupancy.learned.inference import load_inference
from xray_drake.occupancy.metrics import PixelCounts, pixel_counts
from xray_drake.training.config import TrainConfig, load_config
from xray_drake.training.data import Batch
from xray_drake.training.module import CompactTraining
from xray_drake.training.prepare import PrepareConfig
from xray_drake.training.run import WEIGHTS

_SHAPE = (64, 96)
_HEAPS = 12
_SHARE = 0.3

_CONFIG = TrainConfig(
    validation_share=_SHARE,
    passes=0.5,
    items_per_epoch=4,
    batch_size=2,
    learning_rate=1e-12,
    precision="32-true",
    prepare=PrepareConfig(
        virtual=0, noisy=0.0, miscalibrated=0.0, mask_errors=0.0
    ),
)


_PAPER = dataclasses.replace(
    load_config("paper"),
    passes=0.4,
    items_per_epoch=4,
    batch_size=2,
    learning_rate=1e-12,
    validation_share=_SHARE,
)


class _Guess(nn.Module):
    """Sees the target, and guesses under what is high or not near an edge."""

    def __init__(self) -> None:
        super().__init__()
        self.fine = nn.Conv2d(2, 2, 1)
        self.coarse = nn.Conv2d(3, 2, 1, bias=False)
        weights = torch.tensor([[4.0, 20.0], [2.0, 9.0]])
        self.fine.weight.data = weights[:, :, None, None]
        self.fine.bias.data = torch.tensor([-8.0, -7.0])
        weights = torch.tensor([[1.0, 0.5, 2.0], [3.0, 0.2, 1.0]])
        self.coarse.weight.data = weights[:, :, None, None]

    def forward(self, fine: Tensor, coarse: Tensor, size: Tensor) -> Tensor:
        near = functional.interpolate(self.coarse(coarse), scale_factor=4)
        return self.fine(fine) + near


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A view of each of twelve heaps, some of which are held out."""
    return tiny_dataset(
        tmp_path_factory.mktemp("dataset"),
        lambda i: synthetic_sample(
            i, cover=(0.3, 1.0, 0.6)[i % 3], shape=_SHAPE
        ),
        _HEAPS,
        shard_size=8,
        seed=2,
    )


class _PaperGuess(nn.Module):
    """The same, of the paper's input."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 1, 1)
        nn.init.zeros_(self.conv1.bias)
        nn.init.constant_(self.conv1.weight, -320)
        self.conv1.weight.data[:, 0] = 200

    def forward(self, image: Tensor) -> Tensor:
        return self.conv1(image)


@pytest.mark.parametrize(
    ("config", "guess", "outputs", "error"),
    [
        # A card has four digits, an item's heights have 256 levels.
        (_CONFIG, _Guess, ["occupancy", "posterior"], 5e-4),
        (_PAPER, _PaperGuess, ["occupancy"], 2e-3),
    ],
    ids=["compact", "paper"],
)
def test_the_logged_metrics_are_those_of_inference(
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    config: TrainConfig,
    guess: type[nn.Module],
    outputs: list[Any],
    error: float,
) -> None:
    monkeypatch.setitem(build.ARCHITECTURES, config.architecture, guess)
    cache, run = tmp_path / "cache", tmp_path / "run"
    prepare_here(folder, cache, config)
    card = train_here(folder, run, config, cache=cache, workers=0)
    items = OccupancyDataset(
        folder, images="validation", validation_share=_SHARE
    )
    held_out = sum(is_held_out(seed, _SHARE) for seed in range(_HEAPS))
    assert len(items) == card.data["items held out"] == held_out > 1
    counts = PixelCounts()
    mass = []
    for index in range(len(items)):
        sample = items.sample(index)
        occupancy, *posterior = (
            load_inference(
                run / WEIGHTS,
                target_size=sample.target_size,
                output=output,
                scaling=False,
            )
            .infer(sample.depth, sample.target_modal, sample.camera)
            .data
            for output in outputs
        )
        assert occupancy.shape == _SHAPE
        counts += pixel_counts(sample.occupancy, occupancy)
        for answer in posterior:
            mass.append(answer[sample.target_amodal].sum() / answer.sum())
    expected = {
        "iou": counts.iou,
        "balanced_accuracy": counts.balanced_accuracy,
        **({"mass_on_target": np.mean(mass)} if mass else {}),
    }
    figures = card.figures["held-out heaps, full resolution"]
    for name, value in expected.items():
        assert 0.1 < value < 0.95
        assert figures[f"validation/{name}"] == pytest.approx(value, abs=error)


class _Echo(nn.Module):
    """Answers with the mask that it sees; remembers all that it sees."""

    def forward(self, *inputs: Tensor) -> Tensor:
        self.seen = inputs
        return 40 * inputs[0][:, [1, 1]] - 20


def _batch(*real: bool, seed: int = 0) -> Batch:
    """Random images; labels are the mask of what is seen."""
    generator = torch.Generator().manual_seed(seed)
    count = len(real)
    fine = torch.randint(0, 256, (count, 2, 32, 64), generator=generator)
    fine[:, 1] = 255 * (fine[:, 1] > 200)
    # Whatever is done to the fine ones is to be done to these.
    coarse = functional.max_pool2d(fine.float(), 4)[:, [0, 1, 0]]
    return (
        fine.to(torch.uint8),
        coarse.to(torch.uint8),
        fine[:, [1, 1]].to(torch.uint8),
        torch.randn(count, 5, generator=generator),
        torch.tensor(real),
    )


def _training(net: nn.Module, **change: Any) -> tuple[Any, dict[str, float]]:
    """A module without a trainer, and what it logs."""
    module: Any = CompactTraining(
        net, dataclasses.replace(_CONFIG, **change), 1
    )
    logged: dict[str, float] = {}
    module.log = lambda name, value, **kw: logged.update({name: float(value)})
    module.log_dict = lambda values, **kw: [
        module.log(name, value) for name, value in values.items()
    ]
    return module, logged


def test_images_and_labels_are_flipped_together() -> None:
    """But not in validation."""
    batch = _batch(True, False, True)
    original = batch[0].float() / 255
    net, different = _Echo(), set()
    for seed in range(40):
        module, _ = _training(net, seed=seed)
        assert module.training_step(batch, 0) < 1e-5
        fine, coarse, sizes = net.seen
        different.add(fine.numpy().tobytes())
        pooled = functional.max_pool2d(fine, 4)
        assert torch.equal(coarse, pooled[:, [0, 1, 0]])
        assert torch.equal(sizes, batch[3])
        module.validation_step(batch, 0)
        assert torch.equal(net.seen[0], original)
    # As it was, left and right, up and down, both.
    assert different == {
        original.flip(axes).numpy().tobytes() for axes in ([], [2], [3], [2, 3])
    }
    module, _ = _training(net, flips=False)
    module.training_step(batch, 0)
    assert torch.equal(net.seen[0], original)
    assert torch.equal(net.seen[1], batch[1].float() / 255)


def test_labels_that_are_not_those_of_the_image_cost() -> None:
    fine, coarse, labels, sizes, real = _batch(True, True)
    module, logged = _training(_Echo(), flips=False)
    names = ["occupancy", "posterior"]
    for index in range(2):
        wrong = labels.clone()
        wrong[:, index] = 255 - wrong[:, index]
        module.training_step((fine, coarse, wrong, sizes, real), 0)
        losses = [logged[f"train/{name}_loss"] for name in names]
        assert losses[index] > 1
        assert losses[1 - index] < 1e-5


def test_mass_on_the_target_is_of_real_targets_alone() -> None:
    """Over the batches of an epoch; the next begins anew."""
    torch.manual_seed(0)
    net = _Guess()
    module, logged = _training(net)
    batches = [_batch(True, False, True, seed=1), _batch(False, True, seed=2)]
    for epoch in range(2):
        mass = []
        for batch in batches[epoch:]:
            with torch.no_grad():
                module.validation_step(batch, 0)
                images = batch[0].float() / 255, batch[1].float() / 255
                answer = torch.sigmoid(net(*images, batch[3])[:, 1])
            on_target = (answer * batch[2][:, 1] / 255).sum(dim=(1, 2))
            mass += (on_target / answer.sum(dim=(1, 2)))[batch[4]].tolist()
        module.on_validation_epoch_end()
        assert len(mass) == (3, 1)[epoch]
        found = logged["validation/mass_on_target"]
        assert found == pytest.approx(np.mean(mass), abs=1e-4)
