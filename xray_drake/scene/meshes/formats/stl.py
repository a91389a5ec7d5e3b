"""STL, binary and ASCII."""

import re
from pathlib import Path

import numpy as np

from xray_drake.scene.meshes.formats.file_mesh import FileMesh, triangulate
from xray_drake.scene.meshes.formats.text import decoded, numbers

_RECORD = np.dtype(
    [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")]
)
_HEADER = 84
"""Bytes before the first triangle: a text and their number."""

_WORD = re.compile(r"vertex\s+(\S+)\s+(\S+)\s+(\S+)|(endloop|endsolid)")


def read_stl(path: Path) -> FileMesh:
    """Reads an STL file; the solids of an ASCII file are groups.

    Raises:
        ValueError: it is damaged.
        OSError: it cannot be read.
    """
    content = path.read_bytes()
    count = int.from_bytes(content[80:_HEADER], "little")
    size = _HEADER + count * _RECORD.itemsize
    binary = len(content) >= _HEADER and (
        len(content) == size
        or (b"\0" in content and b"endloop" not in content.lower())
    )
    if binary:
        if len(content) < size:
            raise ValueError(
                f"it ends before the last of its {count} triangles"
            )
        records = np.frombuffer(content, _RECORD, count, _HEADER)
        vertices = records["corners"].reshape(-1, 3).astype(float)
        triangles = np.arange(3 * count).reshape(-1, 3)
        return FileMesh(vertices, triangles, np.zeros(count, np.int64))
    return _read_ascii(decoded(content).lower())


def _read_ascii(text: str) -> FileMesh:
    words: list[str] = []
    sizes, groups = [], []
    size = group = 0
    for match in _WORD.finditer(text):
        if match[4] is None:
            words += match.groups()[:3]
            size += 1
        elif match[4] == "endsolid":
            group += 1
        else:
            sizes.append(size)
            groups.append(group)
            size = 0
    if size:
        raise ValueError("it ends within a facet")
    vertices = numbers(words).reshape(-1, 3)
    made = triangulate(vertices, sizes)
    groups_of = np.array(groups, dtype=np.int64)
    return FileMesh(vertices, made.corners, groups_of[made.owners])
