"""What a network is trained on: items, batches, parts of passes."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, count, islice
from pathlib import Path
from typing import Any

import lightning
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler

from xray_drake.training.config import TrainConfig, TrainingError
from xray_drake.training.items import Item
from xray_drake.training.prepare import Prepared, open_prepared

Batch = tuple[Tensor, Tensor, Tensor, Tensor, Tensor]
"""An ``Item``'s images, (B, 2, H, W), (B, 3, H/4, W/4), (B, 2, H, W) uint8;
(B, 5) float32 sizes; (B,) bool real."""


class PreparedItems(Dataset[Batch]):
    """Chosen items of prepared shards.

    Attributes:
        num_real: those of them that are not of a virtual target.
    """

    def __init__(
        self,
        shards: Sequence[Prepared],
        *,
        held_out: bool,
        targets: Sequence[str] = (),
        virtual: bool = True,
    ) -> None:
        """Chooses.

        Args:
            shards: opened.
            held_out: those for validation, or the others.
            targets: of these alone, if any (and of virtual ones).
            virtual: with virtual targets.
        """
        self._shards = list(shards)
        self.num_real = 0
        places = []
        for number, shard in enumerate(shards):
            wanted = shard.held_out == held_out
            named = np.isin(shard.targets, targets) | (not targets)
            wanted &= np.where(shard.real, named, virtual)
            self.num_real += int(np.count_nonzero(wanted & shard.real))
            rows = np.flatnonzero(wanted)
            places.append(np.stack([np.full_like(rows, number), rows], axis=1))
        self._places = np.concatenate(places)

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, index: int) -> Batch:
        number, row = self._places[index].tolist()
        shard = self._shards[number]
        return (
            *item_tensors(shard.item(row)),
            torch.from_numpy(shard.sizes[row]),
            torch.tensor(bool(shard.real[row])),
        )


class PassSampler(Sampler[int]):
    """Goes through all items again and again, a part of a pass an epoch.

    Which items an epoch has depends on the seed and the epoch's number alone,
    so a run that is resumed goes on as it would have gone. Devices share the
    items of an epoch: each has as many, and none has another's.
    """

    def __init__(
        self,
        items: int,
        per_epoch: int,
        seed: int,
        *,
        rank: int = 0,
        devices: int = 1,
    ) -> None:
        """Keeps what it is given.

        Args:
            items: in a pass.
            per_epoch: of them, on all devices.
            seed: of the order.
            rank: of this device.
            devices: how many there are.
        """
        self._items = items
        self._per_epoch = per_epoch
        self._seed = seed
        self._rank, self._devices = rank, devices
        self._epoch = 0

    def set_epoch(self, epoch: int) -> None:
        """Is called by the trainer."""
        self._epoch = epoch

    def __len__(self) -> int:
        return self._per_epoch // self._devices

    def __iter__(self) -> Iterator[int]:
        first, begin = divmod(self._epoch * self._per_epoch, self._items)
        order = chain.from_iterable(map(self._pass, count(first)))
        end = begin + len(self) * self._devices
        return islice(order, begin + self._rank, end, self._devices)

    def _pass(self, number: int) -> list[int]:
        """Returns the items of a pass, on all devices."""
        rng = np.random.default_rng([self._seed, number])
        return rng.permutation(self._items).tolist()


def steps_per_epoch(config: TrainConfig, devices: int) -> int:
    """Returns the optimizer's steps in an epoch, which devices take together.

    Raises:
        TrainingError: an epoch has not a batch for each device.
    """
    steps = config.items_per_epoch // (config.batch_size * devices)
    if not steps:
        raise TrainingError(
            f"items_per_epoch is {config.items_per_epoch}: {devices} devices "
            f"need a batch of {config.batch_size} each; raise it, or take "
            "fewer devices"
        )
    return steps


class TrainingData(lightning.LightningDataModule):
    """Training and validation batches of items, each device's own share.

    The trainer's own samplers are not used: they repeat items that are held
    out, so that metrics would depend on the number of devices.
    """

    def __init__(
        self,
        train_items: Dataset[Any],
        validation_items: Dataset[Any],
        config: TrainConfig,
        *,
        workers: int,
        devices: int = 1,
    ) -> None:
        """Keeps what it is given.

        Args:
            train_items: to train on; has a length.
            validation_items: of heaps that are held out; has a length.
            config: of the run.
            workers: processes that read; 0 reads in this one.
            devices: that share the items.

        Raises:
            TrainingError: nothing to train on, or to validate on, for some
                device.
        """
        super().__init__()
        self._config = config
        self._workers = workers
        self._devices = devices
        self.train_items = train_items
        self.validation_items = validation_items
        # Those of virtual targets are no images of heaps.
        self.num_images: int = sum(
            getattr(items, "num_real", length(items))
            for items in (train_items, validation_items)
        )
        self.num_train = length(train_items)
        self.num_validation = length(validation_items)
        for name, number in (
            ("to train on", self.num_train),
            ("held out for validation", self.num_validation),
        ):
            if number < devices:
                raise TrainingError(
                    f"{number or 'no'} sample is {name}, for {devices} "
                    f"device{'s' * (devices > 1)}: give a larger dataset, or "
                    "other targets"
                )

    @property
    def epochs(self) -> int:
        """The trainer's epochs: parts of passes."""
        total = self._config.passes * self.num_train
        return max(1, round(total / self._items_per_epoch))

    @property
    def steps(self) -> int:
        """The optimizer's steps, in all."""
        return self.epochs * self.steps_per_epoch

    @property
    def steps_per_epoch(self) -> int:
        """The optimizer's steps in one of these."""
        return steps_per_epoch(self._config, self._devices)

    @property
    def _items_per_epoch(self) -> int:
        """Those of whole batches: none is passed over."""
        together = self._config.batch_size * self._devices
        return together * self.steps_per_epoch

    def train_dataloader(self) -> DataLoader:
        """Returns shuffled batches, this device's."""
        sampler = PassSampler(
            self.num_train,
            self._items_per_epoch,
            self._config.seed,
            rank=self._rank(),
            devices=self._devices,
        )
        sampler.set_epoch(self._epochs_done())
        return self._loader(self.train_items, sampler, drop_last=True)

    def val_dataloader(self) -> DataLoader:
        """Returns this device's share of all items that are held out."""
        share = range(self._rank(), self.num_validation, self._devices)
        return self._loader(self.validation_items, share, drop_last=False)

    def _rank(self) -> int:
        """This device's number."""
        return self.trainer.global_rank if self.trainer else 0

    def _epochs_done(self) -> int:
        """Where a sampler begins.

        The trainer tells it the epoch only after it has begun to draw the
        first one; on resume that is not epoch 0.
        """
        if self.trainer is None:
            return 0
        progress = self.trainer.fit_loop.epoch_progress.current
        return progress.processed  # type: ignore[attr-defined]

    def _loader(
        self,
        items: Dataset[Any],
        sampler: Iterable[int],
        *,
        drop_last: bool,
    ) -> DataLoader:
        return DataLoader(
            items,
            batch_size=self._config.batch_size,
            sampler=sampler,
            drop_last=drop_last,
            num_workers=self._workers,
            persistent_workers=self._workers > 0,
        )


def open_items(
    files: Sequence[Path], config: TrainConfig
) -> tuple[PreparedItems, PreparedItems]:
    """Opens prepared files; returns items to train on and those held out.

    Args:
        files: of :func:`xray_drake.training.prepare.prepare`.
        config: chooses items.
    """
    shards = [open_prepared(file) for file in files]
    train, validation = (
        PreparedItems(
            shards,
            held_out=held_out,
            targets=config.targets,
            virtual=config.virtual,
        )
        for held_out in (False, True)
    )
    return train, validation


def item_tensors(item: Item) -> tuple[Tensor, Tensor, Tensor]:
    """Returns fine and coarse images and labels, as :data:`Batch` has them."""
    return (
        torch.from_numpy(item.fine),
        torch.from_numpy(np.array(item.coarse)),
        torch.from_numpy(item.labels),
    )


def length(items: Dataset[Any]) -> int:
    """Returns how many items there are; a ``Dataset`` need not say."""
    return len(items)  # type: ignore[arg-type]
