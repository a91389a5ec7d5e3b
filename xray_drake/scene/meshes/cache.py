"""Keeps what was computed from a file, by the content of the file."""

import hashlib
import io
import logging
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from xray_drake.files import write_whole_file

_logger = logging.getLogger(__name__)


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
    except Exception:
        # Bytes of a damaged file raise anything, zlib's own errors too.
        _logger.debug("damaged cache file %s", path, exc_info=True)
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
