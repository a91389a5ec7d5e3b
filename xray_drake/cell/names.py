"""The cells that come with the package, by name."""

from pathlib import Path

from xray_drake.resources import models_dir
from xray_drake.trees import ConfigurationError

SUFFIXES = (".yaml", ".yml")
"""Of files of cells and scenarios."""


def cell_names() -> tuple[str, ...]:
    """Returns the names of the cells that come with the package."""
    return tuple(
        sorted(path.stem for path in (models_dir() / "cells").glob("*.yaml"))
    )


def cell_path(name_or_path: str | Path, folder: Path = Path()) -> Path:
    """Returns the file of a cell.

    Args:
        name_or_path: a name of :func:`cell_names`, or a YAML file.
        folder: what a path is relative to.

    Raises:
        ConfigurationError: there is no such cell.
    """
    path = folder / Path(name_or_path).expanduser()
    if path.suffix in SUFFIXES or path.is_file():
        return path
    path = models_dir() / "cells" / f"{name_or_path}.yaml"
    if not path.is_file():
        raise ConfigurationError(
            f"no cell {str(name_or_path)!r}: choose one of "
            f"{', '.join(cell_names())}, or give a YAML file"
        )
    return path
