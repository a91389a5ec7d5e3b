"""Small samples that obey every rule, made without Drake."""

import dataclasses
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.dataset.whole import write_dataset, write_one
from xray_drake.dataset.manifest import Manifest
from xray_drake.dataset.sample import Sample, depth_on_disk
from xray_drake.geometry.camera import PinholeCamera

_SHAPE = (24, 32)
_SIZE = (0.12, 0.06, 0.005)


def synthetic_sample(
    heap_seed: int = 0,
    *,
    view: int = 0,
    cover: float = 0.5,
    color: bool = False,
    shape: tuple[int, int] = _SHAPE,
    target_name: str = "box_2to1",
    size: Sequence[float] = _SIZE,
) -> Sample:
    """A flat target under a plate that covers its left part.

    Args:
        heap_seed: where target and plate lie, and the key.
        view: the key.
        cover: share of the target's length under the plate; 0 to 1.
        color: with a colour image.
        shape: of the images.
        target_name: the key.
        size: of the target, m.
    """
    height, width = shape
    f, cx, cy = 35.0 * width / 32, (width - 1) / 2, (height - 1) / 2
    X_WC = np.diag([1.0, -1, -1, 1])
    X_WC[2, 3] = 0.8
    camera = PinholeCamera(
        width=width,
        height=height,
        intrinsics=np.array([[f, 0, cx], [0, f, cy], [0, 0, 1]]),
        X_WC=X_WC,
    )
    rng = np.random.default_rng([heap_seed, view])
    sides = np.array(size)
    X_WT = np.eye(4)
    X_WT[:3, 3] = *rng.uniform(-0.04, 0.04, 2), sides[2] / 2

    def box(low: np.ndarray, high: np.ndarray) -> np.ndarray:
        p_W = camera.unproject(camera.plane_depth(high[2]))[..., :2]
        return np.all((p_W >= low[:2]) & (p_W <= high[:2]), axis=-1)

    low, high = X_WT[:3, 3] - sides / 2, X_WT[:3, 3] + sides / 2
    amodal = box(low, high)
    edge = low[0] + cover * sides[0]
    plate = box(
        np.array([low[0] - 0.08, low[1] - 0.04, sides[2]]),
        np.array([edge, high[1] + 0.04, 0.03]),
    )
    plate &= cover > 0
    modal = amodal & ~plate
    without = np.where(plate, camera.plane_depth(0.03), 0.8)
    without[0, :3] = 0.0
    near = np.roll(amodal, 1, axis=1) & plate
    return Sample(
        depth=depth_on_disk(
            np.where(modal, camera.plane_depth(sides[2]), without)
        ),
        depth_without_target=depth_on_disk(without),
        target_modal=modal,
        target_amodal=amodal,
        instances=np.where(modal, 1, 2 * plate).astype(np.uint8),
        occupancy=np.where(amodal, 1.0, np.where(near, 0.25, 0.0)),
        intrinsics=camera.intrinsics,
        X_WC=camera.X_WC,
        X_WT=X_WT,
        target_size=sides,
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

    def write_shard(
        self, name: str, samples: Sequence[Sample], **changes: Any
    ) -> None:
        write_one(self.folder, self.manifest, name, samples, **changes)


@pytest.fixture(scope="session")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> SmallDataset:
    """5 train, 2 validation, 3 test samples; 2 views of each heap.

    It is sound, and not to be changed.
    """
    counts = {"train": 5, "validation": 2, "test": 3}
    samples: list[Sample] = []
    for split, count in counts.items():
        for index in range(count):
            sample = synthetic_sample(
                100 * len(samples) // 2,
                view=index % 2,
                cover=(0.0, 0.4, 1.0)[index % 3],
                target_name=("box_2to1", "lid")[index % 2],
            )
            names = (f"{split}_a", f"{split}_b")
            samples.append(dataclasses.replace(sample, object_names=names))
    manifest = Manifest(
        seed=3,
        targets=("box_2to1", "lid"),
        splits=counts,
        shard_size=2,
        views_per_heap=2,
        height=_SHAPE[0],
        width=_SHAPE[1],
        scenario="name: tiny\n",
    )
    rest = iter(samples)
    folder = tmp_path_factory.mktemp("dataset")
    write_dataset(folder, manifest, lambda _: next(rest))
    return SmallDataset(folder, manifest, tuple(samples))


@pytest.fixture
def own_dataset(dataset: SmallDataset, tmp_path: Path) -> SmallDataset:
    """A copy of it, to be broken."""
    shutil.copytree(dataset.folder, tmp_path / "own")
    return dataclasses.replace(dataset, folder=tmp_path / "own")
