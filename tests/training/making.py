"""Runs and shards of items that tests make."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from xray_drake.occupancy.learned.weights import NetworkCard
from xray_drake.training.config import TrainConfig
from xray_drake.training.items import Item, pack
from xray_drake.training.prepare import Prepared, plan, prepare_shard
from xray_drake.training.run import RunOptions, train

SMALL: dict[str, Any] = {"widths": [8, 8, 8, 8], "depths": [1, 1, 1, 1]}
"""Options of a small compact network."""


def train_here(
    dataset: Path, out: Path, config: TrainConfig, **options: Any
) -> NetworkCard:
    """Trains on the CPU, without a bar; ``options`` are of ``RunOptions``."""
    here = {"accelerator": "cpu", "progress": False, **options}
    return train([dataset], config, RunOptions(out=out, **here))


def prepare_here(dataset: Path, cache: Path, config: TrainConfig) -> list[Path]:
    """Prepares the items of a run, so that it starts no processes for it."""
    cache.mkdir()
    share = config.validation_share
    jobs = plan([dataset], cache, config.prepare, share)
    for job in jobs:
        prepare_shard(*job, config.prepare, share)
    return [path for _, path in jobs]


def shard_of(
    items: Sequence[Item],
    sizes: np.ndarray,
    targets: Sequence[str],
    held_out: Sequence[bool],
) -> Prepared:
    """Packs items; those are real whose target is not called virtual."""
    packed = [pack(item) for item in items]
    return Prepared(
        packed=np.frombuffer(b"".join(packed), np.uint8),
        ends=np.cumsum([len(data) for data in packed]),
        shape=items[0].fine.shape[1:],
        sizes=sizes.astype(np.float32),
        real=np.array([not name.startswith("virtual_") for name in targets]),
        held_out=np.array(held_out),
        targets=tuple(targets),
    )
