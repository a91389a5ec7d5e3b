"""Files that are there completely or not at all."""

import errno
import os
from pathlib import Path

_PART = ".part"


def write_whole_file(path: Path, data: bytes) -> None:
    """Writes a file under a temporary name beside it, then renames it.

    After a power cut there is the old file, the new one, or none; what was
    begun goes by a name that ends in ``.part``.

    Raises:
        OSError: it cannot be written (no such folder, a full disk); what was
            there before is untouched, and nothing is left over.
    """
    if path.exists() and not path.is_file():
        # A device or a pipe is written to; replacing it would destroy it.
        path.write_bytes(data)
        return
    path = path.resolve()
    temporary = path.with_name(f".{path.name}.{os.getpid()}{_PART}")
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise OSError(
                error.errno,
                f"no space left for {len(data)} bytes: make room, then resume",
                str(path),
            ) from error
        raise
    finally:
        temporary.unlink(missing_ok=True)
    _sync_folder(path.parent)


def remove_leftovers(folder: Path) -> list[Path]:
    """Removes what a killed process had begun to write.

    Only where no other process writes into the folder.

    Returns:
        What was removed, sorted.
    """
    leftovers = sorted(folder.glob(f".*{_PART}"))
    for path in leftovers:
        path.unlink(missing_ok=True)
    return leftovers


def _sync_folder(folder: Path) -> None:
    """Makes a rename last through a power cut."""
    if os.name == "nt":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
