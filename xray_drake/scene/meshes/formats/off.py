"""Object file format, OFF."""

import re
from pathlib import Path

import numpy as np

from xray_drake.scene.meshes.formats.file_mesh import (
    FileMesh,
    mean_over_surface,
    triangulate,
    unit_colors,
)
from xray_drake.scene.meshes.formats.text import (
    decoded,
    logical_lines,
    numbers,
    without_comment,
)

_HEADER = re.compile(r"(ST)?(C)?(N)?(4)?(n)?OFF\b(\s+BINARY)?", re.IGNORECASE)


def read_off(path: Path) -> FileMesh:
    """Reads an ASCII OFF file; colours of vertices or faces count.

    Raises:
        ValueError: it is damaged, binary, or not in three dimensions.
        OSError: it cannot be read.
    """
    text = decoded(path.read_bytes())
    rows = [without_comment(line).split() for _, line in logical_lines(text)]
    rows = [row for row in rows if row]
    header = _HEADER.match(" ".join(rows[0])) if rows else None
    if header is not None:
        if header[4] or header[5] or header[6]:
            raise ValueError(f"its kind {header[0]!r} is not read")
        rows[0] = rows[0][1:]
        rows = rows if rows[0] else rows[1:]
    try:
        count, faces = int(rows[0][0]), int(rows[0][1])
    except (IndexError, ValueError):
        raise ValueError("it has no numbers of vertices and faces") from None
    if len(rows) < 1 + count + faces:
        raise ValueError(
            f"it ends before the last of its {count} vertices and {faces} faces"
        )
    points = [numbers(row) for row in rows[1 : 1 + count]]
    if any(len(point) < 3 for point in points):
        raise ValueError("a vertex has three coordinates")
    vertices = np.array([point[:3] for point in points]).reshape(-1, 3)
    corners: list[int] = []
    sizes: list[int] = []
    face_colors: list[np.ndarray] = []
    for row in rows[1 + count : 1 + count + faces]:
        size = int(row[0])
        if size < 0 or len(row) <= size:
            raise ValueError(f"a face has not the {size} corners that it names")
        sizes.append(size)
        corners += map(int, row[1 : 1 + size])
        face_colors.append(numbers(row[1 + size :]))
    indices = np.array(corners, dtype=np.int64)
    if len(indices) and not 0 <= indices.min() <= indices.max() < count:
        raise ValueError(f"a face names a vertex beyond its {count}")
    made = triangulate(vertices[indices], sizes)
    triangles = indices[made.corners]
    colors = None
    skipped = 6 if header is not None and header[3] else 3
    if header is not None and header[2]:
        if all(len(point) >= skipped + 3 for point in points):
            table = np.array([p[skipped : skipped + 3] for p in points])
            colors = unit_colors(table)[triangles].mean(axis=1)
    elif face_colors and all(len(color) >= 3 for color in face_colors):
        table = np.array([color[:3] for color in face_colors])
        colors = unit_colors(table)[made.owners]
    return FileMesh(
        vertices,
        triangles,
        np.zeros(len(triangles), np.int64),
        color=mean_over_surface(vertices, triangles, colors),
    )
