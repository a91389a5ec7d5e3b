"""Trains the part of a ``WindowedNet`` that looks at windows."""

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, count, islice
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader, Dataset, Sampler

from xray_drake.occupancy.learned.window import Window, target_window
from xray_drake.occupancy.learned.windowed import WindowedNet
from xray_drake.occupancy.metrics import POSITIVE
from xray_drake.training.config import TrainConfig
from xray_drake.training.data import (
    PreparedItems,
    TrainingData,
    item_tensors,
    open_items,
    steps_per_epoch,
)
from xray_drake.training.items import Item, pack, unpack
from xray_drake.training.module import GeometryTraining

WindowBatch = tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]
"""A ``data.Batch`` of windows of one size, and (B, 2) int64: how many pixels
beyond the window have a label above ``POSITIVE``, and how many have not."""


class WindowItems(Dataset[WindowBatch]):
    """The windows of those items whose target is seen.

    They are cut out once and stay in memory, packed, some kilobytes each.

    Attributes:
        num_real: those that are not of a virtual target.
        sides: of each, height and width of its window, pixels.
    """

    def __init__(self, items: PreparedItems) -> None:
        """Cuts them out.

        Args:
            items: of whole images.
        """
        self._packed: list[bytes] = []
        self._told: list[tuple[Tensor, Tensor, Tensor]] = []
        self.sides: list[tuple[int, int]] = []
        self.num_real = 0
        for index in range(len(items)):
            fine, coarse, labels, size, real = items[index]
            mask = fine[1].numpy() > 0
            if not mask.any():
                continue
            window = target_window(mask, size.numpy())
            cut = Item(
                fine=window.of(fine.numpy()),
                coarse=window.of_coarse(coarse.numpy()),
                labels=window.of(labels.numpy()),
            )
            outside = _outside(labels[0].numpy(), window)
            self._packed.append(pack(cut))
            self._told.append((size, real, outside))
            self.sides.append((window.height, window.width))
            self.num_real += int(real)

    def __len__(self) -> int:
        return len(self._packed)

    def __getitem__(self, index: int) -> WindowBatch:
        item = unpack(self._packed[index], self.sides[index])
        return *item_tensors(item), *self._told[index]


class WindowSampler(Sampler[list[int]]):
    """Batches of windows of one size, shared among devices.

    Goes through all windows again and again. The last batch of a size in a
    pass may be a small one, so that windows of rare sizes are seen as often as
    others. An epoch has a number of batches; which they are depends on the
    seed and the epoch's number alone. In each step all devices have as many
    windows of the same size, two at least; where there are too few, some are
    repeated.

    Attributes:
        steps_per_pass: batches of each device in a pass.
    """

    def __init__(
        self,
        sides: Sequence[tuple[int, int]],
        config: TrainConfig,
        *,
        rank: int = 0,
        devices: int = 1,
    ) -> None:
        """Keeps what it is given.

        Args:
            sides: of :class:`WindowItems`.
            config: of the run.
            rank: of this device.
            devices: how many there are.
        """
        self._groups = [np.array(group) for group in _by_size(sides)]
        self._together = config.batch_size * devices
        # A single small window has no variance to normalise by.
        self._least = min(2, config.batch_size)
        self._steps = steps_per_epoch(config, devices)
        self._rank, self._devices = rank, devices
        self._seed = config.seed
        self._epoch = 0
        self.steps_per_pass = sum(
            math.ceil(len(group) / self._together) for group in self._groups
        )
        # The trainer tells a batch sampler's "sampler" its epoch.
        self.sampler = self

    def set_epoch(self, epoch: int) -> None:
        """Is called by the trainer."""
        self._epoch = epoch

    def __len__(self) -> int:
        return self._steps

    def __iter__(self) -> Iterator[list[int]]:
        number, skipped = divmod(self._epoch * self._steps, self.steps_per_pass)
        batches = chain.from_iterable(map(self._pass, count(number)))
        for batch in islice(batches, skipped, skipped + self._steps):
            each = max(self._least, math.ceil(len(batch) / self._devices))
            shared = np.resize(batch, each * self._devices)  # repeats
            yield shared[self._rank :: self._devices].tolist()

    def _pass(self, number: int) -> list[np.ndarray]:
        """Returns the batches of all devices, in a pass."""
        rng = np.random.default_rng([self._seed, number])
        batches: list[np.ndarray] = []
        for group in self._groups:
            order = rng.permutation(group)
            cuts = range(self._together, len(order), self._together)
            batches += np.split(order, cuts)
        return [batches[i] for i in rng.permutation(len(batches))]


