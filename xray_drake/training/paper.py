"""The paper's training (section IV.B): augmented depth, squared distance.

The paper gives epochs, learning rate, momentum, weight decay and the split. The
rest is of the code that its authors published (github.com/BerkeleyAutomation/
xray, ``tools/train.py``, ``xray/dataset.py``): labels are bytes, the loss is
the mean over the pixels and images of a batch of 8, the mean over the dataset
is taken off the input. Two things differ. Depth is in decimetres about the
floor's, not in bytes; and the mask is the first channel here as in the paper's
text, the last one there ("transposing to BGR").
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor, nn
from torch.nn.functional import mse_loss
from torch.utils.data import ConcatDataset, Dataset, TensorDataset

from xray_drake.dataset.reader import NoSampleError, OccupancyDataset
from xray_drake.seeding import stream
from xray_drake.training.config import TrainConfig
from xray_drake.training.data import length
from xray_drake.training.module import OccupancyTraining


def paper_items(
    datasets: Sequence[Path], config: TrainConfig, *, incomplete: bool = False
) -> tuple[Dataset[Any], Dataset[Any]]:
    """Returns :class:`OccupancyDataset`'s items to train on and held out.

    Split by heaps; the object splits of the datasets are not told apart.

    Args:
        datasets: folders.
        config: chooses targets and the share held out.
        incomplete: leave out shards that are missing.

    Raises:
        DatasetError: a dataset that cannot be read, or lacks a shard.
    """
    return (
        _items(datasets, config, "train", incomplete),
        _items(datasets, config, "validation", incomplete),
    )


def input_mean(items: Dataset[Any], config: TrainConfig) -> Tensor:
    """Returns the (3,) mean of the channels over training images.

    Args:
        items: to train on.
        config: of the run; ``input_mean_images`` are drawn by its seed, or all
            are taken if there are fewer.
    """
    order = stream(config.seed, "input mean").permutation(length(items))
    # In the order of the shards, so that each is opened once.
    chosen = sorted(order[: config.input_mean_images].tolist())
    total = torch.zeros(3, dtype=torch.float64)
    for index in chosen:
        image = items[index]["input"]  # (3, H, W)
        total += image.double().mean(dim=(1, 2))
    return total / len(chosen)


class PaperTraining(OccupancyTraining):
    """Trains a network of the augmented depth; logs PROTOCOL.md's metrics.

    A batch is a dict with ``input`` (B, 3, H, W) and ``occupancy``
    (B, 1, H, W); the network learns the label times ``label_scale`` from the
    input less its mean. Metrics are of the answer clipped to [0, 1].

    Attributes:
        input_mean: (3,) float32; of the checkpoint if the run is resumed.
    """

    unused = (
        "virtual",
        "posterior_weight",
        "prepare",
        "entropy_weight",
        "miss_weight",
        "freeze_norm",
    )
    input_mean: Tensor

    def __init__(
        self,
        net: nn.Module,
        config: TrainConfig,
        steps: int,
        input_mean: Tensor,
    ) -> None:
        """Keeps what it is given.

        Args:
            net: to be trained.
            config: of the run.
            steps: of the optimizer, in all.
            input_mean: (3,), see :func:`input_mean`.
        """
        super().__init__(net, config, steps)
        self.register_buffer("input_mean", input_mean.float())

    def facts(self) -> dict[str, Any]:
        """Returns what a card says of the training, and inference needs."""
        return {**super().facts(), "input_mean": self.input_mean.tolist()}

    def training_step(self, batch: dict[str, Any], index: int) -> Tensor:
        """Returns the loss of one batch."""
        axes = self.flipped_axes()
        image, label = batch["input"].flip(axes), batch["occupancy"].flip(axes)
        loss = self._loss(self._answer(image), label)
        self.log("train/loss", loss, batch_size=len(image))
        return loss

    def validation_step(self, batch: dict[str, Any], index: int) -> None:
        """Counts pixels."""
        image, label = batch["input"], batch["occupancy"]
        answer = self._answer(image)
        self.log(
            "validation/loss",
            self._loss(answer, label),
            batch_size=len(image),
            sync_dist=True,
        )
        output = (answer / self._config.label_scale).clamp(0, 1)
        self.metrics.update(output[:, 0], label[:, 0])

    def _answer(self, image: Tensor) -> Tensor:
        """Returns (B, 1, H, W) float32, in the unit of the scaled label."""
        return self.net(image - self.input_mean[:, None, None]).float()

    def _loss(self, answer: Tensor, label: Tensor) -> Tensor:
        # The mean over pixels and images (section IV.B).
        return mse_loss(answer, label * self._config.label_scale)


def _items(
    datasets: Sequence[Path],
    config: TrainConfig,
    images: Literal["train", "validation"],
    incomplete: bool,
) -> Dataset[Any]:
    """Chooses samples of datasets; there may be none."""
    parts = []
    for folder in datasets:
        try:
            part = OccupancyDataset(
                folder,
                images=images,
                validation_share=config.validation_share,
                targets=config.targets or None,
                incomplete=incomplete,
            )
        except NoSampleError:
            continue
        parts.append(part)
    return ConcatDataset(parts) if parts else TensorDataset(torch.empty(0))
