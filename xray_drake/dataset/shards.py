"""Shards: HDF5 files of labelled images that know when they are damaged.

HDF5 keeps the checksums: a Fletcher-32 of each array, and of each image by
itself, is checked whenever it is read, as are its own of the file's metadata;
a truncated file is found when it is opened.
"""

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Self

import h5py
import numpy as np

from xray_drake.cell.bin import Bin
from xray_drake.configuration import (
    build,
)
from xray_drake.dataset.manifest import (
    FORMAT_VERSION,
    DatasetError,
    ExpectedShard,
    Manifest,
    read_manifest,
)
from xray_drake.dataset.sample import (
    IMAGES,
    MATRICES,
    METRES_PER_COUNT,
    NUMBERS,
    Sample,
    SampleKey,
    decode_depth,
    decode_occupancy,
    encode_depth,
    encode_occupancy,
)
from xray_drake.files import write_whole_file
from xray_drake.splits import SPLITS
from xray_drake.trees import read_tree

_LIBVER = ("v110", "v110")
"""Readable from HDF5 1.10 on; its metadata carry checksums."""


def _encode_bytes(image: np.ndarray) -> np.ndarray:
    return image.astype(np.uint8)


def _decode_mask(stored: np.ndarray) -> np.ndarray:
    return stored.astype(bool)


_Encoding = Callable[[np.ndarray], np.ndarray]

_ENCODINGS: Mapping[str, tuple[_Encoding, _Encoding]] = {
    "depth": (encode_depth, decode_depth),
    "depth_without_target": (encode_depth, decode_depth),
    "target_modal": (_encode_bytes, _decode_mask),
    "target_amodal": (_encode_bytes, _decode_mask),
    "instances": (_encode_bytes, np.asarray),
    "occupancy": (encode_occupancy, decode_occupancy),
    "color": (_encode_bytes, np.asarray),
}
"""How an image goes to disk and comes back."""


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
    write_whole_file(path, _hdf5_image(samples, attributes))


def verify_shard(path: Path) -> None:
    """Reads all samples of a shard, and so compares all checksums.

    Raises:
        ShardError: it is damaged.
        OSError: it cannot be read at all.
    """
    with ShardReader(path) as shard:
        for index in range(len(shard)):
            shard.sample(index)


class ShardReader:
    """Reads single samples of a shard when they are asked for.

    Opens the file at the first use, again in every process that it is sent or
    forked to. Checks an image's checksum when it reads it;
    :func:`verify_shard` checks everything.

    All methods raise :class:`ShardError` for a damaged file, ``OSError`` for
    one that cannot be read at all.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self._file: h5py.File | None = None
        self._pid = -1
        self._keys: tuple[SampleKey, ...] | None = None
        self._bin: Bin | None = None

    def __reduce__(self) -> tuple[type, tuple[Path]]:
        return ShardReader, (self.path,)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
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
            numbers = [self._read(name).tolist() for name in NUMBERS]
            with _naming_damage(self.path):
                names = [text.decode() for text in self._read("target_name")]
                self._keys = tuple(
                    SampleKey(seed, name, view, dropped)
                    for name, seed, view, dropped in zip(
                        names, *numbers, strict=True
                    )
                )
        return self._keys

    @property
    def attributes(self) -> ShardAttributes:
        """What all samples have in common."""
        with _naming_damage(self.path):
            stored = self._open().attrs
            kinds = {f.name: f.type for f in fields(ShardAttributes)}
            return ShardAttributes(
                **{
                    name: kind(stored[name])  # type: ignore[operator]
                    for name, kind in kinds.items()
                    if name in stored or name != "index"
                }
            )

    @property
    def bin(self) -> Bin:
        """The bin in which all heaps lie: that of the scenario's cell."""
        if self._bin is None:
            tree = read_tree(self.attributes.scenario, str(self.path))
            part = tree.get("cell", {}).get("bin", {})
            self._bin = build(Bin, part, str(self.path))
        return self._bin

    @property
    def shape(self) -> tuple[int, int]:
        """``(height, width)`` of the images."""
        with _naming_damage(self.path):
            height, width = self._open()["depth"].shape[1:]
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
        _, decode = _ENCODINGS[name]
        return decode(self._read(name, index))

    def rows(self, name: str) -> np.ndarray:
        """Returns (N, ...) of all samples: a matrix or a number each.

        Args:
            name: ``intrinsics``, ``X_WC``, ``X_WT``, ``target_size``,
                ``heap_seed``, ``view`` or ``num_dropped``.
        """
        return self._read(name)

    def object_names(self) -> list[tuple[str, ...]]:
        """Returns the names of the distractors of all samples."""
        texts = self._read("object_names")
        with _naming_damage(self.path):
            return [tuple(json.loads(text)) for text in texts]

    def sample(self, index: int) -> Sample:
        """Returns one sample, whole.

        Raises:
            IndexError: there is no such sample.
        """
        names = [*IMAGES, "color"] if self.has_color else IMAGES
        parts: dict[str, Any] = {n: self.image(n, index) for n in names}
        parts |= {name: self._read(name, index) for name in MATRICES}
        key, objects = self.keys[index], self._read("object_names", index)
        with _naming_damage(self.path):
            return Sample(
                **parts,
                object_names=json.loads(objects),
                bin=self.bin,
                **vars(key),
            )

    def _open(self) -> h5py.File:
        # A handle that was inherited by a fork is left alone.
        if self._file is None or self._pid != os.getpid():
            with _naming_damage(self.path):
                file = h5py.File(self.path, "r", locking=False, rdcc_nbytes=0)
                version = file.attrs["format_version"]
            self._file, self._pid = file, os.getpid()
            if version != FORMAT_VERSION:
                raise ForeignShardError(
                    f"{self.path} has format version {version}; this "
                    f"xray-drake reads {FORMAT_VERSION}"
                )
        return self._file

    def _read(self, name: str, at: Any = slice(None)) -> Any:
        """Returns what is stored of all samples, or of one."""
        with _naming_damage(self.path):
            return self._open()[name][at]


