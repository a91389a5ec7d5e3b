"""Finds one mesh per object in a folder, and the objects' masses."""

import json
import re
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from xray_drake.scene.meshes.formats import FORMATS

GENERIC_NAMES = (
    "textured",
    "texture",
    "visual",
    "model",
    "mesh",
    "object",
    "textured_simple",
    "nontextured",
    "untextured",
)
"""Files that are called by their directory; of several the first is taken."""

MASSES_FILE = "masses.json"

_COLLISION = re.compile(r"collision|collider|vhacd|coacd", re.IGNORECASE)


@dataclass(frozen=True)
class MeshFile:
    """A file to import.

    Attributes:
        path: of the file.
        name: of the object, ``folder/path`` without suffix.
        keys: under which ``masses.json`` may know it, the surest first.
    """

    path: Path
    name: str
    keys: tuple[str, ...]


def find_meshes(folder: Path) -> list[MeshFile]:
    """Finds one mesh per object under a folder, in the order of the paths.

    Layouts such as ``name.obj``, ``name/textured.obj`` and
    ``name/meshes/visual.glb`` are understood. Files named as collision shapes
    do not count where their directory has others; hidden ones never do.

    Raises:
        ValueError: the folder does not exist or has no mesh.
    """
    if not folder.is_dir():
        raise ValueError(f"no folder of meshes: {folder}")
    directories: dict[Path, list[Path]] = defaultdict(list)
    for path in sorted(folder.rglob("*")):
        relative = path.relative_to(folder)
        hidden = any(part.startswith(".") for part in relative.parts)
        if path.suffix.lower() in FORMATS and not hidden and path.is_file():
            directories[path.parent].append(path)
    if not directories:
        formats = ", ".join(suffix[1:].upper() for suffix in FORMATS)
        raise ValueError(f"no mesh in {folder}: it looks for {formats} files")
    files = {path for paths in directories.values() for path in paths}
    named = {path.with_suffix("") for path in files}
    found = []
    for directory, paths in directories.items():
        chosen = _one_per_object(paths)
        for path in chosen:
            relative = path.relative_to(folder).with_suffix("")
            keys = (relative.as_posix(), relative.parent.as_posix(), path.stem)
            if (
                len(chosen) == 1
                and path.stem.lower() in GENERIC_NAMES
                and directory != folder
                and directory not in named
            ):
                relative = relative.parent
            name = f"{folder.resolve().name}/{relative.as_posix()}"
            found.append(MeshFile(path, name, keys))
    return sorted(found, key=lambda file: file.path)


def _one_per_object(paths: list[Path]) -> list[Path]:
    shown = [path for path in paths if not _COLLISION.search(path.stem)]
    best: dict[str, Path] = {}
    for path in shown or paths:
        other = best.get(path.stem)
        if other is None or _preference(path) < _preference(other):
            best[path.stem] = path
    generic = [name for name in best if name.lower() in GENERIC_NAMES]
    generic.sort(key=lambda name: GENERIC_NAMES.index(name.lower()))
    for name in generic[1:]:
        del best[name]
    return list(best.values())


def _preference(path: Path) -> int:
    return FORMATS.index(path.suffix.lower())


def read_masses(folder: Path) -> dict[str, float]:
    """Reads ``masses.json``, which maps names to kg; empty if there is none.

    Raises:
        ValueError: it is something else.
    """
    path = folder / MASSES_FILE
    if not path.is_file():
        return {}
    try:
        masses = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path} is not JSON: {error}") from error
    if not isinstance(masses, dict) or not all(
        isinstance(mass, int | float) and 0 < mass < np.inf
        for mass in masses.values()
    ):
        raise ValueError(f"{path} does not map names to positive masses in kg")
    return {name: float(mass) for name, mass in masses.items()}
