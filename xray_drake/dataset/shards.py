"""Shards: HDF5 files of labelled images that know when they are damaged.

A shard begins with 512 bytes of text (HDF5's *user block*, which HDF5 tools
skip): length and SHA-256 of the rest. So a bit flipped anywhere is found, by
``verify_shard`` or by ``tail -c +513 SHARD | sha256sum``; a truncated file is
found when it is opened, and images carry a Fletcher-32 checksum each, which is
checked whenever they are read.
"""

import hashlib
import json
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import h5py
import numpy as np

from xray_drake.dataset.manifest import (
    FORMAT_VERSION,
    DatasetError,
    ExpectedShard,
    Manifest,
)
from xray_drake.dataset.sample import (
    IMAGES,
    METRES_PER_COUNT,
    Sample,
    SampleKey,
    decode_depth,
    decode_occupancy,
    encode_depth,
    encode_occupancy,
)
from xray_drake.files import write_whole_file

_HEADER_SIZE = 512
_HEADER = re.compile(
    rb"xray_drake shard 1\nbytes (\d+)\nsha256 ([0-9a-f]{64})\n\0*"
)

_LIBVER = ("v110", "v110")
"""Readable from HDF5 1.10 on; its metadata carry checksums."""

_COMPRESSION: dict[str, Any] = {
    "compression": "gzip",
    "compression_opts": 4,
    "shuffle": True,
}

_DEPTHS = ("depth", "depth_without_target")
_MASKS = ("target_modal", "target_amodal")
_MATRICES = ("intrinsics", "X_WC", "X_WT", "target_size")
_NUMBERS = ("heap_seed", "view", "num_dropped")


class ShardError(DatasetError):
    """A shard that is damaged or is none: which, and what is wrong."""


class ForeignShardError(ShardError):
    """A shard that is whole, but not the one that should be there.

    Attributes:
        reason: what is wrong, without what to do.
    """

    def __init__(self, reason: str) -> None:
        super().__init__(
            f"{reason}: 'xray-drake generate --resume' puts it aside and makes "
            "the right one"
        )
        self.reason = reason


@dataclass(frozen=True)
class ShardAttributes:
    """What all samples of a shard have in common.

    Attributes:
        split: train, validation or test.
        scenario: as YAML.
        package_version: of ``xray_drake``.
        drake_version: of the Drake that simulated and rendered.
        dataset: ``Manifest.fingerprint()`` of the dataset it belongs to.
        index: its number within the split; −1 of an older ``xray_drake``,
            which did not write it.
        format_version: of the shard.
    """

    split: str
    scenario: str
    package_version: str
    drake_version: str
    dataset: str = ""
    index: int = -1
    format_version: int = FORMAT_VERSION


def write_shard(
    path: Path, samples: Sequence[Sample], attributes: ShardAttributes
) -> None:
    """Writes a shard, completely or not at all.

    The same samples and attributes give the same bytes. Depths are rounded to
    0.1 mm and distributions to 1/255 (never to 0).

    Args:
        path: of the shard; replaced if it exists.
        samples: at least one, all of one shape, all with or all without
            colour, no key twice.
        attributes: of the shard.

    Raises:
        ValueError: the samples do not fit into one shard.
        OSError: it cannot be written (a full disk); nothing is left over.
    """
    _check_fit(samples)
    image = _hdf5_image(samples, attributes)
    write_whole_file(path, _header(image) + image)


def verify_shard(path: Path) -> None:
    """Reads every byte of a shard and compares with its checksum.

    Raises:
        ShardError: it is truncated or has a flipped bit.
        OSError: it cannot be read at all.
    """
    digest, length = hashlib.sha256(), 0
    with path.open("rb") as file:
        expected = _read_header(file.read(_HEADER_SIZE), path)
        while block := file.read(1 << 20):
            digest.update(block)
            length += len(block)
    if (length, digest.hexdigest()) != expected:
        raise ShardError(f"{path} is damaged: its checksum does not match")


