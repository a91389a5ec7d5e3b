"""How much of the processor is used: how many workers, how many threads."""

import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

_CGROUPS = Path("/sys/fs/cgroup")
_OWN_CGROUPS = Path("/proc/self/cgroup")


def usable_cores() -> int:
    """Returns how many processor cores this process may use, at least 1.

    A scheduler or a container may leave it fewer than the machine has, by an
    affinity (``taskset``, SLURM, ``docker --cpuset-cpus``) or by a quota of
    time (``docker --cpus``, Kubernetes), which is rounded up.
    """
    if hasattr(os, "sched_getaffinity"):
        cores = len(os.sched_getaffinity(0))
    else:
        cores = os.cpu_count() or 1
    return max(1, math.ceil(min(cores, _quota())))


def _quota() -> float:
    """Returns the cores' worth of time that the cgroups allow, else inf."""
    try:
        lines = _OWN_CGROUPS.read_text(encoding="utf-8").splitlines()
    except OSError:
        return math.inf
    quota = math.inf
    for line in lines:
        _, controllers, own = line.split(":", 2)
        if controllers and "cpu" not in controllers.split(","):
            continue
        root = _CGROUPS / controllers
        # In a container the path may be the host's: then only the root is seen.
        own_folder = root / own.lstrip("/")
        for folder in (own_folder, *own_folder.parents):
            if folder.is_relative_to(root):
                quota = min(quota, _quota_of(folder))
    return quota


def _quota_of(folder: Path) -> float:
    """Returns the limit of one cgroup, of version 2 or 1."""
    try:
        if (folder / "cpu.max").is_file():
            text = (folder / "cpu.max").read_text(encoding="utf-8")
        else:
            text = " ".join(
                (folder / f"cpu.cfs_{name}_us").read_text(encoding="utf-8")
                for name in ("quota", "period")
            )
        time, period = map(float, text.split())
    except (OSError, ValueError):  # the latter for "max": no limit
        return math.inf
    return time / period if time > 0 and period > 0 else math.inf


def limit_threads() -> None:
    """Keeps this process, and those that it starts, to one thread each.

    Two workers on two cores then scale. Libraries read the variables when they
    are imported, so call it before that.
    """
    os.environ.update(dict.fromkeys(_VARIABLES, "1"))


@contextmanager
def one_thread_inherited() -> Iterator[None]:
    """Processes that are started meanwhile keep to one thread each.

    This process is left as it is.
    """
    before = {name: os.environ.get(name) for name in _VARIABLES}
    limit_threads()
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
