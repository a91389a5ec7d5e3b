"""Makes labelled images: drops heaps, takes pictures, computes labels."""

import gc
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from zlib import crc32

import numpy as np
from pydrake.systems.sensors import CameraConfig

from xray_drake.cell.cameras import sample_camera
from xray_drake.configuration import with_paths
from xray_drake.dataset.check import TILTED
from xray_drake.dataset.manifest import ExpectedShard, Manifest
from xray_drake.dataset.pictures import Photographer
from xray_drake.dataset.sample import Sample, depth_on_disk, problems
from xray_drake.dataset.shards import ShardAttributes, write_shard
from xray_drake.geometry.floor_grid import Floor
from xray_drake.occupancy.geometric.inference import GeometricInference
from xray_drake.occupancy.label.ground_truth import occupancy_label
from xray_drake.provenance import versions
from xray_drake.ranges import Interval
from xray_drake.scene.heap import Heap
from xray_drake.scene.object_model import ObjectModel
from xray_drake.scene.targets import target_model
from xray_drake.seeding import stream
from xray_drake.splits import SPLITS
from xray_drake.station.objects import (
    imported_objects,
    make_heap,
    snapshot_counts,
)
from xray_drake.station.scenario import (
    Scenario,
    parse_scenario,
    record_scenario,
)

LABELS = ("paper", "exact")
"""As the paper defines it; or with exact placement."""

