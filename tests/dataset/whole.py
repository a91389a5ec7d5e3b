"""Datasets that tests write themselves."""

from collections.abc import Callable
from pathlib import Path

from xray_drake.dataset.manifest import Manifest, write_manifest
from xray_drake.dataset.sample import Sample
from xray_drake.dataset.shards import ShardAttributes, write_shard


def write_dataset(
    folder: Path, manifest: Manifest, make: Callable[[int], Sample]
) -> Path:
    """Writes a complete dataset; ``make`` gives the sample of a number."""
    write_manifest(folder, manifest)
    for shard in manifest.expected_shards():
        write_shard(
            folder / shard.name,
            [make(shard.first + i) for i in range(shard.count)],
            ShardAttributes(
                split=shard.split,
                scenario=manifest.scenario,
                package_version="0.1.0",
                drake_version="1.51.1",
                dataset=manifest.fingerprint(),
            ),
        )
    return folder
