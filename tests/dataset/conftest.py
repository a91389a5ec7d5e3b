"""Small samples that obey every rule, made without Drake."""

import dataclasses
import shutil
from collections.abc import Callable, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from xray_drake.dataset.manifest import Manifest, write_manifest
from xray_drake.dataset.sample import Sample, depth_on_disk
from xray_drake.dataset.shards import ShardAttributes, write_shard
from xray_drake.geometry.camera import PinholeCamera

_SHAPE = (24, 32)
_SIZE = np.array([0.12, 0.06, 0.005])


def synthetic_sample(
    heap_seed: int = 0,
    *,
    view: int = 0,
    cover: float = 0.5,
    color: bool = False,
    shape: tuple[int, int] = _SHAPE,
    target_name: str = "box_2to1",
) -> Sample:
    """A flat target under a plate that covers its left part.

    Args:
        heap_seed: where target and plate lie, and the key.
        view: the key.
        cover: share of the target's length under the plate; 0 to 1.
        color: with a colour image.
        shape: of the images.
        target_name: the key.
    """
    height, width = shape
    f = 35.0 * width / 32
    camera = PinholeCamera(
        width=width,
        height=height,
        intrinsics=np.array(
            [[f, 0, (width - 1) / 2], [0, f, (height - 1) / 2], [0, 0, 1]]
        ),
        X_WC=np.array(
            [[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.8], [0, 0, 0, 1]]
        ),
    )
    rng = np.random.default_rng([heap_seed, view])
    X_WT = np.eye(4)
    X_WT[:3, 3] = *rng.uniform(-0.04, 0.04, 2), _SIZE[2] / 2

    def box(low: np.ndarray, high: np.ndarray) -> np.ndarray:
        p_W = camera.unproject(camera.plane_depth(high[2]))[..., :2]
        return np.all((p_W >= low[:2]) & (p_W <= high[:2]), axis=-1)

    def paint(depth: np.ndarray, mask: np.ndarray, top: float) -> np.ndarray:
        return np.where(mask, camera.plane_depth(top), depth)

    low, high = X_WT[:3, 3] - _SIZE / 2, X_WT[:3, 3] + _SIZE / 2
    amodal = box(low, high)
    edge = low[0] + cover * _SIZE[0]
    plate = box(
        np.array([low[0] - 0.08, low[1] - 0.04, 0.005]),
        np.array([edge, high[1] + 0.04, 0.03]),
    )
    if cover == 0:
        plate[:] = False
    modal = amodal & ~plate
    floor = np.full(shape, 0.8)
    without = paint(floor, plate, 0.03)
    without[0, :3] = 0.0
    depth = np.where(modal, camera.plane_depth(0.005), without)
    instances = np.zeros(shape, np.uint8)
    instances[plate] = 2
    instances[modal] = 1
    near = np.roll(amodal, 1, axis=1) & plate
    occupancy = np.where(amodal, 1.0, np.where(near, 0.25, 0.0))
    return Sample(
        depth=depth_on_disk(depth),
        depth_without_target=depth_on_disk(without),
        target_modal=modal,
        target_amodal=amodal,
        instances=instances,
        occupancy=occupancy,
        intrinsics=camera.intrinsics,
        X_WC=camera.X_WC,
        X_WT=X_WT,
        target_size=_SIZE,
        object_names=("plate", "Löffel"),
        target_name=target_name,
        heap_seed=heap_seed,
        view=view,
        num_dropped=12,
        color=rng.integers(0, 255, (*shape, 3)) if color else None,
    )


@pytest.fixture(scope="session")
def make_sample() -> Callable[..., Sample]:
    return synthetic_sample


@dataclasses.dataclass(frozen=True)
class SmallDataset:
    """A dataset on disk and what is in it."""

    folder: Path
    manifest: Manifest
    samples: tuple[Sample, ...]

    def write(self) -> None:
        write_manifest(self.folder, self.manifest)
        rest = iter(self.samples)
        for shard in self.manifest.expected_shards():
            self.write_shard(shard.name, [*islice(rest, shard.count)])

    def write_shard(
        self, name: str, samples: Sequence[Sample], **changes: Any
    ) -> None:
        attributes = ShardAttributes(
            split=name.split("-")[0],
            scenario=self.manifest.scenario,
            package_version="0.1.0",
            drake_version="1.51.1",
            dataset=self.manifest.fingerprint(),
            index=int(Path(name).stem.split("-")[1]),
        )
        write_shard(
            self.folder / name,
            samples,
            dataclasses.replace(attributes, **changes),
        )


def small_dataset(folder: Path) -> SmallDataset:
    """5 train, 2 validation, 3 test samples; 2 views of each heap."""
    counts = {"train": 5, "validation": 2, "test": 3}
    samples = []
    for split, count in counts.items():
        for index in range(count):
            sample = synthetic_sample(
                100 * len(samples) // 2,
                view=index % 2,
                cover=(0.0, 0.4, 1.0)[index % 3],
                target_name=("box_2to1", "lid")[index % 2],
            )
            samples.append(
                dataclasses.replace(
                    sample, object_names=(f"{split}_a", f"{split}_b")
                )
            )
    return SmallDataset(
        folder,
        Manifest(
            seed=3,
            targets=("box_2to1", "lid"),
            splits=counts,
            shard_size=2,
            views_per_heap=2,
            height=_SHAPE[0],
            width=_SHAPE[1],
            scenario="name: tiny\n",
        ),
        tuple(samples),
    )


@pytest.fixture(scope="session")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> SmallDataset:
    """A sound dataset; not to be changed."""
    made = small_dataset(tmp_path_factory.mktemp("dataset"))
    made.write()
    return made


@pytest.fixture
def own_dataset(dataset: SmallDataset, tmp_path: Path) -> SmallDataset:
    """A copy of it, to be broken."""
    shutil.copytree(dataset.folder, tmp_path / "own")
    return dataclasses.replace(dataset, folder=tmp_path / "own")
