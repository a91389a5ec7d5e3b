"""Runs the making of shards over processes, or over a Ray cluster."""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import count
from pathlib import Path

from xray_drake.dataset.generator import ShardReport, make_shard
from xray_drake.dataset.manifest import (
    MANIFEST_NAME,
    ExpectedShard,
    Manifest,
    check_same,
    write_manifest,
)
from xray_drake.dataset.shards import (
    ForeignShardError,
    ShardError,
    open_shard,
    verify_shard,
)
from xray_drake.files import remove_leftovers, write_whole_file
from xray_drake.processes import ATTEMPTS, run_jobs
from xray_drake.provenance import Provenance, current
from xray_drake.threads import limit_threads

Progress = Callable[[str, int], None]
"""Is told a shard's name and how many of its samples are made."""


def open_dataset(
    folder: Path,
    manifest: Manifest,
    *,
    resume: bool,
    damaged: Callable[[Path, str], None] = lambda path, reason: None,
) -> tuple[ExpectedShard, ...]:
    """Begins a dataset, or takes one up again.

    For a :func:`xray_drake.files.sole_writer` of the folder.

    Args:
        folder: made if it does not exist.
        manifest: what is to be in it.
        resume: take up what a folder holds; otherwise it must hold none.
        damaged: told of a shard that is made again: a damaged one is removed,
            one that belongs elsewhere gets another name.

    Returns:
        The shards that are missing.

    Raises:
        ValueError: the folder holds a dataset and ``resume`` is off, or
            another one than the manifest's, or other things.
        OSError: it cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if (folder / MANIFEST_NAME).is_file():
        if not resume:
            raise ValueError(
                f"{folder} holds a dataset: give --resume to go on with it, "
                "or another folder"
            )
        check_same(folder, manifest)
    elif any(not path.name.startswith(".") for path in folder.iterdir()):
        raise ValueError(
            f"{folder} holds other files: choose an empty or a new folder"
        )
    else:
        write_manifest(folder, manifest)
    remove_leftovers(folder)
    missing = []
    for shard in manifest.expected_shards():
        path = folder / shard.name
        if path.is_file():
            try:
                verify_shard(path)
                open_shard(folder, manifest, shard).close()
                continue
            except ForeignShardError as error:
                aside = _aside(path)
                damaged(path, f"{error.reason} (kept as {aside.name})")
                path.rename(aside)
            except ShardError as error:
                damaged(path, str(error))
                path.unlink()
        missing.append(shard)
    return tuple(missing)


def _aside(path: Path) -> Path:
    """Returns a name for somebody's file that is in the way."""
    names = (path.with_name(f"{path.name}.aside{n or ''}") for n in count())
    return next(name for name in names if not name.exists())


def run_processes(
    folder: Path,
    manifest: Manifest,
    shards: Sequence[ExpectedShard],
    *,
    workers: int,
    progress: Progress = lambda name, samples: None,
) -> Iterator[ShardReport]:
    """Makes shards, each in a process of its own, and yields their reports.

    Which process makes a shard, and when, changes nothing in it.

    Args:
        folder: of the dataset.
        manifest: of the dataset.
        shards: which to make.
        workers: processes at a time, one thread each.
        progress: told of samples made.

    Raises:
        RuntimeError: a shard could not be made; the message names it. The
            others under way are stopped; what is on disk stays.
    """
    for shard, value in run_jobs(
        partial(make_shard, folder, manifest),
        shards,
        workers=workers,
        preload=["xray_drake.dataset.generator"],
        name=lambda shard: shard.name,
        advice="go on with --resume",
    ):
        if isinstance(value, ShardReport):
            yield value
        else:
            progress(shard.name, value)


def run_ray(
    folder: Path,
    manifest: Manifest,
    shards: Sequence[ExpectedShard],
    *,
    address: str,
    progress: Progress = lambda name, samples: None,
) -> Iterator[ShardReport]:
    """Makes shards on the machines of a Ray cluster and yields their reports.

    The machines need this package (and folders of meshes, where they are
    used, at the same paths), but no common file system: shards travel to this
    machine and are written here. The same manifest gives the same dataset as
    :func:`run_processes` where machines have the same processor features; one
    with other code or versions is refused.

    Args:
        folder: of the dataset.
        manifest: of the dataset.
        shards: which to make.
        address: of the cluster's head, "auto" for one on this machine, or
            "local:N" to start one here with N workers.
        progress: told of samples made, shard by shard.

    Raises:
        RuntimeError: Ray is not installed, there is no cluster at the
            address, a machine has other code, or a shard could not be made.
    """
    try:
        import ray
    except ImportError as error:
        raise RuntimeError(
            "--cluster needs Ray: pip install 'xray-drake[cluster]'"
        ) from error
    try:
        if address.startswith("local:"):
            workers = int(address.removeprefix("local:"))
            ray.init(num_cpus=workers, include_dashboard=False)
        else:
            ray.init(address=address)
    except (ConnectionError, ValueError) as error:
        raise RuntimeError(
            f"no Ray cluster at {address!r}: {error}; start one with "
            "'ray start --head'"
        ) from error
    # One task a process: memory does not grow.
    task = ray.remote(num_cpus=1, max_calls=1, max_retries=ATTEMPTS - 1)(
        _make_remotely
    )
    try:
        here = current()
        pending = {
            task.remote(manifest, shard, here): shard for shard in shards
        }
        while pending:
            (ready, *_), _ = ray.wait(list(pending))
            shard = pending.pop(ready)
            try:
                report, data = ray.get(ready)
            except ray.exceptions.RayError as error:
                reason = str(error).strip().splitlines()[-1]
                raise RuntimeError(
                    f"{shard.name}: {reason}; go on with --resume"
                ) from error
            write_whole_file(folder / shard.name, data)
            progress(shard.name, report.samples)
            yield report
    finally:
        ray.shutdown()


def _make_remotely(
    manifest: Manifest, shard: ExpectedShard, wanted: Provenance
) -> tuple[ShardReport, bytes]:
    limit_threads()
    if found := wanted.differences(current()):
        raise RuntimeError(
            f"a machine of the cluster differs: {'; '.join(found)} there; "
            "install the same"
        )
    with tempfile.TemporaryDirectory() as folder:
        *_, report = make_shard(Path(folder), manifest, shard)
        assert isinstance(report, ShardReport)
        return report, (Path(folder) / shard.name).read_bytes()
