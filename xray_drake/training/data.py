"""Batches of prepared items."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import lightning
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler

from xray_drake.training.config import TrainConfig, TrainingError
from xray_drake.training.prepare import Prepared, open_prepared

Batch = tuple[Tensor, Tensor, Tensor]
"""(B, 7, h, w) uint8 images, (B, 5) float32 sizes, (B,) bool real."""


class PreparedItems(Dataset[tuple[Tensor, Tensor, Tensor]]):
    """Chosen items of prepared shards."""

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
        places = []
        for number, shard in enumerate(shards):
            wanted = shard.held_out == held_out
            named = np.isin(shard.targets, targets) | (not targets)
            wanted &= np.where(shard.real, named, virtual)
            rows = np.flatnonzero(wanted)
            places.append(np.stack([np.full_like(rows, number), rows], axis=1))
        self._places = np.concatenate(places)

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, index: int) -> tuple[Tensor, Tensor, Tensor]:
        number, row = self._places[index].tolist()
        shard = self._shards[number]
        return (
            torch.from_numpy(np.array(shard.images[row])),
            torch.from_numpy(shard.sizes[row]),
            torch.tensor(bool(shard.real[row])),
        )


class PassSampler(Sampler[int]):
    """Goes through all items again and again, a part of a pass an epoch.

    Which items an epoch has depends on the seed and the epoch's number alone,
    so a run that is resumed goes on as it would have gone.
    """

    def __init__(self, items: int, per_epoch: int, seed: int) -> None:
        self._items = items
        self._per_epoch = per_epoch
        self._seed = seed
        self._epoch = 0

    def set_epoch(self, epoch: int) -> None:
        """Is called by the trainer."""
        self._epoch = epoch

    def __len__(self) -> int:
        return self._per_epoch

    def __iter__(self) -> Iterator[int]:
        begin = self._epoch * self._per_epoch
        end = begin + self._per_epoch
        for number in range(begin // self._items, -(-end // self._items)):
            order = np.random.default_rng([self._seed, number]).permutation(
                self._items
            )
            low, high = begin - number * self._items, end - number * self._items
            yield from order[max(low, 0) : high].tolist()


class PreparedData(lightning.LightningDataModule):
    """Training and validation batches of prepared files."""

    def __init__(
        self, files: Sequence[Path], config: TrainConfig, *, workers: int = 1
    ) -> None:
        """Opens the files.

        Args:
            files: of :func:`xray_drake.training.prepare.prepare`.
            config: chooses items and sizes of batches.
            workers: processes that read.

        Raises:
            TrainingError: nothing to train on, or to validate on.
        """
        super().__init__()
        shards = [open_prepared(file) for file in files]
        self._config = config
        self._workers = workers
        self.train_items, self.validation_items = (
            PreparedItems(
                shards,
                held_out=held_out,
                targets=config.targets,
                virtual=config.virtual,
            )
            for held_out in (False, True)
        )
        for name, items in (
            ("to train on", self.train_items),
            ("held out for validation", self.validation_items),
        ):
            if not len(items):
                raise TrainingError(
                    f"no sample is {name}: give a larger dataset, or other "
                    "targets"
                )

    @property
    def epochs(self) -> int:
        """The trainer's epochs: parts of passes."""
        total = self._config.passes * len(self.train_items)
        return max(1, round(total / self._config.items_per_epoch))

    @property
    def steps_per_epoch(self) -> int:
        """Optimizer steps."""
        return self._config.items_per_epoch // self._config.batch_size

    def train_dataloader(self) -> DataLoader:
        """Returns shuffled batches."""
        config = self._config
        sampler = PassSampler(
            len(self.train_items), config.items_per_epoch, config.seed
        )
        return self._loader(self.train_items, sampler, drop_last=True)

    def val_dataloader(self) -> DataLoader:
        """Returns all items that are held out."""
        return self._loader(self.validation_items, None, drop_last=False)

    def _loader(
        self,
        items: PreparedItems,
        sampler: PassSampler | None,
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
