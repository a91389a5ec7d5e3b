"""Stanford PLY."""

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from xray_drake.scene.meshes.formats.file_mesh import (
    FileMesh,
    mean_over_surface,
    triangulate,
    unit_colors,
)
from xray_drake.scene.meshes.formats.images import (
    find_file,
    opened_image,
    with_image,
)
from xray_drake.scene.meshes.formats.text import decoded, numbers

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip


@dataclass
class _Element:
    """An element of the header and its values.

    Attributes:
        name: such as ``vertex``.
        count: how many there are.
        properties: name, type of the list's length or "", type.
        scalars: (count,) of each property that is no list.
        lists: sizes (count,) and flat values of each list.
    """

    name: str
    count: int
    properties: list[tuple[str, str, str]] = field(default_factory=list)
    scalars: dict[str, np.ndarray] = field(default_factory=dict)
    lists: dict[str, tuple[np.ndarray, np.ndarray]] = field(
        default_factory=dict
    )


def read_ply(path: Path) -> FileMesh:
    """Reads a PLY file, ASCII or binary, with faces of any size or strips.

    Raises:
        ValueError: it is damaged; the message says where.
        OSError: it cannot be read.
    """
    content = path.read_bytes()
    order, elements, texture, body = _header(content)
    _read(elements, content[body:], order)
    by_name = {element.name: element for element in elements}
    points = by_name.get("vertex", _Element("vertex", 0))
    if not {"x", "y", "z"} <= set(points.scalars):
        raise ValueError("its vertices have no x, y, z")
    vertices = np.stack([points.scalars[k] for k in "xyz"], axis=1).astype(
        float
    )
    faces = by_name.get("face", _Element("face", 0))
    sizes, corners = _corners(faces)
    strips = by_name.get("tristrips", _Element("tristrips", 0))
    extra = _strip_triangles(strips)
    triangles_of = np.concatenate([corners, extra.ravel()]).astype(np.int64)
    sizes = np.concatenate([sizes, np.full(len(extra), 3)]).astype(np.int64)
    if len(triangles_of) and not (
        triangles_of.min() >= 0 and triangles_of.max() < len(vertices)
    ):
        raise ValueError(f"a face names a vertex beyond its {len(vertices)}")
    made = triangulate(vertices[triangles_of], sizes)
    triangles = triangles_of[made.corners]
    visual, notes = _visual(
        path, texture, points, faces, vertices, triangles, made.corners
    )
    return FileMesh(
        vertices=vertices,
        triangles=triangles,
        groups=np.zeros(len(triangles), np.int64),
        visual=visual,
        color=_color(points, faces, vertices, triangles, made.owners),
        notes=notes,
    )


def ply_side_files(path: Path) -> list[Path]:
    """Returns the image that a PLY file names."""
    _, _, texture, _ = _header(path.read_bytes())
    found = find_file(path.parent, texture)
    return [] if found is None else [found]


def _header(content: bytes) -> tuple[str, list[_Element], str, int]:
    """Reads what stands before the values.

    Returns:
        Byte order, "" for ASCII; elements; image; where the values begin.
    """
    end = re.search(rb"(?:^|[\r\n])[ \t]*end_header[ \t]*", content)
    if content[:3] != b"ply" or end is None:
        raise ValueError("it has no PLY header")
    newline = re.match(rb"ply[ \t]*(\r\n|\n|\r)", content)
    mark = newline.group(1) if newline else b"\n"
    body = end.end()
    if content[body : body + len(mark)] == mark:
        body += len(mark)
    elements: list[_Element] = []
    order, texture = "?", ""
    for line in decoded(content[: end.start()]).split("\n")[1:]:
        words = line.split()
        if not words:
            continue
        try:
            if words[0] == "format":
                order = {
                    "ascii": "",
                    "binary_little_endian": "<",
                    "binary_big_endian": ">",
                }[words[1]]
            elif words[0] == "element":
                elements.append(_Element(words[1], int(words[2])))
            elif words[0] == "property":
                length = _TYPES[words[2]] if words[1] == "list" else ""
                kind = _TYPES[words[-2]]
                elements[-1].properties.append((words[-1], length, kind))
            elif words[0] == "comment" and line.split()[1:2] == ["TextureFile"]:
                texture = line.split(None, 2)[2].strip()
        except (KeyError, IndexError, ValueError):
            raise ValueError(f"its header has the line {line!r}") from None
    if order == "?":
        raise ValueError("its header has no format")
    return order, elements, texture, body


def _read(elements: list[_Element], body: bytes, order: str) -> None:
    """Reads the values; those of a text as records of float64."""
    text = not order
    if text:
        body, order = numbers(decoded(body).split()).tobytes(), "="
    at = 0
    for element in elements:
        properties = element.properties
        if text:
            properties = [
                (n, length and "f8", "f8") for n, length, _ in properties
            ]
        if element.count:
            at = _read_element(element, properties, body, at, order)


