"""Materials of OBJ files."""

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from xray_drake.scene.meshes.formats.images import find_file
from xray_drake.scene.meshes.formats.text import (
    decoded,
    logical_lines,
    numbers,
    without_comment,
)

_OPTIONS = re.compile(
    r"-(?:blendu|blendv|cc|clamp|texres|imfchan|type|bm|boost)\s+\S+\s+"
    r"|-mm\s+\S+\s+\S+\s+"
    r"|-[ost](?:\s+[-+.\d][-+.\deE]*(?=\s)){1,3}\s+",
    re.IGNORECASE,
)
"""What may stand between ``map_Kd`` and the file's name."""


@dataclass
class Material:
    """What is used of a material.

    Attributes:
        color: (3,) its ``Kd`` in [0, 1], or ``None``.
        image: the file that ``map_Kd`` names, or ``None``.
        missing: what ``map_Kd`` names, where there is no such file.
    """

    color: np.ndarray | None = None
    image: Path | None = None
    missing: str = ""


@dataclass
class Library:
    """The materials of an OBJ file.

    Attributes:
        materials: by name.
        files: the libraries that were read.
        missing: the names of those that do not exist.
    """

    materials: dict[str, Material] = field(default_factory=dict)
    files: list[Path] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)


def read_libraries(names: list[str], folder: Path) -> Library:
    """Reads the files that ``mtllib`` lines name.

    Args:
        names: what follows ``mtllib`` on each line: one name, which may have
            spaces, or several.
        folder: of the OBJ file.
    """
    library = Library()
    for line in dict.fromkeys(names):
        whole = find_file(folder, line)
        words = [line] if whole is not None else line.split()
        for name in words:
            path = find_file(folder, name)
            if path is None:
                library.missing.append(name)
            elif path not in library.files:
                library.files.append(path)
                _read(path, library.materials)
    return library


def _read(path: Path, materials: dict[str, Material]) -> None:
    material = Material()
    for _, line in logical_lines(decoded(path.read_bytes())):
        keyword, *more = line.split(None, 1)
        keyword, rest = keyword.lower(), "".join(more)
        if keyword == "newmtl":
            material = Material()
            materials.setdefault(rest, material)
        elif keyword == "kd":
            material.color = _color(rest)
        elif keyword == "map_kd":
            name = _OPTIONS.sub("", rest + " ").strip()
            material.image = find_file(path.parent, name)
            material.missing = "" if material.image else name


def _color(words: str) -> np.ndarray | None:
    """Reads ``Kd``; one number is grey, ``xyz`` and ``spectral`` are none."""
    try:
        values = numbers(without_comment(words).split()[:3])
    except ValueError:
        return None
    if len(values) not in (1, 3) or not np.isfinite(values).all():
        return None
    return np.clip(np.broadcast_to(values, 3), 0, 1).astype(float)
