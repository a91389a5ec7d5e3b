"""A dataset as torch reads it."""

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch.utils.data import Dataset

from xray_drake.dataset.images import LabelledImages
from xray_drake.dataset.manifest import DatasetError
from xray_drake.dataset.sample import Sample, SampleKey
from xray_drake.dataset.shards import ShardReader, dataset_shards
from xray_drake.occupancy.learned.augmented_depth import augmented_depth
from xray_drake.seeding import stream

Transform = Callable[[LabelledImages, np.random.Generator], LabelledImages]


class NoSampleError(DatasetError):
    """A dataset that holds no sample of what was asked for."""


_MAX_OPEN = 64
"""Shards that stay open per process; systems limit files to 1024 or fewer."""


class OccupancyDataset(Dataset[dict[str, Any]]):
    """Augmented depth images and their occupancy distributions.

    An item is a dict:

    - ``input``: (3, H, W) float32, see
      :func:`xray_drake.occupancy.learned.augmented_depth.augmented_depth`;
    - ``occupancy``: (1, H, W) float32 in [0, 1];
    - ``modal``, ``amodal``: (1, H, W) bool;
    - ``target_size``: (3,) float32, m;
    - ``index``: int, of the item in this dataset: see ``keys``;
    - ``key``: str, for people.

    Camera and target poses are not in it: a transform makes them untrue.
    :meth:`sample` gives them.

    Reads an image when it is asked for, in whatever process; a damaged image
    raises ``ShardError`` with the shard's name.

    Attributes:
        folder: of the dataset.
        keys: the key of each item.
    """

    def __init__(
        self,
        folder: str | Path,
        *,
        split: str | None = None,
        images: Literal["all", "train", "validation"] = "all",
        validation_share: float = 0.2,
        targets: Iterable[str] | None = None,
        transform: Transform | None = None,
        seed: int = 0,
        incomplete: bool = False,
    ) -> None:
        """Reads the manifest and the keys of all shards.

        Args:
            folder: with ``dataset.json`` and shards.
            split: by object: train, validation or test; None is all.
            images: by image: a part of the heaps, all views and snapshots of
                a heap on one side; the same heaps whatever the split.
            validation_share: share of the heaps in ``"validation"``.
            targets: only samples of these; None is all.
            transform: changes images, e.g. an
                :class:`~xray_drake.dataset.augmentation.Augmentation`.
            seed: of the transform; with the epoch and the index it decides.
            incomplete: take what is there of a dataset that is being made.

        Raises:
            DatasetError: the folder is no dataset, a shard is missing,
                damaged or of another dataset.
            NoSampleError: nothing is left.
            ValueError: an argument is none of those allowed.
        """
        if images not in ("all", "train", "validation"):
            raise ValueError(
                f"images are all, train or validation, not {images!r}"
            )
        if not 0 <= validation_share <= 1:
            raise ValueError(f"validation_share is {validation_share}")
        self.folder = Path(folder)
        self._transform = transform
        self._seed = seed
        # Shared, so that a loader's workers that stay alive see it change.
        self._epoch = torch.zeros(1, dtype=torch.int64).share_memory_()
        self._paths: list[Path] = []
        self._open_shards: OrderedDict[int, ShardReader] = OrderedDict()
        wanted = None if targets is None else set(targets)
        keys: list[SampleKey] = []
        places: list[tuple[int, int]] = []
        for _, shard in dataset_shards(
            self.folder, split=split, incomplete=incomplete
        ):
            for row, key in enumerate(shard.keys):
                if wanted is not None and key.target_name not in wanted:
                    continue
                held_out = is_held_out(key.heap_seed, validation_share)
                if images == "all" or held_out == (images == "validation"):
                    keys.append(key)
                    places.append((len(self._paths), row))
            self._paths.append(shard.path)
        if not keys:
            raise NoSampleError(
                f"{self.folder} holds no sample of what was asked for"
            )
        self.keys = tuple(keys)
        # An array, not a list: forked workers would copy that as they count.
        self._places = np.array(places)

    def __len__(self) -> int:
        return len(self.keys)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_open_shards": OrderedDict()}

    def __getitem__(self, index: int) -> dict[str, Any]:
        index = self._checked(index)
        images = self.images(index)
        shard, row = self._shard_of(index)
        size = shard.rows("target_size")[row]
        if self._transform is not None:
            rng = stream(
                self._seed, "augmentation", int(self._epoch.item()), index
            )
            images = self._transform(images, rng)

        def tensor(image: np.ndarray) -> torch.Tensor:
            return torch.from_numpy(np.ascontiguousarray(image)[None])

        return {
            "input": torch.from_numpy(
                augmented_depth(images.depth, images.modal)
            ),
            "occupancy": tensor(images.occupancy),
            "modal": tensor(images.modal),
            "amodal": tensor(images.amodal),
            "target_size": torch.from_numpy(size.astype(np.float32)),
            "index": index,
            "key": str(self.keys[index]),
        }

    def set_epoch(self, epoch: int) -> None:
        """Makes the transform draw anew; reaches running workers as well."""
        self._epoch[0] = epoch

    def images(self, index: int) -> LabelledImages:
        """Returns the images of an item as they are on disk.

        Raises:
            IndexError: there is no such item.
        """
        index = self._checked(index)
        shard, row = self._shard_of(index)
        return LabelledImages(
            depth=shard.image("depth", row),
            modal=shard.image("target_modal", row),
            amodal=shard.image("target_amodal", row),
            occupancy=shard.image("occupancy", row),
            focal_length=float(shard.rows("intrinsics")[row, 0, 0]),
        )

    def sample(self, index: int) -> Sample:
        """Returns all that is on disk of an item.

        Raises:
            IndexError: there is no such item.
        """
        shard, row = self._shard_of(self._checked(index))
        return shard.sample(row)

    def _checked(self, index: int) -> int:
        if not -len(self) <= index < len(self):
            raise IndexError(f"item {index} of {len(self)}")
        return index % len(self)

    def _shard_of(self, index: int) -> tuple[ShardReader, int]:
        number, row = self._places[index].tolist()
        shard = self._open_shards.pop(number, None)
        if shard is None:
            if len(self._open_shards) >= _MAX_OPEN:
                _, oldest = self._open_shards.popitem(last=False)
                oldest.close()
            shard = ShardReader(self._paths[number])
        self._open_shards[number] = shard
        return shard, row


def is_held_out(heap_seed: int, share: float) -> bool:
    """Tells whether all images of a heap are for validation.

    Decided by the seed alone: the same on every machine and for every target.
    """
    digest = hashlib.blake2b(str(heap_seed).encode(), digest_size=8).digest()
    return int.from_bytes(digest, "big") < share * 2**64
