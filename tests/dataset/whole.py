"""Datasets that tests write themselves."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from xray_drake.dataset.manifest import Manifest, write_manifest
from xray_drake.dataset.sample import Sample
from xray_drake.dataset.shards import (
    ShardAttributes,
    ShardReader,
    write_shard,
)


def bare_sample(
    seen: np.ndarray, *, focal_length: float, heap_seed: int = 0
) -> Sample:
    """Returns a target on a bare floor, 0.8 m below the camera.

    Args:
        seen: (H, W) bool, the target; modal, amodal mask and label are this.
        focal_length: of the camera, pixels.
        heap_seed: the key.
    """
    height, width = seen.shape
    f, cx, cy = focal_length, (width - 1) / 2, (height - 1) / 2
    X_WC = np.diag([1.0, -1, -1, 1])
    X_WC[2, 3] = 0.8
    X_WT = np.eye(4)
    X_WT[2, 3] = 0.0025
    return Sample(
        depth=np.where(seen, 0.795, 0.8),
        depth_without_target=np.full(seen.shape, 0.8),
        target_modal=seen,
        target_amodal=seen,
        instances=seen,
        occupancy=seen,
        intrinsics=np.array([[f, 0, cx], [0, f, cy], [0, 0, 1]]),
        X_WC=X_WC,
        X_WT=X_WT,
        target_size=np.array([0.19, 0.1, 0.005]),
        object_names=(),
        target_name="box_2to1",
        heap_seed=heap_seed,
        num_dropped=11,
    )


def flip_bit(path: Path, image: int = 0) -> None:
    """Changes a bit of a shard, in a depth image."""
    data = bytearray(path.read_bytes())
    with h5py.File(path) as file:
        chunk = file["depth"].id.get_chunk_info(image)
    data[chunk.byte_offset + chunk.size // 2] ^= 1
    path.write_bytes(data)


def read_shard(path: Path) -> list[Sample]:
    """Reads all samples of a shard."""
    with ShardReader(path) as shard:
        return [shard.sample(i) for i in range(len(shard))]


def write_one(
    folder: Path,
    manifest: Manifest,
    name: str,
    samples: Sequence[Sample],
    **changes: Any,
) -> None:
    """Writes a shard of a dataset; ``changes`` to its attributes."""
    split, _, number = Path(name).stem.partition("-")
    attributes = ShardAttributes(
        split=split,
        scenario=manifest.scenario,
        package_version="0.1.0",
        drake_version="1.51.1",
        dataset=manifest.fingerprint(),
        index=int(number),
    )
    write_shard(folder / name, samples, replace(attributes, **changes))


def write_dataset(
    folder: Path, manifest: Manifest, make: Callable[[int], Sample]
) -> Path:
    """Writes a complete dataset; ``make`` gives the sample of a number."""
    write_manifest(folder, manifest)
    for shard in manifest.expected_shards():
        samples = [make(shard.first + i) for i in range(shard.count)]
        write_one(folder, manifest, shard.name, samples)
    return folder


def tiny_dataset(
    folder: Path,
    make: Callable[[int], Sample],
    count: int,
    *,
    shard_size: int,
    targets: tuple[str, ...] = ("box_2to1",),
    seed: int = 0,
    views: int = 1,
    shape: tuple[int, int] = (64, 96),
) -> Path:
    """Writes a dataset of one split, "train"; arguments as its manifest's."""
    manifest = Manifest(
        seed=seed,
        targets=targets,
        splits={"train": count},
        shard_size=shard_size,
        views_per_heap=views,
        height=shape[0],
        width=shape[1],
        scenario="name: tiny\n",
    )
    return write_dataset(folder, manifest, make)
