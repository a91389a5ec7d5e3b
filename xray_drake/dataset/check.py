"""Checks a dataset: every file, every byte, every sample."""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from xray_drake.dataset.manifest import (
    MANIFEST_NAME,
    ExpectedShard,
    Manifest,
    read_manifest,
)
from xray_drake.dataset.sample import Sample, SampleKey, problems
from xray_drake.dataset.shards import (
    ShardError,
    ShardReader,
    shard_problems,
)
from xray_drake.processes import Lost, run_jobs

FULLY_VISIBLE = 0.99
"""Visible fraction from which a target counts as fully visible."""

TOO_VISIBLE = 0.90
"""Benchmarks redraw heaps whose target is more visible than this."""

TILTED = math.radians(5)
"""rad. A target tilted by more does not lie flat."""


@dataclass(frozen=True)
class Defect:
    """Something that is wrong with a dataset.

    Attributes:
        file: name of the file in the dataset's folder.
        problem: one line.
        sample: index in the shard; −1 where it is the file as a whole.
        key: of the sample, as text; empty where it is the file as a whole.
    """

    file: str
    problem: str
    sample: int = -1
    key: str = ""

    def __str__(self) -> str:
        if self.sample < 0:
            return f"{self.file}: {self.problem}"
        return f"{self.file}: sample {self.sample} ({self.key}): {self.problem}"


@dataclass(frozen=True)
class SampleStatistics:
    """What is counted of one sample.

    Attributes:
        split: of its shard.
        target: its name.
        visible_fraction: of the target, in [0, 1].
        tilt: of the target, rad.
        num_objects: distractors in the bin.
        support: pixels where the distribution is not 0.
    """

    split: str
    target: str
    visible_fraction: float
    tilt: float
    num_objects: int
    support: int


@dataclass(frozen=True)
class CheckReport:
    """What a check found.

    Attributes:
        manifest: of the dataset.
        defects: in the order of files and samples; empty for a sound dataset.
        samples: one per sample that could be read; empty after a fast check.
        num_found: samples in the shards that could be opened.
        num_bytes: of all shards.
        versions: (package, Drake) to the shards that they wrote.
        deep: every byte was read and every sample looked at.
    """

    manifest: Manifest
    defects: tuple[Defect, ...]
    samples: tuple[SampleStatistics, ...]
    num_found: int
    num_bytes: int
    versions: Mapping[tuple[str, str], int]
    deep: bool

    @property
    def sound(self) -> bool:
        """There are no defects."""
        return not self.defects

    def statistics(self) -> dict[str, Any]:
        """Returns shares and means over the samples that could be read."""
        samples = self.samples
        if not samples:
            return {}
        visible = np.array([s.visible_fraction for s in samples])
        objects = np.array([s.num_objects for s in samples])

        def share(condition: np.ndarray) -> float:
            return round(float(np.mean(condition)), 4)

        return {
            "hidden": share(visible == 0),
            "partly_visible": share((visible > 0) & (visible <= FULLY_VISIBLE)),
            "fully_visible": share(visible > FULLY_VISIBLE),
            "more_than_90_percent_visible": share(visible > TOO_VISIBLE),
            "tilted_by_more_than_5_degrees": share(
                np.array([s.tilt for s in samples]) > TILTED
            ),
            "objects_mean": round(float(objects.mean()), 2),
            "objects_min": int(objects.min()),
            "objects_max": int(objects.max()),
            "support_median_pixels": int(
                np.median([s.support for s in samples])
            ),
            "targets": dict(sorted(Counter(s.target for s in samples).items())),
            "splits": dict(sorted(Counter(s.split for s in samples).items())),
        }

    def to_dict(self) -> dict[str, Any]:
        """Returns the report as JSON takes it."""
        return {
            "sound": self.sound,
            "deep": self.deep,
            "num_samples": self.num_found,
            "num_expected": self.manifest.num_samples,
            "num_bytes": self.num_bytes,
            "versions": [
                {"xray_drake": package, "drake": drake, "shards": count}
                for (package, drake), count in sorted(self.versions.items())
            ],
            "statistics": self.statistics(),
            "defects": [
                {
                    **asdict(d),
                    "sample": d.sample if d.sample >= 0 else None,
                    "key": d.key or None,
                }
                for d in self.defects
            ],
        }


@dataclass
class _ShardResult:
    """What one shard gave."""

    defects: list[Defect] = field(default_factory=list)
    keys: list[SampleKey] = field(default_factory=list)
    objects: list[tuple[str, ...]] = field(default_factory=list)
    samples: list[SampleStatistics] = field(default_factory=list)
    num_bytes: int = 0
    versions: tuple[str, str] | None = None