def read_shard(path: Path) -> list[Sample]:
    """Verifies a shard and reads all its samples.

    Raises:
        ShardError: it is damaged.
        OSError: it cannot be read at all.
    """
    verify_shard(path)
    with ShardReader(path) as shard:
        return [shard.sample(i) for i in range(len(shard))]


class ShardReader:
    """Reads single samples of a shard when they are asked for.

    Opens the file at the first use, again in every process that it is sent or
    forked to. Checks the file's length when it opens, an image's checksum when
    it reads; :func:`verify_shard` checks everything.

    All methods raise :class:`ShardError` for a damaged file, ``OSError`` for
    one that cannot be read at all.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self._file: h5py.File | None = None
        self._pid = -1
        self._keys: tuple[SampleKey, ...] | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {"path": self.path, "_keys": self._keys}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(state["path"])  # type: ignore[misc]
        self._keys = state["_keys"]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Closes the file; the next use opens it again."""
        if self._file is not None and self._pid == os.getpid():
            self._file.close()
        self._file = None

    def __len__(self) -> int:
        return len(self.keys)

    @property
    def keys(self) -> tuple[SampleKey, ...]:
        """The key of each sample, in order; read once."""
        if self._keys is None:
            heap_seed, view, num_dropped = (
                self._whole(name) for name in _NUMBERS
            )
            names = self._strings("target_name")
            self._keys = tuple(
                SampleKey(int(seed), name, int(v), int(dropped))
                for seed, name, v, dropped in zip(
                    heap_seed, names, view, num_dropped, strict=True
                )
            )
        return self._keys

    @property
    def attributes(self) -> ShardAttributes:
        """What all samples have in common."""
        with _naming_damage(self.path):
            stored = dict(self._open().attrs)
            return ShardAttributes(
                split=str(stored["split"]),
                scenario=str(stored["scenario"]),
                package_version=str(stored["package_version"]),
                drake_version=str(stored["drake_version"]),
                dataset=str(stored["dataset"]),
                index=int(stored.get("index", -1)),
                format_version=int(stored["format_version"]),
            )

    @property
    def shape(self) -> tuple[int, int]:
        """``(height, width)`` of the images."""
        height, width = self._dataset("depth").shape[1:]
        return height, width

    @property
    def has_color(self) -> bool:
        """There are colour images."""
        with _naming_damage(self.path):
            return "color" in self._open()

    def image(self, name: str, index: int) -> np.ndarray:
        """Returns one image as :class:`Sample` has it.

        Args:
            name: one of ``IMAGES``, or ``"color"``.
            index: of the sample in the shard, not negative.

        Returns:
            (H, W) or (H, W, 3) array.

        Raises:
            IndexError: there is no such sample.
        """
        if not 0 <= index < len(self):
            raise IndexError(f"{self.path} has no sample {index}")
        dataset = self._dataset(name)
        with _naming_damage(self.path):
            stored = dataset[index]
        if name in _DEPTHS:
            return decode_depth(stored)
        if name in _MASKS:
            return stored.astype(bool)
        if name == "occupancy":
            return decode_occupancy(stored)
        return stored

    def rows(self, name: str) -> np.ndarray:
        """Returns (N, ...) of all samples: a matrix or a number each.

        Args:
            name: ``intrinsics``, ``X_WC``, ``X_WT``, ``target_size``,
                ``heap_seed``, ``view`` or ``num_dropped``.
        """
        return self._whole(name)

    def object_names(self) -> list[tuple[str, ...]]:
        """Returns the names of the distractors of all samples."""
        texts = self._strings("object_names")
        try:
            return [tuple(json.loads(text)) for text in texts]
        except json.JSONDecodeError as error:
            raise ShardError(
                f"{self.path} is damaged: object_names: {error}"
            ) from error

    def sample(self, index: int) -> Sample:
        """Returns one sample, whole.

        Raises:
            IndexError: there is no such sample.
        """
        images = {name: self.image(name, index) for name in IMAGES}
        if self.has_color:
            images["color"] = self.image("color", index)
        key = self.keys[index]
        return Sample(
            **images,
            **{name: self._whole(name)[index] for name in _MATRICES},
            object_names=self.object_names()[index],
            target_name=key.target_name,
            heap_seed=key.heap_seed,
            view=key.view,
            num_dropped=key.num_dropped,
        )

    def _open(self) -> h5py.File:
        # A handle that was inherited by a fork is left alone.
        if self._file is None or self._pid != os.getpid():
            with self.path.open("rb") as file:
                length, _ = _read_header(file.read(_HEADER_SIZE), self.path)
                file.seek(0, os.SEEK_END)
                found = file.tell() - _HEADER_SIZE
            if found != length:
                raise ShardError(
                    f"{self.path} is damaged: {found} bytes instead of {length}"
                )
            with _naming_damage(self.path):
                self._file = h5py.File(
                    self.path, "r", locking=False, rdcc_nbytes=0
                )
                version = self._file.attrs["format_version"]
            self._pid = os.getpid()
            if version != FORMAT_VERSION:
                raise ForeignShardError(
                    f"{self.path} has format version {version}; this "
                    f"xray-drake reads {FORMAT_VERSION}"
                )
        return self._file

    def _dataset(self, name: str) -> h5py.Dataset:
        with _naming_damage(self.path):
            return self._open()[name]

    def _whole(self, name: str) -> np.ndarray:
        dataset = self._dataset(name)
        with _naming_damage(self.path):
            return dataset[:]

    def _strings(self, name: str) -> list[str]:
        dataset = self._dataset(name)
        with _naming_damage(self.path):
            return [bytes(text).decode() for text in dataset[:]]


