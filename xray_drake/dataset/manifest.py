"""``dataset.json``: what a dataset is meant to hold."""

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from xray_drake.files import write_whole_file
from xray_drake.splits import SPLITS

MANIFEST_NAME = "dataset.json"

FORMAT_VERSION = 1
"""Of the manifest and of the shards."""


_VERSIONS = ("drake_version", "package_version")
"""Fields that say by what a dataset was begun."""


class DatasetError(ValueError):
    """A dataset that cannot be used: what, where, what to do."""


@dataclass(frozen=True)
class ExpectedShard:
    """A shard that a complete dataset has.

    Attributes:
        split: one of :data:`SPLITS`.
        index: 0, 1, … within the split.
        first: how many samples of the split lie in the shards before it.
        count: samples in it, at least 1.
    """

    split: str
    index: int
    first: int
    count: int

    @property
    def name(self) -> str:
        """Its file's name, e.g. ``train-00012.h5``."""
        return f"{self.split}-{self.index:05d}.h5"


@dataclass(frozen=True)
class Manifest:
    """The arguments that a dataset is made from; nothing else decides it.

    Attributes:
        seed: of the whole dataset.
        targets: names of the targets.
        splits: split to its number of samples.
        shard_size: samples per shard; a split's last may hold fewer.
        views_per_heap: cameras per heap.
        snapshots: pictures per heap while it is dropped; 1 is at the end only.
        height, width: of the images, pixels.
        color: the shards hold colour images.
        meshes: folders of imported distractors.
        scenario: as YAML.
        options: whatever else the generator was told, as JSON takes it.
        drake_version: of the Drake that simulates and renders.
        package_version: of ``xray_drake``.
        format_version: of manifest and shards.

    Raises:
        ValueError: a field cannot be what it is.
    """

    seed: int
    targets: tuple[str, ...]
    splits: Mapping[str, int]
    shard_size: int
    views_per_heap: int
    height: int
    width: int
    scenario: str
    snapshots: int = 1
    color: bool = False
    meshes: tuple[str, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)
    drake_version: str = ""
    package_version: str = ""
    format_version: int = FORMAT_VERSION

    def __post_init__(self) -> None:
        object.__setattr__(self, "targets", tuple(self.targets))
        object.__setattr__(self, "meshes", tuple(map(str, self.meshes)))
        for split, count in self.splits.items():
            if split not in SPLITS:
                raise ValueError(
                    f"no split is called {split!r}: {', '.join(SPLITS)}"
                )
            if count < 0:
                raise ValueError(f"split {split!r} has {count} samples")
        object.__setattr__(
            self, "splits", {s: int(self.splits.get(s, 0)) for s in SPLITS}
        )
        for name in (
            "shard_size",
            "views_per_heap",
            "snapshots",
            "height",
            "width",
        ):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}, below 1")
        if not self.targets:
            raise ValueError("targets is empty")

    @property
    def num_samples(self) -> int:
        """Samples of all splits."""
        return sum(self.splits.values())

    def expected_shards(self) -> tuple[ExpectedShard, ...]:
        """Returns every shard of the complete dataset, in order."""
        return tuple(
            ExpectedShard(
                split=split,
                index=index,
                first=first,
                count=min(self.shard_size, count - first),
            )
            for split, count in self.splits.items()
            for index, first in enumerate(range(0, count, self.shard_size))
        )

    def to_dict(self) -> dict[str, Any]:
        """Returns the manifest as JSON takes it."""
        return dataclasses.asdict(self)

    def fingerprint(self) -> str:
        """Returns 16 hex digits that tell datasets apart; shards carry it."""
        return _fingerprint(self.to_dict())


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Writes ``dataset.json``, completely or not at all.

    Raises:
        OSError: it cannot be written.
    """
    tree = {**manifest.to_dict(), "fingerprint": manifest.fingerprint()}
    text = json.dumps(tree, indent=1, ensure_ascii=False) + "\n"
    write_whole_file(folder / MANIFEST_NAME, text.encode())


def read_manifest(folder: Path) -> Manifest:
    """Reads ``dataset.json``.

    Raises:
        DatasetError: the folder holds none, or one that is damaged or was
            changed by hand.
    """
    path = folder / MANIFEST_NAME
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        raise DatasetError(
            f"{folder} is no dataset: it has no {MANIFEST_NAME}; make one "
            "with 'xray-drake generate'"
        ) from None
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise DatasetError(f"{path} is damaged: {error}") from error
    version = tree.get("format_version") if isinstance(tree, dict) else None
    if version != FORMAT_VERSION:
        raise DatasetError(
            f"{path} has format version {version!r}; this xray-drake reads "
            f"{FORMAT_VERSION}"
        )
    if tree.pop("fingerprint", None) != _fingerprint(tree):
        raise DatasetError(
            f"{path} is damaged, or was changed: its fingerprint does not match"
        )
    try:
        return Manifest(**tree)
    except (TypeError, ValueError, AttributeError) as error:
        raise DatasetError(f"{path} is damaged: {error}") from error


def check_same(
    folder: Path, manifest: Manifest, *, mix: bool = False
) -> Manifest:
    """Checks that a folder's dataset is the one that is to be continued.

    Args:
        folder: of the dataset.
        manifest: of what is to be continued.
        mix: it may have been begun by other versions.

    Returns:
        The folder's manifest; but for versions it is the same.

    Raises:
        DatasetError: it is another one; names the first field that differs.
    """
    begun = read_manifest(folder)
    # As JSON gives it back: lists for tuples.
    found, wanted = (
        json.loads(json.dumps(each.to_dict())) for each in (begun, manifest)
    )
    for name, value in found.items():
        if mix and name in _VERSIONS:
            continue
        if value != wanted[name]:
            raise DatasetError(
                f"{folder} was begun with {_difference(name, value)}, not "
                f"{_difference(name, wanted[name])}: resume with the same "
                "arguments, or choose another folder"
            )
    return begun


def _fingerprint(tree: dict[str, Any]) -> str:
    text = json.dumps(tree, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _difference(name: str, value: object) -> str:
    text = repr(value)
    if len(text) > 80:
        digest = hashlib.sha256(text.encode()).hexdigest()[:8]
        return f"another {name} (digest {digest})"
    return f"{name} {text}"
