"""Files that are there completely or not at all, with one writer at a time."""

import errno
import json
import logging
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

try:
    import fcntl
except ImportError:  # no POSIX: nothing is locked
    fcntl = None  # type: ignore[assignment]

_PART = ".part"
_PART_OF = re.compile(r"\.(\d+)\.part$")
_LOCK = ".lock"

_UNSUPPORTED = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EINVAL)

_logger = logging.getLogger(__name__)

_held: set[int] = set()
"""Handles of locks of this process."""


class InUseError(ValueError):
    """Results that another process is writing."""


class LinesError(ValueError):
    """A file of JSON lines that cannot be read: which, and where."""


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
    """Removes what killed processes had begun to write.

    What a process is still writing is left alone: workers of a killed program
    may live a little longer.

    Returns:
        What was removed, sorted.
    """
    leftovers = []
    for path in sorted(folder.glob(f".*{_PART}")):
        named = _PART_OF.search(path.name)
        if named is None or not _lives(int(named[1])):
            path.unlink(missing_ok=True)
            leftovers.append(path)
    return leftovers


@contextmanager
def sole_writer(path: Path) -> Iterator[None]:
    """Lets no other process write to a place, as long as the context lasts.

    The lock is the system's (``flock``), of ``.lock`` in a folder or
    ``.NAME.lock`` beside a file; the name is removed at the end. It ends with
    the process, however that ends, and what is left of the name blocks nobody.
    Where the file system has no locks, a warning says so.

    Args:
        path: a folder that is there, or a file in one that is.

    Raises:
        InUseError: something else writes there, or this process already.
        OSError: the folder is not there, or may not be written.
    """
    lock = _lock_of(path)
    handle = _take(lock, path)
    owner = os.getpid()
    try:
        yield
    finally:
        # A forked child has closed its own, see below.
        if handle is not None and os.getpid() == owner:
            lock.unlink(missing_ok=True)
            _held.discard(handle)
            os.close(handle)


def read_json_lines(path: Path) -> list[dict[str, Any]]:
    """Reads a file with a JSON object a line; without a file there are none.

    A last line that a killed process has cut short is left out, with a warning.

    Raises:
        LinesError: another line cannot be read; it is named.
        OSError: the file cannot be read.
    """
    if not path.is_file():
        return []
    *lines, last = path.read_bytes().split(b"\n")
    found = []
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        item = _json_object(line)
        if item is None:
            raise LinesError(
                f"{path}: line {number} cannot be read: restore it, or take it "
                "out to have it made again"
            )
        found.append(item)
    if last.strip():
        item = _json_object(last)
        if item is None:
            _tell_cut(path, len(lines) + 1)
        else:
            found.append(item)
    return found


@contextmanager
def append_json_lines(path: Path) -> Iterator[Callable[[dict], None]]:
    """Yields a function that adds an object to a file, a line each, at once.

    A last line that was cut short is removed first; the others stay as they
    are, byte for byte. For a :func:`sole_writer`.

    Args:
        path: made if it is not there; its folder is.

    Raises:
        OSError: it cannot be written.
    """
    with path.open("a+b") as file:
        file.seek(0)
        data = file.read()
        whole = data.rfind(b"\n") + 1
        if _json_object(data[whole:]) is not None:
            file.write(b"\n")
        else:
            file.truncate(whole)

        def add(item: dict) -> None:
            file.write(json.dumps(item).encode() + b"\n")
            file.flush()

        yield add


@cache
def _tell_cut(path: Path, number: int) -> None:
    """Warns once, however often the file is read."""
    _logger.warning("%s: line %d is cut short and left out", path, number)


def _json_object(text: bytes) -> dict[str, Any] | None:
    try:
        item = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return item if isinstance(item, dict) else None


def _lock_of(path: Path) -> Path:
    # A place has one lock, by whatever name it is called.
    path = path.resolve()
    return (
        path / _LOCK if path.is_dir() else path.with_name(f".{path.name}.lock")
    )


def _take(lock: Path, path: Path) -> int | None:
    if fcntl is None:
        return None
    while True:
        handle = os.open(lock, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            pid = os.pread(handle, 20, 0).decode(errors="replace").strip()
            os.close(handle)
            raise InUseError(
                f"{path} is being written by another process"
                f"{f' ({pid})' * bool(pid)}: wait until it has ended, or "
                "choose another place"
            ) from None
        except OSError as error:
            os.close(handle)
            if error.errno not in _UNSUPPORTED:
                raise
            _logger.warning(
                "%s: its disk has no locks: let nothing else write there",
                path,
            )
            return None
        # Whoever had it may just have removed it, and another made it anew.
        try:
            if os.path.samestat(os.fstat(handle), lock.stat()):
                break
        except FileNotFoundError:
            pass
        os.close(handle)
    os.ftruncate(handle, 0)
    os.pwrite(handle, str(os.getpid()).encode(), 0)
    _held.add(handle)
    return handle


def _forget_locks() -> None:
    """Closes a parent's locks in a child: they end with the parent."""
    for handle in _held:
        os.close(handle)
    _held.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_locks)


def _lives(pid: int) -> bool:
    """Tells whether a process of this machine lives."""
    if fcntl is None:
        return False
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:  # somebody else's
        return True
    return True


def _sync_folder(folder: Path) -> None:
    """Makes a rename last through a power cut."""
    if os.name == "nt":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
