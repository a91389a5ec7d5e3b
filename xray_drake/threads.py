"""Keeps numerical libraries to one thread a process."""

import os

_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def limit_threads() -> None:
    """Keeps this process, and those that it starts, to one thread each.

    Two workers on two cores then scale. Libraries read the variables when they
    are imported, so call it before that.
    """
    os.environ.update(dict.fromkeys(_VARIABLES, "1"))
