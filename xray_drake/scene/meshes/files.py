"""Finds one mesh per object in a folder, and the objects' masses."""

import json
import os
import posixpath
import re
import stat
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from pathlib import Path, PurePosixPath

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

_LONGEST_LINK = 1024
"""Bytes."""

_COLLISION = re.compile(r"collision|collider|vhacd|coacd", re.IGNORECASE)


@dataclass(frozen=True)
class MeshFile:
    """A file to import.

    Attributes:
        path: of the file.
        name: of the object, ``folder/path`` without suffix.
        keys: under which ``masses.json`` may know it, the surest first.
        problem: why it cannot be read, one line; empty where it can.
    """

    path: Path
    name: str
    keys: tuple[str, ...]
    problem: str = ""


def find_meshes(folder: Path) -> list[MeshFile]:
    """Finds one mesh per object under a folder, in the order of the paths.

    Layouts such as ``name.obj``, ``name/textured.obj`` and
    ``name/meshes/visual.glb`` are understood. Files named as collision shapes
    do not count where their directory has others; hidden ones never do. A link
    to a folder counts as the folder.

    What cannot be read is among them, with its ``problem``: files, folders and
    links to nothing.

    Raises:
        ValueError: the folder does not exist or has no mesh.
    """
    if not folder.is_dir():
        raise ValueError(f"no folder of meshes: {folder}")
    directories, problems = _look_through(folder)
    if not directories and not problems:
        formats = ", ".join(suffix[1:].upper() for suffix in FORMATS)
        raise ValueError(f"no mesh in {folder}: it looks for {formats} files")
    named = {p.with_suffix("") for paths in directories.values() for p in paths}
    found = {}
    for directory, paths in directories.items():
        chosen = _one_per_object(paths)
        for path in chosen:
            relative = path.relative_to(folder).with_suffix("")
            shown = relative
            if (
                len(chosen) == 1
                and path.stem.lower() in GENERIC_NAMES
                and directory != folder
                and directory not in named
            ):
                shown = relative.parent
            found[path] = relative, shown, ""
    for path, problem in problems.items():
        relative = path.relative_to(folder).with_suffix("")
        found[path] = relative, relative, problem
    # Names as Drake takes them: no control characters, and "::" divides.
    root, taken = folder.resolve().name, set[str]()
    files = []
    for path, (relative, shown, problem) in sorted(found.items()):
        name = printable(f"{root}/{shown.as_posix()}").replace("::", "_")
        if name in taken:  # "a\nb" beside "a_b"
            name = next(
                other for k in count(2) if (other := f"{name}_{k}") not in taken
            )
        taken.add(name)
        keys = (relative.as_posix(), relative.parent.as_posix(), path.stem)
        files.append(MeshFile(path, name, (*keys, name), problem))
    return files


def printable(text: str) -> str:
    """Returns a text as one line of UTF-8; "_" for what is neither."""
    return "".join(c if c.isprintable() else "_" for c in text)


def _look_through(
    folder: Path,
) -> tuple[dict[Path, list[Path]], dict[Path, str]]:
    """Returns the meshes of each directory, and what cannot be read."""
    directories: dict[Path, list[Path]] = {}
    problems: dict[Path, str] = {}
    waiting, links, seen = deque([folder]), deque[Path](), set[str]()
    # Links last: what is found without them keeps its name.
    while waiting or links:
        directory = (waiting or links).popleft()
        place = os.path.realpath(directory)
        if place in seen:
            continue
        seen.add(place)
        try:
            names = sorted(os.listdir(directory))
        except OSError as error:
            problems[directory] = f"cannot be listed ({error.strerror})"
            continue
        for name in names:
            path = directory / name
            if name.startswith("."):
                continue
            if os.path.isdir(path):
                (links if os.path.islink(path) else waiting).append(path)
                continue
            if path.suffix.lower() in FORMATS:
                problem = problem_of(path)
                if not problem:
                    directories.setdefault(directory, []).append(path)
            elif not path.suffix:  # it may have led to a folder
                problem = _dead_link(path)
            else:
                continue
            if problem:
                problems[path] = problem
    return directories, problems


def problem_of(path: Path) -> str:
    """Says why a file cannot be read; empty where it can."""
    return _dead_link(path) or _unreadable(path)


def _dead_link(path: Path) -> str:
    """Says where a link leads that cannot be followed; empty for others."""
    if os.path.islink(path) and not os.path.exists(path):
        return f"it is a link to nothing ({os.readlink(path)})"
    with suppress(OSError):
        # As Git and archives leave links where they cannot make them.
        if path.is_file() and path.stat().st_size < _LONGEST_LINK:
            target = os.fsdecode(path.read_bytes())
            there = target and os.path.exists(path.parent / target)
            if there and target.isprintable():
                return f"it is a link written as a text ({target})"
    return ""


def _unreadable(path: Path) -> str:
    """Says why a file cannot be read; empty where it can."""
    try:
        regular = stat.S_ISREG(path.stat().st_mode)
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    return "" if regular else "it is not a regular file"


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
        masses = json.loads(path.read_text(encoding="utf-8-sig"))
    except ValueError as error:
        raise ValueError(f"{path} is not JSON: {error}") from error
    if not isinstance(masses, dict) or not all(
        isinstance(mass, int | float)
        and not isinstance(mass, bool)
        and 0 < mass < np.inf
        for mass in masses.values()
    ):
        raise ValueError(f"{path} does not map names to positive masses in kg")
    return {name: float(mass) for name, mass in masses.items()}


def masses_of(
    files: Sequence[MeshFile], masses: Mapping[str, float]
) -> tuple[list[float | None], list[str]]:
    r"""Finds the mass of each file.

    A name may have the suffix of a mesh, ``\`` for ``/`` and ``./`` before
    it, where no file has just that name.

    Args:
        files: as they were found.
        masses: name to kg.

    Returns:
        Each file's mass, or ``None``; and the names that belong to no file.
    """
    entries: dict[str, str] = {}
    for form in (str, _normal, _without_suffix):
        for name in masses:
            entries.setdefault(form(name), name)
    found: list[float | None] = []
    used = set()
    for file in files:
        own = [entries[key] for key in file.keys if key in entries]
        found.append(masses[own[0]] if own else None)
        used.update(own)
    idle = []
    for name, mass in masses.items():
        other = entries[_without_suffix(name)]
        same = other in used and masses[other] == mass
        if name not in used and not same:
            idle.append(name)
    return found, idle


def _normal(name: str) -> str:
    return posixpath.normpath(name.replace("\\", "/"))


def _without_suffix(name: str) -> str:
    path = PurePosixPath(_normal(name))
    return str(path.with_suffix("") if path.suffix.lower() in FORMATS else path)
