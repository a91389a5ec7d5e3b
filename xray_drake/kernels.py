"""Compiles functions with Numba, once where there is a place to keep them."""

from collections.abc import Callable
from typing import Any, TypeVar

import numba
from numba.core.caching import FunctionCache

from xray_drake.caches import temporary_folder

VARIABLE = "NUMBA_CACHE_DIR"
"""Numba's environment variable that names where it keeps them."""

Function = TypeVar("Function", bound=Callable)


def kernel(function: Function) -> Function:
    """Compiles a function when it is first called, and keeps what comes of it.

    As ``numba.njit(cache=True)``, which keeps it beside the file or in the
    user's cache. Where neither can be written that raises; here it is kept in a
    folder that goes with the program. A damaged or full cache is none.
    """
    dispatcher: Any = numba.njit(function)
    cache = _cache(function)
    if cache is not None:
        # What ``cache=True`` does, with a cache of another class.
        dispatcher._cache = cache
    return dispatcher


def cache_path() -> str | None:
    """Returns where compiled functions of this folder are kept, if anywhere."""
    cache = _cache(cache_path)
    return None if cache is None else cache.cache_path


class _Cache(FunctionCache):
    """Numba's, which does without where something is wrong with it."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # a damaged pickle raises anything
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)
        except Exception:
            try:
                self.flush()
                super().save_overload(sig, data)
            except Exception:  # no space left, say
                self.disable()


def _cache(function: Callable) -> FunctionCache | None:
    try:
        return _Cache(function)
    except RuntimeError:  # Numba found no folder that can be written
        pass
    try:
        folder = temporary_folder(
            VARIABLE,
            "compiled functions",
            "neither the package's folder nor the user's cache can be written",
        )
        numba.config.CACHE_DIR = str(folder)  # type: ignore[attr-defined]
        return _Cache(function)
    except (OSError, RuntimeError):
        return None
