"""Keeps what was computed from a file, by the content of the file."""

import hashlib
import io
import logging
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from xray_drake.files import write_whole_file

_logger = logging.getLogger(__name__)


def default_cache_dir() -> Path:
    """Returns where imported meshes are kept.

    ``XRAY_DRAKE_CACHE`` where it is set, else ``xray_drake`` in
    ``XDG_CACHE_HOME`` or ``~/.cache``; in it, ``meshes``.
    """
    own = os.environ.get("XRAY_DRAKE_CACHE")
    if own:
        return Path(own) / "meshes"
    shared = os.environ.get("XDG_CACHE_HOME")
    root = Path(shared) if shared else Path.home() / ".cache"
    return root / "xray_drake" / "meshes"


def content_key(paths: list[Path], settings: str) -> str:
    """Returns a name for what comes of files under settings."""
    digest = hashlib.sha256(settings.encode())
    for path in paths:
        content = path.read_bytes()
        digest.update(f"\n{path.suffix} {len(content)}\n".encode())
        digest.update(content)
    return digest.hexdigest()[:40]


def read_arrays(folder: Path, key: str) -> dict[str, np.ndarray] | None:
    """Reads what was kept: name to array, shaped as it was written.

    ``None`` if it is missing or damaged.
    """
    path = folder / f"{key}.npz"
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except FileNotFoundError:
        return None
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
        _logger.debug("damaged cache file %s", path)
        return None


def write_arrays(
    folder: Path, key: str, arrays: Mapping[str, np.ndarray]
) -> bool:
    """Keeps arrays under a key; a reader sees all of them or none.

    Returns:
        Whether it could be written.
    """
    content = io.BytesIO()
    np.savez_compressed(content, **dict(arrays))  # type: ignore[arg-type]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_whole_file(folder / f"{key}.npz", content.getvalue())
    except OSError:
        return False
    return True
