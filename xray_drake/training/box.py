"""The box of a network that knows a single one."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from xray_drake.dataset.shards import dataset_shards
from xray_drake.training.config import TrainConfig, TrainingError, single_box

_SAME = 5e-4
"""m, by which a size that was written by hand may be off."""


def box_size(
    datasets: Sequence[Path], config: TrainConfig
) -> tuple[float, float, float] | None:
    """Returns length, width and thickness of the box, m, as the samples say.

    Args:
        datasets: folders.
        config: of the run.

    Returns:
        None if the run is not of a single box, or there is no sample of it.

    Raises:
        DatasetError: a dataset that cannot be read.
        TrainingError: the configuration's virtual targets are of another size.
    """
    name = single_box(config)
    size = _size_of(name, datasets) if name else None
    wanted = config.prepare.virtual_size
    if size is None or not (wanted and config.virtual):
        return size
    if not np.allclose(size, wanted, rtol=0, atol=_SAME):
        raise TrainingError(
            f"prepare.virtual_size is {wanted}, but {name} in the dataset is "
            f"{[round(side, 5) for side in size]}"
        )
    return size


def _size_of(
    name: str, datasets: Sequence[Path]
) -> tuple[float, float, float] | None:
    for dataset in datasets:
        for _, shard in dataset_shards(dataset, incomplete=True):
            sizes = shard.rows("target_size").tolist()
            for key, size in zip(shard.keys, sizes, strict=True):
                if key.target_name == name:
                    return size[0], size[1], size[2]
    return None
