"""Trains the part of a ``WindowedNet`` that looks at windows."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader, Dataset, Sampler

from xray_drake.occupancy.metrics import POSITIVE
from xray_drake.occupancy.networks.window import Window, target_window
from xray_drake.occupancy.networks.windowed import WindowedNet
from xray_drake.training.config import TrainConfig
from xray_drake.training.data import (
    PassSampler,
    PreparedItems,
    TrainingData,
    item_tensors,
    open_items,
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

    Goes through the items in the order of a :class:`PassSampler`; a batch is
    complete when so many of a size have come. An epoch has the same number of
    batches as it would have of whole images; which they are depends on the
    seed and the epoch's number alone. In each step all devices have windows of
    the same size.
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
        self._sides = sides
        self._size = config.batch_size
        self._steps = config.items_per_epoch // config.batch_size // devices
        self._rank, self._devices = rank, devices
        self._items = PassSampler(len(sides), len(sides), config.seed)
        self._per_epoch = config.items_per_epoch
        self._epoch = 0
        # The trainer tells a batch sampler's "sampler" its epoch.
        self.sampler = self

    def set_epoch(self, epoch: int) -> None:
        """Is called by the trainer."""
        self._epoch = epoch

    def __len__(self) -> int:
        return self._steps

    def __iter__(self) -> Iterator[list[int]]:
        together = self._size * self._devices
        waiting: dict[tuple[int, int], list[int]] = defaultdict(list)
        begin = self._rank * self._size
        steps = 0
        for index in self._order():
            if steps == self._steps:
                return
            group = waiting[self._sides[index]]
            group.append(index)
            if len(group) == together:
                yield group[begin : begin + self._size]
                group.clear()
                steps += 1

    def _order(self) -> Iterator[int]:
        """From where the epoch begins, without an end."""
        number, skipped = divmod(
            self._epoch * self._per_epoch, len(self._sides)
        )
        while True:
            self._items.set_epoch(number)
            yield from list(self._items)[skipped:]
            number, skipped = number + 1, 0


class WindowedData(TrainingData):
    """Batches of windows of prepared files; see :data:`WindowBatch`."""

    def __init__(self, files: Sequence[Path], config: TrainConfig) -> None:
        """Opens the files and cuts out all windows.

        Args:
            files: of :func:`xray_drake.training.prepare.prepare`.
            config: chooses items and sizes of batches.

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
            num_images=self._train.num_real + self._validation.num_real,
            workers=0,
        )

    def train_dataloader(self) -> DataLoader:
        """Returns shuffled batches, this device's."""
        rank, devices = self._place()
        sampler = WindowSampler(
            self._train.sides, self._config, rank=rank, devices=devices
        )
        sampler.set_epoch(self._epochs_done())
        return DataLoader(self._train, batch_sampler=sampler)

    def val_dataloader(self) -> DataLoader:
        """Returns this device's share of all items that are held out."""
        rank, devices = self._place()
        groups: dict[tuple[int, int], list[int]] = defaultdict(list)
        for index, sides in enumerate(self._validation.sides):
            groups[sides].append(index)
        size = self._config.batch_size
        batches = [
            group[i : i + size]
            for group in groups.values()
            for i in range(0, len(group), size)
        ]
        return DataLoader(
            self._validation, batch_sampler=batches[rank::devices]
        )

    def _place(self) -> tuple[int, int]:
        """This device's number, and of how many."""
        trainer = self.trainer
        if trainer is None:
            return 0, 1
        return trainer.global_rank, trainer.world_size


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
        self._count(output, labels, real)
        positive, negative = outside.sum(dim=0).cpu()
        beyond = [0, negative, positive, negative, positive]
        self._counts += torch.tensor(beyond, dtype=torch.float64)


def _outside(label: np.ndarray, window: Window) -> Tensor:
    positive = label > POSITIVE * 255
    beyond = np.count_nonzero(positive) - np.count_nonzero(window.of(positive))
    rest = label.size - window.height * window.width - beyond
    return torch.tensor([beyond, rest])
