"""Finds a folder for what is made once: the user's, or a temporary one."""

import atexit
import logging
import os
import shutil
import tempfile
from pathlib import Path

VARIABLE = "XRAY_DRAKE_CACHE"
"""The environment variable that names the folder."""

_logger = logging.getLogger(__name__)


def cache_folder() -> Path:
    """Returns where this package keeps what it made; it may not exist yet.

    ``XRAY_DRAKE_CACHE`` where it is set, else ``xray_drake`` in
    ``XDG_CACHE_HOME`` or ``~/.cache``. Where that neither exists nor can be
    made, a folder that goes with the program.
    """
    own, shared = os.environ.get(VARIABLE), os.environ.get("XDG_CACHE_HOME")
    try:
        if own:
            folder = Path(own)
        elif shared:
            folder = Path(shared) / "xray_drake"
        else:
            folder = Path.home() / ".cache" / "xray_drake"
        if _usable(folder):
            return folder
        lack = f"{folder} cannot be made"
    except RuntimeError:
        lack = "the user has no home"
    return temporary_folder(VARIABLE, "imported meshes", lack)


def temporary_folder(variable: str, what: str, lack: str) -> Path:
    """Makes a folder that goes with the program, and says so.

    This process and those that it starts find it by an environment variable.

    Args:
        variable: its name.
        what: is kept in the folder.
        lack: why it is not kept where it should be.

    Raises:
        OSError: not even that can be made.
    """
    folder = Path(tempfile.mkdtemp(prefix="xray_drake_"))
    program = os.getpid()

    def remove() -> None:
        if os.getpid() == program:  # not a process forked from it
            shutil.rmtree(folder, ignore_errors=True)

    atexit.register(remove)
    os.environ[variable] = str(folder)
    _logger.warning(
        "%s are not kept, for %s: set %s to a folder that can be written",
        what,
        lack,
        variable,
    )
    return folder


def _usable(folder: Path) -> bool:
    """Says whether a folder exists or can be made."""
    if os.path.isdir(folder):
        return os.access(folder, os.R_OK | os.X_OK)
    for parent in folder.absolute().parents:
        if os.path.lexists(parent):
            return os.path.isdir(parent) and os.access(
                parent, os.W_OK | os.X_OK
            )
    return False
