"""The tiny heap for all tests, and a cache of their own."""

import os
import tempfile

from hypothesis import settings

pytest_plugins = ["xray_drake.testing.fixtures"]

_CACHE = tempfile.TemporaryDirectory(prefix="xray_drake_cache_")
os.environ["XRAY_DRAKE_CACHE"] = _CACHE.name
"""Imported meshes are not kept in the user's own cache."""

# How long an example takes is the benchmarks' matter, not the tests'.
settings.register_profile("xray_drake", deadline=None)
settings.load_profile("xray_drake")