_HEAPS_PER_SPLIT = 10**7
_HEAPS_PER_SEED = 10**8
_SEEDS = Interval(0, 2**63 // _HEAPS_PER_SEED - 3, whole=True)
"""Heaps' seeds begin beyond those of searches and benchmarks."""

_SMALLEST = 1 / 255
"""What the true place has at least in a label of exact placement."""


@dataclass(frozen=True)
class ShardReport:
    """What a shard cost.

    Attributes:
        name: of the shard's file.
        samples: in it.
        heaps: that it took.
        failures: one line each heap that failed and was drawn again, with its
            seed.
        cpu: s of processor time, imports left out.
        seconds: share of that by stage: heap, pictures, label, disk.
    """

    name: str
    samples: int
    heaps: int
    failures: tuple[str, ...]
    cpu: float
    seconds: dict[str, float] = field(default_factory=dict)


def plan_dataset(
    scenario: Scenario,
    *,
    splits: Mapping[str, int],
    seed: int = 0,
    targets: tuple[str, ...] = (),
    views_per_heap: int = 1,
    snapshots: int = 1,
    shard_size: int = 50,
    color: bool = False,
    label: str = "paper",
) -> Manifest:
    """Writes down what a dataset is to be.

    Args:
        scenario: gives heaps, cameras and meshes. Its seed is not used.
        splits: split to its number of images.
        seed: of the whole dataset.
        targets: names, in turn from heap to heap; by default the scenario's.
        views_per_heap: cameras for each state of a heap.
        snapshots: states of a heap that are looked at: while it grows, and
            the last at rest.
        shard_size: images per file, made a multiple of those per heap.
        color: with colour images.
        label: one of ``LABELS``.

    Raises:
        ValueError: a seed out of range, a number below 1, a target or label
            that does not exist, or more snapshots than a small heap has.
    """
    if label not in LABELS:
        raise ValueError(
            f"no label is called {label!r}: choose one of {', '.join(LABELS)}"
        )
    if scenario.scene.heap_file:
        raise ValueError(
            "scene.heap_file gives one heap, and a dataset has many: leave it "
            "out"
        )
    targets = targets or (scenario.scene.target,)
    for target in targets:
        target_model(target)
    if said := _SEEDS.broken_by(seed):
        raise ValueError(f"the dataset's seed is {seed}: {said}")
    scenario = with_paths(scenario, Path())
    scene = scenario.scene
    random = scene.random_number
    for number in (
        range(random.least, random.most + 1)
        if random.mean > 0.0
        else [scene.num_objects]
    ):
        snapshot_counts(number, max(snapshots, 1))
    per_heap = max(views_per_heap * snapshots, 1)
    return Manifest(
        seed=seed,
        targets=targets,
        splits=splits,
        shard_size=-(-shard_size // per_heap) * per_heap,
        views_per_heap=views_per_heap,
        snapshots=snapshots,
        height=scenario.camera.height,
        width=scenario.camera.width,
        scenario=record_scenario(scenario),
        color=color,
        meshes=tuple(scenario.scene.meshes),
        options={"label": label},
        drake_version=versions()["drake"],
        package_version=versions()["xray_drake"],
    )


def make_shard(
    folder: Path, manifest: Manifest, shard: ExpectedShard
) -> Iterator[int | ShardReport]:
    """Makes one file of a dataset; the manifest alone decides what is in it.

    Args:
        folder: where it is written, completely or not at all.
        manifest: of the dataset.
        shard: which file.

    Yields:
        The number of samples made, heap by heap, and the report at last.

    Raises:
        RuntimeError: heap after heap of one seed failed, or a sample does not
            keep the rules of :func:`xray_drake.dataset.sample.problems`.
        OSError: the file cannot be written.
    """
    clock = _Clock()
    maker = SampleMaker(manifest, shard.split, clock)
    per_heap = manifest.views_per_heap * manifest.snapshots
    samples: list[Sample] = []
    for heap_index in range(
        shard.first // per_heap, -(-(shard.first + shard.count) // per_heap)
    ):
        made = maker.make(heap_index)
        samples += made[: shard.count - len(samples)]
        yield len(samples)
        gc.collect()
    with clock("disk"):
        write_shard(
            folder / shard.name,
            samples,
            ShardAttributes(
                split=shard.split,
                scenario=manifest.scenario,
                # Of what makes it: a dataset may be gone on with by another.
                package_version=versions()["xray_drake"],
                drake_version=versions()["drake"],
                dataset=manifest.fingerprint(),
                index=shard.index,
            ),
        )
    yield ShardReport(
        name=shard.name,
        samples=len(samples),
        heaps=maker.heaps,
        failures=tuple(maker.failures),
        cpu=sum(clock.seconds.values()),
        seconds=clock.seconds,
    )


class SampleMaker:
    """Makes the samples of one split, heap by heap.

    Attributes:
        heaps: dropped so far.
        failures: one line each heap that failed and was drawn again.
    """

    def __init__(
        self, manifest: Manifest, split: str, clock: "_Clock | None" = None
    ) -> None:
        """Builds the maker.

        Args:
            manifest: of the dataset.
            split: one of its splits.
            clock: adds up the time of the stages.

        Raises:
            ScenarioError: a folder of meshes that cannot be used.
        """
        self._manifest = manifest
        self._split = split
        self._clock = clock or _Clock()
        self._scenario = parse_scenario(
            manifest.scenario, "dataset", searched=False
        )
        self._scenario.scene.split = split
        self._library = split_of_imported(
            imported_objects(self._scenario), split
        )
        self._targets: dict[str, Photographer] = {}
        self.heaps = 0
        self.failures: list[str] = []

    def make(self, index: int) -> list[Sample]:
        """Drops a heap and returns its samples.

        Args:
            index: of the heap within the split, from 0.

        Raises:
            RuntimeError: see :func:`make_shard`.
        """
        manifest, scenario = self._manifest, self._scenario
        scenario.seed = heap_seed(manifest.seed, self._split, index)
        scenario.scene.target = manifest.targets[index % len(manifest.targets)]
        with self._clock("heap"):
            heap = make_heap(
                scenario,
                library=self._library or None,
                snapshots=manifest.snapshots,
            )
        self.heaps += 1
        self.failures += heap.failures
        rng = stream(scenario.seed, "cameras")
        cameras = [
            sample_camera(scenario.camera, scenario.camera_sampling, rng)
            for _ in range(manifest.views_per_heap)
        ]
        states = (*heap.growth, heap)
        with self._clock("pictures"):
            models = {m.name: m for state in states for m in state.objects}
            photographer = Photographer(
                heap.target,
                list(models.values()),
                scenario.camera,
                scenario.cell.bin,
                color=manifest.color,
            )
        return [
            self._sample(photographer, state, camera, view)
            for state in states
            for view, camera in enumerate(cameras)
        ]

    def _alone(self, target: ObjectModel) -> Photographer:
        if target.name not in self._targets:
            self._targets[target.name] = Photographer(
                target, (), self._scenario.camera, None
            )
        return self._targets[target.name]

    def _sample(
        self,
        photographer: Photographer,
        heap: Heap,
        config: CameraConfig,
        view: int,
    ) -> Sample:
        target = heap.target
        X_WT = heap.poses[target.name]
        with self._clock("pictures"):
            photographer.place(heap)
            photographer.look_from(config)
            picture = photographer.take()
            alone = self._alone(target)
            alone.place(replace(heap, objects=(), poses={target.name: X_WT}))
            alone.look_from(config)
            target_depth = alone.depth()
        with self._clock("label"):
            label = occupancy_label(
                target_depth,
                picture.depth_without_target,
                picture.camera,
                X_WT[:3, 3],
                floor=self._scenario.cell.bin.floor,
            )
            occupancy = label.distribution
            flat = heap.target_tilt < TILTED
            if self._manifest.options["label"] == "exact" and flat:
                # ▲ The target placed exactly, with the rules of inference, in
                # place of the paper's grid.
                exact = (
                    _inference(target.name, self._scenario.cell.bin.floor)
                    .infer(
                        picture.depth_without_target,
                        label.modal,
                        picture.camera,
                    )
                    .data
                )
                occupancy = np.maximum(exact, _SMALLEST * label.amodal)
                occupancy = occupancy / occupancy.max()
        sample = Sample(
            depth=depth_on_disk(picture.depth),
            depth_without_target=depth_on_disk(picture.depth_without_target),
            target_modal=picture.instances == 1,
            target_amodal=label.amodal,
            instances=picture.instances,
            occupancy=occupancy,
            intrinsics=picture.camera.intrinsics,
            X_WC=picture.camera.X_WC,
            X_WT=X_WT,
            target_size=target.extents,
            object_names=picture.names,
            target_name=target.name,
            heap_seed=heap.seed,
            view=view,
            num_dropped=heap.num_dropped,
            color=picture.color,
            bin=self._scenario.cell.bin,
        )
        if wrong := problems(sample):
            raise RuntimeError(
                f"the sample of {sample.key} is not sound: {'; '.join(wrong)}"
            )
        return sample


def heap_seed(seed: int, split: str, index: int) -> int:
    """Returns the seed of a heap of a dataset.

    Args:
        seed: of the dataset.
        split: which part of it.
        index: of the heap within the split, from 0.

    Raises:
        ValueError: more heaps than there are seeds for.
    """
    if not 0 <= index < _HEAPS_PER_SPLIT:
        raise ValueError(f"a split has at most {_HEAPS_PER_SPLIT} heaps")
    start = (seed + 1) * _HEAPS_PER_SEED
    return start + SPLITS.index(split) * _HEAPS_PER_SPLIT + index


def split_of_imported(
    library: Mapping[str, ObjectModel], split: str
) -> dict[str, ObjectModel]:
    """Returns the imported objects of a split: 80, 10 and 10 % by their names.

    Raises:
        ValueError: there are objects, but none in the split.
    """
    shares = {"train": range(8), "validation": (8,), "test": (9,)}
    chosen = {
        name: model
        for name, model in library.items()
        if crc32(name.encode()) % 10 in shares[split]
    }
    if library and not chosen:
        raise ValueError(
            f"none of the {len(library)} imported objects is in the split "
            f"{split!r}: give more of them"
        )
    return chosen


@cache
def _inference(target: str, floor: Floor) -> GeometricInference:
    return GeometricInference(target_model(target), floor=floor)


class _Clock:
    """Adds up processor time by stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        since = time.process_time()
        yield
        elapsed = time.process_time() - since
        self.seconds[stage] = self.seconds.get(stage, 0.0) + elapsed