def check_dataset(
    folder: Path,
    *,
    deep: bool = True,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> CheckReport:
    """Checks that a dataset is what its manifest says.

    All shards there, none besides; no sample twice, no object in two splits;
    where ``deep``, every byte and every sample.

    Args:
        folder: of the dataset.
        deep: or else only what opening each shard tells: missing and truncated
            files, wrong counts, duplicates.
        workers: processes.
        progress: called with the number of shards done and of all.

    Raises:
        DatasetError: the folder is no dataset.
        OSError: the folder cannot be read.
    """
    manifest = read_manifest(folder)
    expected = manifest.expected_shards()
    defects = list(_unexpected(folder, {shard.name for shard in expected}))
    found: dict[ExpectedShard, _ShardResult] = {}
    for shard, result in run_jobs(
        partial(_check_shard, folder, manifest, deep),
        expected,
        # One process more would be slower than this one.
        workers=workers if workers > 1 else 0,
        preload=["xray_drake.dataset.check"],
        name=lambda shard: shard.name,
        lost=_lost,
    ):
        found[shard] = result
        if progress is not None:
            progress(len(found), len(expected))
    results = [found[shard] for shard in expected]
    defects += [defect for result in results for defect in result.defects]
    defects += _duplicates(expected, results)
    defects += _shared_objects(expected, results)
    defects.sort(key=lambda defect: (defect.file, defect.sample))
    return CheckReport(
        manifest=manifest,
        defects=tuple(defects),
        samples=tuple(s for result in results for s in result.samples),
        num_found=sum(len(result.keys) for result in results),
        num_bytes=sum(result.num_bytes for result in results),
        versions=Counter(r.versions for r in results if r.versions is not None),
        deep=deep,
    )


def _lost(lost: Lost[ExpectedShard]) -> "_ShardResult":
    """Returns what is told of a shard whose process died."""
    name = lost.job.name
    if lost.cause != "died":
        raise lost.error(name)
    return _ShardResult(defects=[Defect(name, lost.reason)])


def _unexpected(folder: Path, names: set[str]) -> Iterator[Defect]:
    for path in sorted(folder.iterdir()):
        if path.suffix == ".h5" and path.name not in names:
            yield Defect(path.name, f"{MANIFEST_NAME} knows no such shard")


def _check_shard(
    folder: Path, manifest: Manifest, deep: bool, expected: ExpectedShard
) -> _ShardResult:
    path = folder / expected.name
    result = _ShardResult()
    try:
        result.num_bytes = path.stat().st_size
        with ShardReader(path) as shard:
            _look(shard, manifest, deep, expected, result)
    except FileNotFoundError:
        result.defects.append(Defect(expected.name, "missing"))
    except ShardError as error:
        problem = str(error).removeprefix(f"{path} is ")
        result.defects.append(Defect(expected.name, problem))
    except OSError as error:
        problem = f"cannot be read: {error.strerror or error}"
        result.defects.append(Defect(expected.name, problem))
    return result


def _look(
    shard: ShardReader,
    manifest: Manifest,
    deep: bool,
    expected: ExpectedShard,
    result: _ShardResult,
) -> None:
    name = expected.name
    for problem in shard_problems(shard, manifest, expected):
        result.defects.append(Defect(name, problem))
    attributes = shard.attributes
    result.versions = attributes.package_version, attributes.drake_version
    result.keys, result.objects = list(shard.keys), shard.object_names()
    if not deep:
        return
    for index, key in enumerate(shard.keys):
        sample = shard.sample(index)
        lines = problems(sample)
        if key.target_name not in manifest.targets:
            lines.append(f"{MANIFEST_NAME} knows no target {key.target_name!r}")
        result.samples.append(_statistics(sample, expected.split))
        result.defects += [
            Defect(name, line, index, str(key)) for line in lines
        ]


def _statistics(sample: Sample, split: str) -> SampleStatistics:
    return SampleStatistics(
        split=split,
        target=sample.target_name,
        visible_fraction=sample.visible_fraction,
        tilt=sample.target_tilt,
        num_objects=len(sample.object_names),
        support=int(np.count_nonzero(sample.occupancy)),
    )


def _duplicates(
    expected: tuple[ExpectedShard, ...], results: list[_ShardResult]
) -> Iterator[Defect]:
    seen: dict[SampleKey, str] = {}
    for shard, result in zip(expected, results, strict=True):
        for index, key in enumerate(result.keys):
            if key in seen:
                yield Defect(
                    shard.name, f"also in {seen[key]}", index, str(key)
                )
            else:
                seen[key] = shard.name


def _shared_objects(
    expected: tuple[ExpectedShard, ...], results: list[_ShardResult]
) -> Iterator[Defect]:
    """Finds objects that are in two splits."""
    home: dict[str, str] = {}
    told: set[tuple[str, str]] = set()
    for shard, result in zip(expected, results, strict=True):
        for index, names in enumerate(result.objects):
            for name in names:
                other = home.setdefault(name, shard.split)
                if other != shard.split and (name, shard.split) not in told:
                    told.add((name, shard.split))
                    yield Defect(
                        shard.name,
                        f"object {name!r} is also in split {other!r}",
                        index,
                        str(result.keys[index]),
                    )
