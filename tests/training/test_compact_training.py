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
from xray_drake.dataset.reader import OccupancyDataset, is_held_out
from xray_drake.occupancy.learned import build
from xray_drake.occupancy.learned.inference import load_inference
from xray_drake.occupancy.metrics import PixelCounts, pixel_counts
from xray_drake.training.config import TrainConfig
from xray_drake.training.data import Batch
from xray_drake.training.module import CompactTraining
from xray_drake.training.prepare import PrepareConfig, plan, prepare_shard
from xray_drake.training.run import WEIGHTS, RunOptions, train

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


def test_the_logged_metrics_are_those_of_inference(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(build.ARCHITECTURES, "compact", _Guess)
    (tmp_path / "cache").mkdir()
    for job in plan([folder], tmp_path / "cache", _CONFIG.prepare, _SHARE):
        prepare_shard(*job, _CONFIG.prepare, _SHARE)
    card = train(
        [folder],
        _CONFIG,
        RunOptions(
            out=tmp_path / "run",
            cache=tmp_path / "cache",
            accelerator="cpu",
            progress=False,
        ),
    )
    items = OccupancyDataset(
        folder, images="validation", validation_share=_SHARE
    )
    held_out = sum(is_held_out(seed, _SHARE) for seed in range(_HEAPS))
    assert len(items) == card.data["items held out"] == held_out > 1
    counts = PixelCounts()
    mass = []
    for index in range(len(items)):
        sample = items.sample(index)
        occupancy, posterior = (
            load_inference(
                tmp_path / "run" / WEIGHTS,
                target_size=sample.target_size,
                output=output,  # type: ignore[arg-type]
            )
            .infer(sample.depth, sample.target_modal, sample.camera)
            .data
            for output in ("occupancy", "posterior")
        )
        assert occupancy.shape == posterior.shape == _SHAPE
        counts += pixel_counts(sample.occupancy, occupancy)
        on_target = posterior[sample.target_amodal].sum()
        mass.append(on_target / posterior.sum())
    assert 0.1 < counts.iou < 0.9
    assert 0.1 < np.mean(mass) < 0.9
    figures = card.figures["held-out heaps, full resolution"]
    for name, expected in (
        ("iou", counts.iou),
        ("balanced_accuracy", counts.balanced_accuracy),
        ("mass_on_target", np.mean(mass)),
    ):
        # A card has four digits, an item's heights have 256 levels.
        assert figures[f"validation/{name}"] == pytest.approx(
            expected, abs=5e-4
        )


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
    config = dataclasses.replace(_CONFIG, **change)
    module: Any = CompactTraining(net, config, 1)
    logged: dict[str, float] = {}
    module.log = lambda name, value, **kw: logged.update({name: float(value)})
    module.log_dict = lambda values, **kw: logged.update(
        {name: float(value) for name, value in values.items()}
    )
    return module, logged


def test_images_and_labels_are_flipped_together() -> None:
    batch = _batch(True, False, True)
    different = set()
    for seed in range(40):
        net = _Echo()
        module, _ = _training(net, seed=seed)
        assert module.training_step(batch, 0) < 1e-5
        fine, coarse, sizes = net.seen
        different.add(fine.numpy().tobytes())
        pooled = functional.max_pool2d(fine, 4)
        assert torch.equal(coarse, pooled[:, [0, 1, 0]])
        assert torch.equal(sizes, batch[3])
    # As it was, left and right, up and down, both.
    original = batch[0].float() / 255
    expected = {
        original.flip(axes).numpy().tobytes() for axes in ([], [2], [3], [2, 3])
    }
    assert different == expected
    module, _ = _training(net, flips=False)
    module.training_step(batch, 0)
    assert torch.equal(net.seen[0], original)
    assert torch.equal(net.seen[1], batch[1].float() / 255)


def test_validation_flips_nothing() -> None:
    batch = _batch(True, False)
    for seed in range(4):
        net = _Echo()
        module, _ = _training(net, seed=seed)
        module.validation_step(batch, 0)
        for seen, given in zip(net.seen[:2], batch[:2], strict=True):
            assert torch.equal(seen, given.float() / 255)


def test_labels_that_are_not_those_of_the_image_cost() -> None:
    fine, coarse, labels, sizes, real = _batch(True, True)
    module, logged = _training(_Echo(), flips=False)
    for index, name in enumerate(("occupancy", "posterior")):
        wrong = labels.clone()
        wrong[:, index] = 255 - wrong[:, index]
        module.training_step((fine, coarse, wrong, sizes, real), 0)
        losses = {
            other: logged[f"train/{other}_loss"]
            for other in ("occupancy", "posterior")
        }
        assert losses.pop(name) > 1
        (other,) = losses.values()
        assert other < 1e-5


def test_pixels_and_mass_are_counted_over_batches() -> None:
    torch.manual_seed(0)
    net = _Guess()
    module, logged = _training(net)
    batches = [_batch(True, False, True, seed=1), _batch(False, True, seed=2)]
    with torch.no_grad():
        for epoch in range(2):
            for index, batch in enumerate(batches[epoch:]):
                module.validation_step(batch, index)
            module.on_validation_epoch_end()
            counts, mass = PixelCounts(), []
            for fine, coarse, labels, sizes, real in batches[epoch:]:
                images = fine.float() / 255, coarse.float() / 255
                answers = torch.sigmoid(net(*images, sizes)).double().numpy()
                for answer, label, counted in zip(
                    answers, labels.numpy() / 255, real, strict=True
                ):
                    counts += pixel_counts(label[0], answer[0])
                    if counted:
                        on_target = (answer[1] * label[1]).sum()
                        mass.append(on_target / answer[1].sum())
            assert len(mass) == (3, 1)[epoch]
            assert 0 < counts.iou < 1
            for name, expected in (
                ("iou", counts.iou),
                ("balanced_accuracy", counts.balanced_accuracy),
                ("mass_on_target", np.mean(mass)),
            ):
                assert logged[f"validation/{name}"] == pytest.approx(
                    expected, abs=1e-4
                )
