"""Wavefront OBJ."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import trimesh

from xray_drake.scene.meshes.formats.file_mesh import (
    FileMesh,
    in_one,
    mean_over_surface,
    triangulate,
    unit_colors,
)
from xray_drake.scene.meshes.formats.images import opened_image, with_image
from xray_drake.scene.meshes.formats.materials import (
    Library,
    Material,
    read_libraries,
)
from xray_drake.scene.meshes.formats.text import (
    decoded,
    logical_lines,
    number,
    without_comment,
)

_GREY = np.full(3, 0.8)
"""``Kd`` of a material without one."""


@dataclass
class _Content:
    """The lines that count, of a file."""

    vertices: list[list[float]] = field(default_factory=list)
    colors: dict[int, list[float]] = field(default_factory=dict)
    texture: list[list[float]] = field(default_factory=list)
    corners: list[int] = field(default_factory=list)
    uv: list[int] = field(default_factory=list)
    sizes: list[int] = field(default_factory=list)
    groups: list[int] = field(default_factory=list)
    used: list[int] = field(default_factory=list)
    materials: list[str] = field(default_factory=lambda: [""])
    libraries: list[str] = field(default_factory=list)
    group: int = 0


def read_obj(path: Path) -> FileMesh:
    """Reads an OBJ file and its materials.

    Each ``o`` and ``g`` line begins a group. Curves, points and lines do not
    count.

    Raises:
        ValueError: a line cannot be read.
        OSError: a file cannot be read.
    """
    content = _parsed(decoded(path.read_bytes()))
    vertices = np.array(content.vertices, dtype=float).reshape(-1, 3)
    corners = np.array(content.corners, dtype=np.int64)
    if len(corners) and corners.max() >= len(vertices):
        raise ValueError(
            f"a face names vertex {corners.max() + 1} of {len(vertices)}"
        )
    made = triangulate(vertices[corners], content.sizes)
    triangles = corners[made.corners]
    library = read_libraries(content.libraries, path.parent)
    used = np.array(content.used, dtype=np.int64)[made.owners]
    materials = [
        library.materials.get(name, Material()) for name in content.materials
    ]
    color = _color(content, vertices, triangles, used, materials)
    uv = np.array(content.uv, dtype=np.int64)[made.corners]
    visual = _visual(content.texture, vertices, triangles, uv, used, materials)
    return FileMesh(
        vertices=vertices,
        triangles=triangles,
        groups=np.array(content.groups, dtype=np.int64)[made.owners],
        visual=visual,
        color=color,
        notes=_notes(library, materials, used, visual is not None),
    )


def obj_side_files(path: Path) -> list[Path]:
    """Returns the material libraries and images that an OBJ file names."""
    names = [
        line.split(None, 1)[1]
        for _, line in logical_lines(decoded(path.read_bytes()))
        if line[:7].lower() == "mtllib " or line[:7].lower() == "mtllib\t"
    ]
    library = read_libraries(names, path.parent)
    images = [material.image for material in library.materials.values()]
    return library.files + list(dict.fromkeys(i for i in images if i))


def _parsed(text: str) -> _Content:
    content = _Content()
    for line_number, line in logical_lines(text):
        keyword, *more = line.split(None, 1)
        rest = "".join(more)
        try:
            _take(content, keyword.lower(), rest)
        except ValueError as error:
            short = line if len(line) <= 60 else line[:57] + "..."
            raise ValueError(
                f"line {line_number}, {short!r}: {error}"
            ) from None
    return content


def _take(content: _Content, keyword: str, rest: str) -> None:
    if keyword == "v":
        values = [number(word) for word in without_comment(rest).split()]
        if len(values) < 3:
            raise ValueError("a vertex has three coordinates")
        if len(values) >= 6:
            content.colors[len(content.vertices)] = values[3:6]
        content.vertices.append(values[:3])
    elif keyword == "vt":
        words = without_comment(rest).split()
        values = [number(word) for word in words[:2]]
        content.texture.append([*values, 0.0, 0.0][:2])
    elif keyword in ("f", "fo"):
        _take_face(content, without_comment(rest).split())
    elif keyword in ("o", "g"):
        content.group += 1
    elif keyword == "usemtl":
        content.materials.append(rest)
    elif keyword == "mtllib":
        content.libraries.append(rest)


def _take_face(content: _Content, words: list[str]) -> None:
    if len(words) < 3:
        return
    for word in words:
        named, _, others = word.partition("/")
        content.corners.append(_index(named, len(content.vertices), "vertex"))
        uv = others.partition("/")[0]
        # Texture coordinates that do not exist cost only the texture.
        at = int(uv) if uv else 0
        content.uv.append(at - 1 if at >= 0 else len(content.texture) + at)
    content.sizes.append(len(words))
    content.groups.append(content.group)
    content.used.append(len(content.materials) - 1)


def _index(word: str, count: int, what: str) -> int:
    index = int(word)
    if index == 0 or index < -count:
        raise ValueError(f"there is no {what} {index}")
    return index - 1 if index > 0 else count + index


def _color(
    content: _Content,
    vertices: np.ndarray,
    triangles: np.ndarray,
    used: np.ndarray,
    materials: Sequence[Material],
) -> np.ndarray:
    named = np.array([m.color is not None for m in materials])
    colors = None
    if len(triangles) and named[used].any():
        palette = [_GREY if m.color is None else m.color for m in materials]
        colors = np.array(palette)[used]
    elif content.colors:
        of_vertices = np.tile(_GREY, (len(vertices), 1))
        of_vertices[list(content.colors)] = unit_colors(
            np.array(list(content.colors.values()))
        )
        colors = of_vertices[triangles].mean(axis=1)
    return mean_over_surface(vertices, triangles, colors)


def _visual(
    texture: list[list[float]],
    vertices: np.ndarray,
    triangles: np.ndarray,
    uv: np.ndarray,
    used: np.ndarray,
    materials: Sequence[Material],
) -> trimesh.Trimesh | None:
    """Returns the surface with one image, into which all materials go."""
    coordinates = np.array(texture, dtype=float).reshape(-1, 2)
    placed = np.all((uv >= 0) & (uv < len(coordinates)), axis=1)
    images = [opened_image(material.image) for material in materials]
    shown = np.isin(used, [k for k, image in enumerate(images) if image])
    if not np.any(shown & placed):
        return None
    parts = []
    for index in np.unique(used):
        mine = used == index
        # What has no coordinates shows one corner of its image.
        named = np.where(placed[mine, None], uv[mine], -1)
        corners = np.stack([triangles[mine], named], axis=2).reshape(-1, 2)
        pairs, faces = np.unique(corners, axis=0, return_inverse=True)
        padded = np.vstack([coordinates, np.zeros((1, 2))])
        color = materials[index].color
        diffuse = np.append(_GREY if color is None else color, 1) * 255
        parts.append(
            with_image(
                vertices[pairs[:, 0]],
                faces.reshape(-1, 3),
                padded[pairs[:, 1]],
                images[index],
                diffuse.round().astype(np.uint8),
            )
        )
    return in_one(parts)


def _notes(
    library: Library,
    materials: Sequence[Material],
    used: np.ndarray,
    textured: bool,
) -> tuple[str, ...]:
    notes = [
        f"its material library {name} does not exist"
        for name in library.missing
    ]
    for index in np.unique(used):
        material = materials[index]
        if material.missing:
            notes.append(f"its texture {material.missing} does not exist")
        elif material.image is not None and not textured:
            notes.append(f"its texture {material.image.name} cannot be used")
    return tuple(dict.fromkeys(notes))