def open_shard(
    folder: Path, manifest: Manifest, expected: ExpectedShard
) -> ShardReader:
    """Opens a shard of a dataset; what does not belong to it is refused.

    Args:
        folder: of the dataset.
        manifest: of the dataset.
        expected: which of its shards.

    Raises:
        ForeignShardError: it is another one, or another dataset's.
        ShardError: it is damaged.
        OSError: it cannot be read at all.
    """
    shard = ShardReader(folder / expected.name)
    try:
        for problem in shard_problems(shard, manifest, expected):
            raise ForeignShardError(f"{shard.path} {problem}")
    except BaseException:
        shard.close()
        raise
    return shard


def shard_problems(
    shard: ShardReader, manifest: Manifest, expected: ExpectedShard
) -> Iterator[str]:
    """Yields in what a shard is not the one that is expected.

    Raises:
        ShardError: it is damaged.
        OSError: it cannot be read at all.
    """
    attributes = shard.attributes
    if attributes.dataset != manifest.fingerprint():
        yield f"belongs to another dataset, {attributes.dataset!r}"
    if attributes.split != expected.split:
        yield f"belongs to split {attributes.split!r}"
    if attributes.index not in (-1, expected.index):
        yield f"is number {attributes.index} of its split, renamed"
    if len(shard) != expected.count:
        yield f"has {len(shard)} samples instead of {expected.count}"
    if shard.shape != (manifest.height, manifest.width):
        yield (
            f"has images of {shard.shape}, not "
            f"{(manifest.height, manifest.width)}"
        )
    if shard.has_color != manifest.color:
        yield ("has" if shard.has_color else "lacks") + " colour images"


@contextmanager
def _naming_damage(path: Path) -> Iterator[None]:
    """Turns what h5py raises on damaged files into an error with the name."""
    try:
        yield
    except (ShardError, FileNotFoundError, PermissionError):
        raise
    except (OSError, KeyError, RuntimeError, ValueError, TypeError) as error:
        raise ShardError(f"{path} is damaged: {error}") from error