def dataset_shards(
    folder: Path, *, split: str | None = None, incomplete: bool = False
) -> Iterator[tuple[ExpectedShard, ShardReader]]:
    """Yields the shards of a dataset in their order, open.

    Args:
        folder: of the dataset.
        split: of this split; None is all.
        incomplete: leave out shards that are missing.

    Raises:
        DatasetError: the folder is no dataset, or a shard is missing, damaged
            or another one.
        ValueError: there is no such split.
        OSError: a shard cannot be read at all.
    """
    if split not in (None, *SPLITS):
        raise ValueError(f"no split is called {split!r}: {', '.join(SPLITS)}")
    manifest = read_manifest(folder)
    for expected in manifest.expected_shards():
        path = folder / expected.name
        if split not in (None, expected.split):
            continue
        if path.is_file():
            with open_shard(folder, manifest, expected) as shard:
                yield expected, shard
        elif not incomplete:
            raise DatasetError(
                f"{path} is missing: resume 'xray-drake generate', or give "
                "--incomplete to take what is there"
            )


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
    wanted = manifest.height, manifest.width
    if shard.shape != wanted:
        yield f"has images of {shard.shape}, not {wanted}"
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
        reason = " ".join(str(error).split())
        raise ShardError(f"{path} is damaged or no shard: {reason}") from error


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
        file.attrs.update(vars(attributes))
        file.attrs["metres_per_count"] = METRES_PER_COUNT
        for name, (encode, _) in _ENCODINGS.items():
            images = [getattr(s, name) for s in samples]
            if images[0] is not None:
                # One chunk each, so that each can be read alone.
                _add(file, name, np.stack(list(map(encode, images))), rows=1)
        for name in (*MATRICES, *NUMBERS):
            _add(file, name, np.stack([getattr(s, name) for s in samples]))
        objects = (
            json.dumps(s.object_names, ensure_ascii=False) for s in samples
        )
        _add(file, "object_names", _strings(objects))
        _add(file, "target_name", _strings(s.target_name for s in samples))
        file.flush()
        return file.id.get_file_image()


def _strings(texts: Iterable[str]) -> np.ndarray:
    encoded = [text.encode() for text in texts]
    length = max(1, *map(len, encoded))
    kind = h5py.string_dtype("utf-8", length)
    return np.array(encoded, dtype=f"S{length}").astype(kind)


def _add(
    file: h5py.File, name: str, data: np.ndarray, rows: int | None = None
) -> None:
    file.create_dataset(
        name,
        data=data,
        chunks=(rows or len(data), *data.shape[1:]),
        compression="gzip",
        compression_opts=4,
        shuffle=True,
        fletcher32=True,
        track_times=False,
    )