def _by_size(
    sides: Sequence[tuple[int, int]], chosen: Iterable[int] | None = None
) -> list[list[int]]:
    """Sorts windows by their size.

    Args:
        sides: of all.
        chosen: indices of those that are wanted; by default all.
    """
    groups: dict[tuple[int, int], list[int]] = defaultdict(list)
    for index in range(len(sides)) if chosen is None else chosen:
        groups[sides[index]].append(index)
    return list(groups.values())


class WindowedData(TrainingData):
    """Batches of windows of prepared files; see :data:`WindowBatch`."""

    def __init__(
        self, files: Sequence[Path], config: TrainConfig, *, devices: int = 1
    ) -> None:
        """Opens the files and cuts out all windows.

        Args:
            files: of :func:`xray_drake.training.prepare.prepare`.
            config: chooses items and sizes of batches.
            devices: that share the windows.

        Raises:
            TrainingError: nothing to train on, or to validate on.
        """
        self._train, self._validation = map(
            WindowItems, open_items(files, config)
        )
        super().__init__(
            self._train,
            self._validation,
            config,
            workers=0,
            devices=devices,
        )

    @property
    def epochs(self) -> int:
        """The trainer's epochs: parts of passes."""
        total = self._config.passes * self._sampler().steps_per_pass
        return max(1, round(total / self.steps_per_epoch))

    def train_dataloader(self) -> DataLoader:
        """Returns shuffled batches, this device's."""
        sampler = self._sampler()
        sampler.set_epoch(self._epochs_done())
        return DataLoader(self._train, batch_sampler=sampler)

    def val_dataloader(self) -> DataLoader:
        """Returns this device's share of all items that are held out."""
        share = range(self._rank(), self.num_validation, self._devices)
        size = self._config.batch_size
        batches = [
            group[i : i + size]
            for group in _by_size(self._validation.sides, share)
            for i in range(0, len(group), size)
        ]
        return DataLoader(self._validation, batch_sampler=batches)

    def _sampler(self) -> WindowSampler:
        return WindowSampler(
            self._train.sides,
            self._config,
            rank=self._rank(),
            devices=self._devices,
        )


class WindowedTraining(GeometryTraining):
    """Trains ``WindowedNet.near``; the part for whole images stays."""

    resolution = "targets that are seen, full resolution"

    def __init__(
        self, net: WindowedNet, config: TrainConfig, steps: int
    ) -> None:
        """Keeps what it is given.

        Args:
            net: to be trained.
            config: of the run.
            steps: of the optimizer, in all.
        """
        super().__init__(net, config, steps)
        net.whole.requires_grad_(False)

    def training_step(self, batch: WindowBatch, index: int) -> Tensor:
        """Returns the loss of one batch, turned at random; of shape ()."""
        if self.global_step >= self._config.freeze_norm * self._steps:
            for module in self.net.modules():
                if isinstance(module, nn.BatchNorm2d):
                    module.eval()
        fine, coarse, labels, sizes, real, _ = batch
        axes = self.flipped_axes()
        fine, coarse, labels = (
            image.flip(axes) for image in (fine, coarse, labels)
        )
        square = fine.shape[2] == fine.shape[3]
        if self._config.flips and square and self.global_step % 2:
            fine, coarse, labels = (
                image.transpose(2, 3) for image in (fine, coarse, labels)
            )
        return self._loss("train", (fine, coarse, labels, sizes, real))[0]

    def validation_step(self, batch: WindowBatch, index: int) -> None:
        """Counts pixels; beyond the windows the answer is 0."""
        fine, coarse, labels, sizes, real, outside = batch
        _, output = self._loss(
            "validation", (fine, coarse, labels, sizes, real)
        )
        self._count(output, labels, real, outside.sum(dim=0))


def _outside(label: np.ndarray, window: Window) -> Tensor:
    positive = label > POSITIVE * 255
    beyond = np.count_nonzero(positive) - np.count_nonzero(window.of(positive))
    rest = label.size - window.height * window.width - beyond
    return torch.tensor([beyond, rest])