def _read_element(
    element: _Element,
    properties: list[tuple[str, str, str]],
    body: bytes,
    at: int,
    order: str,
) -> int:
    """Reads an element's values; returns where they end."""
    first, _ = _record(element, properties, body, at, order)
    fields: list[tuple[Any, ...]] = []
    for (name, length, kind), values in zip(properties, first, strict=True):
        if length:
            fields.append((f"#{name}", order + length))
        fields.append((name, order + kind, values.shape if length else ()))
    record = np.dtype(fields)
    end = at + element.count * record.itemsize
    lists = [name for name, length, _ in properties if length]
    table = np.zeros(0, record)
    if end <= len(body):
        table = np.frombuffer(body, record, element.count, at)
    if len(table) and all(
        (table[f"#{name}"] == table[name].shape[1]).all() for name in lists
    ):
        columns = [table[name] for name, _, _ in properties]
        sizes = {
            name: np.full(len(table), table[name].shape[1]) for name in lists
        }
    else:
        rows, end = [], at
        for _ in range(element.count):
            row, end = _record(element, properties, body, end, order)
            rows.append(row)
        columns = [np.concatenate(column) for column in zip(*rows, strict=True)]
        sizes = {
            name: np.array([len(row[k]) for row in rows])
            for k, (name, length, _) in enumerate(properties)
            if length
        }
    for (name, _, _), column in zip(properties, columns, strict=True):
        if name in sizes:
            element.lists[name] = sizes[name], np.ravel(column)
        else:
            element.scalars[name] = column
    return end


def _record(
    element: _Element,
    properties: list[tuple[str, str, str]],
    body: bytes,
    at: int,
    order: str,
) -> tuple[list[np.ndarray], int]:
    """Reads the values of each property of one record, and where it ends."""
    record = []
    for _, length, kind in properties:
        try:
            count = 1
            if length:
                count = int(np.frombuffer(body, order + length, 1, at)[0])
                at += np.dtype(length).itemsize
            values = np.frombuffer(body, order + kind, max(count, 0), at)
        except ValueError:
            raise ValueError(
                f"it ends before the last of its {element.count} "
                f"{element.name} entries"
            ) from None
        at += values.nbytes
        record.append(values)
    return record, at


def _corners(faces: _Element) -> tuple[np.ndarray, np.ndarray]:
    """Returns the corners of each face and the vertices they name."""
    names = [name for name in faces.lists if name.startswith("vert")]
    if not names and len(faces.lists) == 1:
        names = list(faces.lists)
    if not names:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    sizes, corners = faces.lists[names[0]]
    return sizes, corners.astype(np.int64)


def _strip_triangles(strips: _Element) -> np.ndarray:
    """Returns the (m, 3) triangles of strips that −1 separates."""
    made = [np.zeros((0, 3), np.int64)]
    for _, flat in strips.lists.values():
        indices = flat.astype(np.int64)
        for strip in np.split(indices, np.flatnonzero(indices < 0)):
            strip = strip[strip >= 0]
            if len(strip) < 3:
                continue
            windows = np.lib.stride_tricks.sliding_window_view(strip, 3).copy()
            windows[1::2] = windows[1::2, ::-1]
            made.append(windows)
    return np.concatenate(made)


def _visual(
    path: Path,
    texture: str,
    points: _Element,
    faces: _Element,
    vertices: np.ndarray,
    triangles: np.ndarray,
    corners: np.ndarray,
) -> tuple[trimesh.Trimesh | None, tuple[str, ...]]:
    """Returns the surface with its image, and what is missing of it."""
    if not texture:
        return None, ()
    image = opened_image(find_file(path.parent, texture))
    if image is None:
        return None, (f"its texture {texture} does not exist",)
    uv = None
    for u, v in (("s", "t"), ("u", "v"), ("texture_u", "texture_v")):
        if {u, v} <= set(points.scalars):
            table = np.stack([points.scalars[u], points.scalars[v]], axis=1)
            uv = table[triangles.ravel()]
    _, flat = faces.lists.get("texcoord", (np.zeros(0), np.zeros(0)))
    if uv is None and len(flat) and corners.max(initial=-1) < len(flat) // 2:
        uv = flat.reshape(-1, 2)[corners.ravel()]
    if uv is None:
        return None, (f"its texture {texture} has no coordinates",)
    faces_of = np.arange(3 * len(triangles)).reshape(-1, 3)
    return with_image(vertices[triangles.ravel()], faces_of, uv, image), ()


def _color(
    points: _Element,
    faces: _Element,
    vertices: np.ndarray,
    triangles: np.ndarray,
    owners: np.ndarray,
) -> np.ndarray:
    for prefix in ("", "diffuse_"):
        names = [prefix + name for name in ("red", "green", "blue")]
        for element, per_vertex in ((points, True), (faces, False)):
            if not set(names) <= set(element.scalars):
                continue
            colors = _in_unit(element, names)
            if per_vertex:
                colors = colors[triangles].mean(axis=1)
            elif owners.max(initial=-1) >= len(colors):
                continue
            else:
                colors = colors[owners]
            return mean_over_surface(vertices, triangles, colors)
    return np.zeros(0)


def _in_unit(element: _Element, names: list[str]) -> np.ndarray:
    """Returns (n, 3) colours in [0, 1]; integers count in 255ths."""
    kinds = {name: kind for name, _, kind in element.properties}
    colors = np.stack([element.scalars[k] for k in names], axis=1).astype(float)
    whole = kinds[names[0]].startswith(("u", "i"))
    return np.clip(colors / 255, 0, 1) if whole else unit_colors(colors)