def _check_fit(samples: Sequence[Sample]) -> None:
    if not samples:
        raise ValueError("a shard needs at least one sample")
    first = samples[0]
    seen: set[SampleKey] = set()
    for sample in samples:
        if sample.shape != first.shape:
            raise ValueError(
                f"samples of {first.shape} and {sample.shape} in one shard"
            )
        if (sample.color is None) != (first.color is None):
            raise ValueError("samples with and without colour in one shard")
        if sample.key in seen:
            raise ValueError(f"sample twice in one shard: {sample.key}")
        seen.add(sample.key)


def _hdf5_image(
    samples: Sequence[Sample], attributes: ShardAttributes
) -> bytes:
    """Returns the bytes of the HDF5 file.

    Made in memory: HDF5 does not recover from a disk that is full.
    """
    with h5py.File(
        "shard.h5", "w", driver="core", backing_store=False, libver=_LIBVER
    ) as file:
        for field in fields(ShardAttributes):
            file.attrs[field.name] = getattr(attributes, field.name)
        file.attrs["metres_per_count"] = METRES_PER_COUNT
        for name in _DEPTHS:
            _add_images(
                file, name, (encode_depth(getattr(s, name)) for s in samples)
            )
        for name in (*_MASKS, "instances"):
            _add_images(
                file, name, (getattr(s, name).astype("u1") for s in samples)
            )
        _add_images(
            file, "occupancy", (encode_occupancy(s.occupancy) for s in samples)
        )
        if samples[0].color is not None:
            _add_images(
                file,
                "color",
                (s.color for s in samples if s.color is not None),
            )
        for name in _MATRICES:
            _add(file, name, np.stack([getattr(s, name) for s in samples]))
        for name in _NUMBERS:
            numbers = [getattr(s, name) for s in samples]
            _add(file, name, np.array(numbers, dtype=np.int64))
        _add_strings(
            file,
            "object_names",
            [json.dumps(s.object_names, ensure_ascii=False) for s in samples],
        )
        _add_strings(file, "target_name", [s.target_name for s in samples])
        num = len(samples)
        for name, dataset in file.items():
            if dataset.shape[0] != num:
                raise AssertionError(f"{name} has {dataset.shape[0]} of {num}")
        file.flush()
        return file.id.get_file_image()


def _add_images(
    file: h5py.File, name: str, images: Iterable[np.ndarray]
) -> None:
    """Adds images, one chunk each, so that each can be read alone."""
    stack = np.stack(list(images))
    file.create_dataset(
        name,
        data=stack,
        chunks=(1, *stack.shape[1:]),
        fletcher32=True,
        track_times=False,
        **_COMPRESSION,
    )


def _add(file: h5py.File, name: str, data: np.ndarray) -> None:
    file.create_dataset(
        name,
        data=data,
        chunks=data.shape,
        fletcher32=True,
        track_times=False,
        **_COMPRESSION,
    )


def _add_strings(file: h5py.File, name: str, texts: Sequence[str]) -> None:
    # Of fixed length: HDF5 keeps others where no checksum covers them.
    encoded = [text.encode() for text in texts]
    length = max(1, *map(len, encoded))
    kind = h5py.string_dtype("utf-8", length)
    _add(file, name, np.array(encoded, dtype=f"S{length}").astype(kind))


def _header(image: bytes) -> bytes:
    digest = hashlib.sha256(image).hexdigest()
    text = f"xray_drake shard 1\nbytes {len(image)}\nsha256 {digest}\n"
    return text.encode().ljust(_HEADER_SIZE, b"\0")


def _read_header(header: bytes, path: Path) -> tuple[int, str]:
    """Returns length and SHA-256 that the rest should have.

    Raises:
        ShardError: this is no header.
    """
    match = _HEADER.fullmatch(header)
    if match is None or len(header) != _HEADER_SIZE:
        raise ShardError(
            f"{path} is damaged or no shard: it does not begin as one"
        )
    return int(match[1]), match[2].decode()
