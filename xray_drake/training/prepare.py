"""Turns a dataset into arrays that a network trains on, once.

Reading a shard, computing heights and placing virtual targets costs more than
a training step. What comes of it is kept: for each shard of the dataset one
file of packed items. Files of shards that are there already are not made
again, so preparing can be stopped, and can follow a dataset that is still
being made.
"""

import hashlib
import io
import json
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import cv2
import numpy as np

from xray_drake.configuration import SEEDS, choice, count, number, number_list
from xray_drake.dataset.augmentation import DepthNoise, resize_mask, sense
from xray_drake.dataset.images import labelled_images
from xray_drake.dataset.manifest import DatasetError
from xray_drake.dataset.reader import is_held_out
from xray_drake.dataset.sample import Sample
from xray_drake.dataset.shards import ShardError, ShardReader, dataset_shards
from xray_drake.dataset.virtual import HIDDEN, is_virtual, virtual_sample
from xray_drake.files import remove_leftovers, sole_writer, write_whole_file
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.occupancy.learned.inputs import (
    geometry_input,
    size_features,
)
from xray_drake.processes import run_jobs
from xray_drake.seeding import stream
from xray_drake.training.disturbance import believed_camera
from xray_drake.training.items import Item, make_item, pack, unpack
from xray_drake.training.teacher import expected_occupancy

_VERSION = 3

LABELS = ("given", "expected")
"""What may be learned; see ``PrepareConfig.labels``."""


@dataclass(frozen=True)
class PrepareConfig:
    """How samples become items."""

    # Virtual targets placed into each image.
    virtual: int = count(2, "[0, 1000]")
    # Virtual targets are boxes of this length, width and thickness, m; of any
    # kind and size if empty.
    virtual_size: list[float] = number_list((), "(0, 1]", (0, 3))
    # Share of virtual targets for which a place is sought where nothing of
    # them is seen. (A network for windows has no use for those.)
    virtual_hidden: float = number(HIDDEN, "[0, 1]")
    # What is learned: "given", the dataset's labels, or "expected", what can be
    # known of them from the image (``training.teacher``). Items that are held
    # out keep those of the dataset.
    labels: str = choice("given", LABELS)
    # Share of items with the noise of a depth sensor.
    noisy: float = number(0.3, "[0, 1]")
    # Share of items whose camera is not quite where inference is told.
    miscalibrated: float = number(0.3, "[0, 1]")
    # Standard deviations of the camera's height, m, ...
    height_error: float = number(0.0015, "[0, 0.5]")
    # ... of its tilt about both axes, rad, ...
    tilt_error: float = number(0.002, "[0, 1]")
    # ... and of its focal length, relative.
    focal_error: float = number(0.005, "[0, 0.5]")
    # Share of masks that are a pixel too large or too small.
    mask_errors: float = number(0.1, "[0, 1]")
    # The sensor.
    noise: DepthNoise = field(default_factory=DepthNoise)
    seed: int = count(0, SEEDS)


@dataclass(frozen=True, eq=False)
class Prepared:
    """The items of one shard.

    Attributes:
        packed: (n bytes,) uint8, all items' one after the other.
        ends: (n,) int64, where each item ends in ``packed``.
        shape: H and W of the camera.
        sizes: (n, 5) float32, see ``size_features``.
        real: (n,) bool; False for a virtual target.
        held_out: (n,) bool; True for heaps kept for validation.
        targets: the targets' names.
    """

    packed: np.ndarray
    ends: np.ndarray
    shape: tuple[int, int]
    sizes: np.ndarray
    real: np.ndarray
    held_out: np.ndarray
    targets: tuple[str, ...]

    def item(self, row: int) -> Item:
        """Unpacks one item."""
        begin = self.ends[row - 1] if row else 0
        return unpack(self.packed[begin : self.ends[row]].tobytes(), self.shape)


def plan(
    datasets: Sequence[Path],
    folder: Path,
    config: PrepareConfig,
    validation_share: float,
    *,
    incomplete: bool = False,
) -> list[tuple[Path, Path]]:
    """Lists all shards of datasets, and the file of each one's items.

    Args:
        datasets: folders.
        folder: where the items go.
        config: how they are made.
        validation_share: share of the heaps whose items are held out.
        incomplete: leave out shards that are missing.

    Raises:
        DatasetError: a dataset that cannot be read, or lacks a shard, or holds
            one of another.
    """
    jobs = []
    for dataset in datasets:
        for _, shard in dataset_shards(dataset, incomplete=incomplete):
            name = _item_name(
                shard.attributes.dataset,
                shard.path.name,
                config,
                validation_share,
            )
            jobs.append((shard.path, folder / name))
    if not jobs:
        names = ", ".join(map(str, datasets))
        raise DatasetError(f"no shard in {names}: run 'xray-drake generate'")
    return jobs


