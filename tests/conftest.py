"""The tiny heap for all tests, and a cache of their own."""

import gc
import os
import tempfile
from multiprocessing import forkserver

import pytest
from hypothesis import settings

from xray_drake.threads import limit_threads, usable_cores

# Workers on all cores share them; libraries look at it when imported.
limit_threads()

pytest_plugins = ["xray_drake.testing.fixtures"]

_CACHE = tempfile.TemporaryDirectory(prefix="xray_drake_cache_")
os.environ["XRAY_DRAKE_CACHE"] = _CACHE.name
"""Imported meshes are not kept in the user's own cache."""

# How long an example takes is the benchmarks' matter, not the tests'.
settings.register_profile("xray_drake", deadline=None)
settings.load_profile("xray_drake")


MANY = 300
PRELOADED = [
    "xray_drake.dataset.check",
    "xray_drake.dataset.generator",
    "xray_drake.scene.meshes.prepare",
    "xray_drake.search.rollout",
    "xray_drake.training.prepare",
]


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """As many as this process may use; its own choice is the machine's."""
    return usable_cores()


def pytest_collection_finish(session: pytest.Session) -> None:
    """What is imported stays: the garbage collector need not look at it.

    Of many tests some start processes, each with modules of its own that the
    server should have imported; it is started once.
    """
    gc.collect()
    gc.freeze()
    if len(session.items) > MANY:
        forkserver.set_forkserver_preload(PRELOADED)
        forkserver.ensure_running()
