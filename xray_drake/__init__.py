"""X-Ray mechanical search as a Drake systems diagram."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("xray-drake")
except PackageNotFoundError:  # a checkout on PYTHONPATH, not installed
    __version__ = "0.0.0+checkout"