def prepare(
    jobs: Sequence[tuple[Path, Path]],
    config: PrepareConfig,
    validation_share: float,
    *,
    workers: int = 1,
) -> Iterator[int]:
    """Makes the items of shards; yields how many shards are done.

    Args:
        jobs: of :func:`plan`.
        config: the same as there.
        validation_share: the same as there.
        workers: processes; 0 makes them in this one.

    Raises:
        ShardError: a damaged shard.
        InUseError: another process makes items in their folder.
        OSError: the items cannot be written.
        RuntimeError: a fault, or a process died; the message names the shard.
    """
    missing = [job for job in jobs if not job[1].is_file()]
    done = len(jobs) - len(missing)
    yield done
    if not missing:
        return
    folders = sorted({path.parent for _, path in missing})
    with ExitStack() as stack:
        for folder in folders:
            folder.mkdir(parents=True, exist_ok=True)
            stack.enter_context(sole_writer(folder))
            remove_leftovers(folder)
        for _, error in run_jobs(
            partial(_prepare_job, config, validation_share),
            missing,
            workers=workers,
            preload=["xray_drake.training.prepare"],
            name=lambda job: str(job[0]),
        ):
            if error is not None:
                raise error
            done += 1
            yield done


def _prepare_job(
    config: PrepareConfig, validation_share: float, job: tuple[Path, Path]
) -> ShardError | OSError | None:
    """Makes the items of a shard; returns what is wrong with it."""
    try:
        prepare_shard(*job, config, validation_share)
    except (ShardError, OSError) as error:
        return error
    return None


def _item_name(
    fingerprint: str, shard: str, config: PrepareConfig, share: float
) -> str:
    """Names the file of a shard's items by all that decides what is in it."""
    what = json.dumps(
        [fingerprint, shard, asdict(config), share, _VERSION], sort_keys=True
    )
    digest = hashlib.blake2b(what.encode(), digest_size=6).hexdigest()
    return f"{Path(shard).stem}-{digest}.npz"


def prepare_shard(
    shard: Path, path: Path, config: PrepareConfig, validation_share: float
) -> None:
    """Makes the items of one shard."""
    cv2.setNumThreads(1)
    box = np.array(config.virtual_size) if config.virtual_size else None
    rows = []
    with ShardReader(shard) as reader:
        for index, key in enumerate(reader.keys):
            rng = stream(config.seed, f"prepare {key}")
            sample = reader.sample(index)
            kept = is_held_out(key.heap_seed, validation_share)
            made = [
                virtual_sample(
                    sample, rng, size=box, hidden=config.virtual_hidden
                )
                for _ in range(config.virtual)
            ]
            for each in (sample, *made):
                if each is None:
                    continue
                item, size = sample_item(
                    each, config, rng, given=kept or config.labels == "given"
                )
                real = not is_virtual(each.target_name)
                rows.append((pack(item), size, real, kept, each.target_name))
    packed, sizes, reals, held_out, targets = zip(*rows, strict=True)
    file = io.BytesIO()
    np.savez(
        file,
        packed=np.frombuffer(b"".join(packed), np.uint8),
        ends=np.cumsum([len(data) for data in packed]),
        shape=np.array(sample.camera.shape),
        sizes=np.array(sizes),
        real=np.array(reals),
        held_out=np.array(held_out),
        targets=np.array(targets),
    )
    write_whole_file(path, file.getvalue())


def open_prepared(path: Path) -> Prepared:
    """Reads the items of a shard, packed.

    Raises:
        OSError: it cannot be read.
        ValueError: it is damaged.
    """
    try:
        with np.load(path, allow_pickle=False) as arrays:
            parts: dict[str, Any] = {
                f.name: arrays[f.name] for f in fields(Prepared)
            }
            for name in ("shape", "targets"):
                parts[name] = tuple(parts[name].tolist())
            return Prepared(**parts)
    except (BadZipFile, EOFError, KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"{path} is damaged: remove it, and it is made again"
        ) from error


def sample_item(
    sample: Sample,
    config: PrepareConfig,
    rng: np.random.Generator,
    *,
    given: bool = True,
) -> tuple[Item, np.ndarray]:
    """Returns a sample's item and (5,) features.

    The sensor's noise and the errors of calibration are drawn here.

    Args:
        sample: without them.
        config: how they are drawn.
        rng: draws them.
        given: with the sample's own label; or with what can be known of it.
    """
    camera = sample.camera
    seen = labelled_images(sample)
    occupancy = seen.occupancy if given else expected_occupancy(sample)
    if rng.random() < config.noisy:
        seen = sense(seen, config.noise, rng)
    if rng.random() < config.mask_errors and np.count_nonzero(seen.modal) > 40:
        changed = resize_mask(seen, int(rng.choice([-1, 1])))
        # A sliver that is lost would have another label.
        seen = changed if changed.modal.any() else seen
    if rng.random() < config.miscalibrated:
        camera = _miscalibrated(camera, config, rng)
    size = sample.target_size
    inputs = geometry_input(
        seen.depth, seen.modal, camera, float(size[2]), sample.floor
    )
    item = make_item(inputs, occupancy, seen.amodal)
    return item, size_features(size, seen.modal, camera)


def _miscalibrated(
    camera: PinholeCamera, config: PrepareConfig, rng: np.random.Generator
) -> PinholeCamera:
    a, b = rng.normal(0, config.tilt_error, 2)
    R, _ = np.linalg.qr(np.array([[1, 0, -b], [0, 1, a], [b, -a, 1]]))
    R = R * np.sign(np.diag(R))
    X_WC = np.array(camera.X_WC)
    X_WC[:3, :3] = X_WC[:3, :3] @ R
    return believed_camera(
        replace(camera, X_WC=X_WC),
        rng.normal(0, config.height_error),
        rng.normal(0, config.focal_error),
    )
