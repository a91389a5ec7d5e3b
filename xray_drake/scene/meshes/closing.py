"""Makes a solid of the triangles of a file: its bodies with their cavities."""

from dataclasses import dataclass, field

import manifold3d
import numpy as np
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components
from scipy.spatial import cKDTree

from xray_drake.scene.meshes.formats.file_mesh import triangulate
from xray_drake.scene.meshes.pieces import hull_vertices
from xray_drake.scene.meshes.solids import joined, solid, surface

MERGED = (1e-5, 1e-4, 1e-3)
"""Of the longest side: vertices that are nearer are one; the wider distances
only where they close at least half of what is open."""

MOST_FILLED = 0.2
"""Holes are filled while that makes at most this share of the surface."""

NAMED = 0.01
"""A repair is named where it changes the area, the volume or the longest side
by more than this share."""

_NOTHING = 1e-6
"""Of the volume: parts that are smaller do not count."""

MOST_CONVEX = 256
CONVEX = 0.97
"""So many bodies, each filling so much of its hull, are convex pieces."""

_SWALLOWED = 0.99
"""Of a body's volume: so much of it lies in another one's matter."""

_SLICES = 64
MOST_CROSSED = 0.05
"""Of the volume, by which slices may differ: so coarse they are."""

_INSIDE = 0.5
"""Of a cavity's volume: so much lies in the body that it hollows out."""


@dataclass(frozen=True, eq=False)
class Closed:
    """A solid and what had to be done for it.

    Attributes:
        mesh: its surface, closed and turned outward, without texture.
        convex: (n, 3) hull vertices, m, of each body where there are several
            and all are convex; else empty.
        repairs: short sentences on what changes it by more than ``NAMED``.
    """

    mesh: trimesh.Trimesh
    convex: tuple[np.ndarray, ...]
    repairs: tuple[str, ...]


@dataclass
class _Work:
    """Triangles on their way to a closed surface.

    Attributes:
        vertices: (n, 3), m.
        triangles: (m, 3).
        area: of the file's surface, m².
        repairs: as in :class:`Closed`.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    area: float
    repairs: list[str] = field(default_factory=list)


def closed_solid(
    vertices: np.ndarray, triangles: np.ndarray, groups: np.ndarray
) -> Closed:
    """Returns the union of the bodies that triangles enclose.

    Vertices at one place are merged and faces that are there twice count once;
    groups that are closed stay apart in this. Where neighbours disagree on the
    outside, the larger part of them is followed. Each hole is filled. What is
    closed then falls into bodies and cavities; each cavity is taken from the
    smallest body around it, and the bodies are joined.

    Args:
        vertices: (n, 3), m.
        triangles: (m, 3) indices of them.
        groups: (m,) of each triangle.

    Raises:
        ValueError: it is not closed, and closing it would be a guess; it
            encloses nothing; or the solid is not what the file shows.
    """
    used = vertices[np.unique(triangles)]
    middle = (used.min(axis=0) + used.max(axis=0)) / 2
    longest = float(np.ptp(used, axis=0).max())
    work = _merged(vertices - middle, triangles, groups, longest)
    if work.area == 0:
        raise ValueError("it encloses nothing")
    _drop_doubles(work)
    _turn_alike(work)
    said = abs(_volume(work.vertices, work.triangles))
    _fill_holes(work)
    bodies, volume = _bodies(work)
    whole = joined(bodies) if len(bodies) > 1 else bodies[0]
    crossed = 1 - _sliced_volume(whole) / whole.volume()
    if crossed > MOST_FILLED:
        raise ValueError(f"its surface passes through itself ({crossed:.0%})")
    if crossed > MOST_CROSSED:
        work.repairs.append(
            f"{crossed:.0%} counts twice, since its surface passes through "
            "itself"
        )
    if abs(volume - said) > NAMED * max(volume, said):
        work.repairs.append(
            f"it encloses {volume * 1e6:.4g} cm³, its faces alone "
            f"{said * 1e6:.4g} cm³"
        )
    low, high = np.split(np.array(whole.bounding_box()), 2)
    shorter = float((np.ptp(used, axis=0) - (high - low)).max()) / longest
    if shorter > NAMED:
        work.repairs.append(
            f"{shorter:.0%} shorter, since a part encloses nothing"
        )
    mesh = surface(whole)
    mesh.apply_translation(middle)
    convex = tuple(hull + middle for hull in _convex(bodies))
    return Closed(mesh, convex, tuple(work.repairs))


def _merged(
    vertices: np.ndarray,
    triangles: np.ndarray,
    groups: np.ndarray,
    longest: float,
) -> _Work:
    """Makes one of vertices that are near each other.

    Groups stay apart if all of them are closed by themselves.
    """
    near = MERGED[0] * longest
    if len(np.unique(groups)) > 1:
        points, faces = _merge(vertices, triangles, groups, near)
        if _open_sides(faces) == 0:
            return _Work(points, faces, _area(points, faces))
    one = np.zeros_like(groups)
    points, faces = _merge(vertices, triangles, one, near)
    work, left = _Work(points, faces, _area(points, faces)), _open_sides(faces)
    for share in MERGED[1:]:
        if left == 0:
            break
        points, faces = _merge(vertices, triangles, one, share * longest)
        area, now_left = _area(points, faces), _open_sides(faces)
        if 2 * now_left <= left and abs(area - work.area) < NAMED * work.area:
            text = f"vertices within {share * longest * 1e3:.2g} mm merged"
            work, left = _Work(points, faces, area, [text]), now_left
    return work


def _merge(
    vertices: np.ndarray,
    triangles: np.ndarray,
    groups: np.ndarray,
    near: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Merges vertices of one group that are near each other.

    Returns:
        The vertices that are left, (n, 3), and the triangles, (m, 3), that
        have three of them.
    """
    corners = np.column_stack([np.repeat(groups, 3), triangles.ravel()])
    begins, inverse = _distinct(corners)
    group, index = corners[begins].T
    places = vertices[index]
    pairs = cKDTree(places).query_pairs(near, output_type="ndarray")
    one, other = pairs[group[pairs[:, 0]] == group[pairs[:, 1]]].T
    graph = coo_array(
        (np.ones(len(one)), (one, other)), shape=(len(places), len(places))
    )
    _, labels = connected_components(graph, directed=False)
    _, first = np.unique(labels, return_index=True)
    faces = labels[inverse].reshape(-1, 3).astype(np.int64)
    a, b, c = faces.T
    return places[first], faces[(a != b) & (b != c) & (c != a)]


def _distinct(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Finds equal rows of (n, k) integers that are not negative.

    Returns:
        Where each of the distinct rows is first; (n,) which of them each is.
    """
    keys = rows[:, 0]
    for column in rows.T[1:]:
        _, keys = np.unique(keys, return_inverse=True)
        keys = keys * (column.max(initial=0) + 1) + column
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    return first, inverse


def _area(vertices: np.ndarray, triangles: np.ndarray) -> float:
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2


def _volume(vertices: np.ndarray, triangles: np.ndarray) -> float:
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6


def _edges(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Describes the 3m sides of triangles.

    Returns:
        (e, 2) edges, lower vertex first; (3m,) the edge of each side, that
        from corner 0 to 1 of triangle 0 first; (3m,) 1 if the side runs from
        the edge's lower to its higher vertex, else −1.
    """
    sides = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    ordered = np.sort(sides, axis=1)
    first, edge_of = _distinct(ordered)
    return ordered[first], edge_of, np.where(sides[:, 0] < sides[:, 1], 1, -1)


def _open_sides(triangles: np.ndarray) -> int:
    """Counts what sides have too many one way; 0 for closed surfaces."""
    edges, edge_of, way = _edges(triangles)
    return int(np.abs(np.bincount(edge_of, way, len(edges))).sum())


def _net_faces(
    triangles: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Finds faces that are there more than once.

    Returns:
        Indices of one of each face; of one of each face that is left when
        two that look opposite ways cancel.
    """
    first = np.argmin(triangles, axis=1)[:, None]
    begun = np.take_along_axis(triangles, (first + [0, 1, 2]) % 3, axis=1)
    way = np.where(begun[:, 1] < begun[:, 2], 1, -1)
    once, face_of = _distinct(np.sort(triangles, axis=1))
    net = np.bincount(face_of, way, len(once))[face_of]
    left = np.flatnonzero(net * way > 0)
    _, index = np.unique(face_of[left], return_index=True)
    return np.sort(once), left[np.sort(index)]


def _drop_doubles(work: _Work) -> None:
    """Counts faces once that are there more often.

    Two that look opposite ways are where bodies touch, and cancel, or a sheet
    drawn on both sides, of which one counts: whichever leaves less open.
    """
    once, left = _net_faces(work.triangles)
    single, cancelled = work.triangles[once], work.triangles[left]
    if len(left) and _open_sides(cancelled) <= _open_sides(single):
        work.triangles = cancelled
        return
    work.triangles = single
    lost = 1 - _area(work.vertices, single) / work.area
    if lost > NAMED:
        work.repairs.append(
            f"faces that are there twice counted once ({lost:.0%})"
        )


def _turn_alike(work: _Work) -> None:
    """Turns triangles as most of their neighbours are, over edges of two."""
    triangles = work.triangles
    edges, edge_of, way = _edges(triangles)
    if not np.bincount(edge_of, way, len(edges)).any():
        return
    order = np.argsort(edge_of, kind="stable")
    begins = np.searchsorted(edge_of[order], np.arange(len(edges)))
    of_two = np.bincount(edge_of, minlength=len(edges)) == 2
    one, other = order[begins[of_two]], order[begins[of_two] + 1]
    disagree = way[one] == way[other]
    if not disagree.any():
        return
    count = len(triangles)
    graph = coo_array(
        # 1 where neighbours agree, 2 where they do not.
        (1 + disagree, (one // 3, other // 3)),
        shape=(count, count),
    ).tocsr()
    graph.data = np.minimum(graph.data, 2)
    graph = graph.maximum(graph.T).tocsr()
    number, labels = connected_components(graph, directed=False)
    flip = np.zeros(count, dtype=bool)
    roots = np.unique(labels, return_index=True)[1]
    for root in roots[np.isin(np.arange(number), labels[one[disagree] // 3])]:
        nodes, before = breadth_first_order(graph, root, directed=False)
        parents = before[nodes[1:]]
        opposite = np.asarray(graph[nodes[1:], parents]).ravel() == 2
        for node, parent, turned in zip(
            nodes[1:], parents, opposite, strict=True
        ):
            flip[node] = flip[parent] ^ turned
        if flip[nodes].sum() * 2 > len(nodes):
            flip[nodes] = ~flip[nodes]
    area = _area(work.vertices, triangles[flip]) / work.area
    triangles = triangles.copy()
    triangles[flip] = triangles[flip][:, ::-1]
    work.triangles = triangles
    if area > NAMED:
        work.repairs.append(f"{area:.0%} of its faces turned over")


def _fill_holes(work: _Work) -> None:
    """Closes the surface: triangulates the loops around each hole.

    Raises:
        ValueError: that makes too much of the surface.
    """
    loops = _loops(work.triangles)
    if not loops:
        return
    corners = np.concatenate(loops)
    made = triangulate(work.vertices[corners], [len(loop) for loop in loops])
    patches = corners[made.corners]
    area = _area(work.vertices, patches)
    share = area / (area + _area(work.vertices, work.triangles))
    if share > MOST_FILLED:
        raise ValueError(
            f"it is not closed: filling its holes would make {share:.0%} of "
            f"its surface (at most {MOST_FILLED:.0%})"
        )
    work.triangles = np.concatenate([work.triangles, patches])
    work.triangles = work.triangles[_net_faces(work.triangles)[1]]
    if share > NAMED:
        holes = "a hole" if len(loops) == 1 else f"{len(loops)} holes"
        work.repairs.append(f"{holes} filled ({share:.0%} of its surface)")


def _loops(triangles: np.ndarray) -> list[np.ndarray]:
    """Returns the closed ways along sides that no other triangle takes.

    The sides that are left when opposite ones cancel enter each vertex as often
    as they leave it, so every one of them belongs to a loop. A loop passes no
    vertex twice, and runs against its sides.
    """
    edges, edge_of, way = _edges(triangles)
    net = np.bincount(edge_of, way, len(edges)).astype(int)
    ends: dict[int, list[int]] = {}
    for (low, high), times in zip(
        edges[net != 0].tolist(), net[net != 0].tolist(), strict=True
    ):
        start, end = (high, low) if times > 0 else (low, high)
        ends.setdefault(start, []).extend([end] * abs(times))
    loops = []
    for start in sorted(ends):
        while ends[start]:
            way_back, place = [start], {start: 0}
            while True:
                after = ends[way_back[-1]].pop()
                if after in place:
                    loop = way_back[place[after] :]
                    loops.append(np.array(loop))
                    for passed in loop[1:]:
                        del place[passed]
                    way_back = way_back[: place[after] + 1]
                    if after == start:
                        break
                    continue
                place[after] = len(way_back)
                way_back.append(after)
    return [loop for loop in loops if len(loop) >= 3]


def _bodies(work: _Work) -> tuple[list[manifold3d.Manifold], float]:
    """Finds the bodies, each less its cavities, and the sum of all, m³.

    Raises:
        ValueError: nothing is enclosed.
    """
    if _volume(work.vertices, work.triangles) < 0:
        work.triangles = work.triangles[:, ::-1]
    whole = solid(trimesh.Trimesh(work.vertices, work.triangles, process=False))
    parts = whole.decompose()
    total = sum(abs(part.volume()) for part in parts)
    parts = [part for part in parts if abs(part.volume()) > _NOTHING * total]
    if total <= 0 or not parts:
        raise ValueError("it encloses nothing")
    bodies = [part for part in parts if part.volume() > 0]
    bodies.sort(key=lambda part: part.volume())
    cavities = [_inverted(part) for part in parts if part.volume() < 0]
    hollowed = list(bodies)
    for cavity in cavities:
        for index, body in enumerate(bodies):
            if (body ^ cavity).volume() > _INSIDE * cavity.volume():
                hollowed[index] = hollowed[index] - cavity
                break
        else:
            hollowed.append(cavity)
            share = cavity.volume() / total
            if share > NAMED:
                work.repairs.append(
                    f"a part that was inside out turned ({share:.0%})"
                )
    swallowed = _swallowed(hollowed) / total
    if swallowed > NAMED:
        work.repairs.append(
            f"bodies within other bodies taken as solid ({swallowed:.0%})"
        )
    return hollowed, sum(part.volume() for part in hollowed)


def _swallowed(bodies: list[manifold3d.Manifold]) -> float:
    """Returns the volume of bodies that lie within the matter of another."""
    volume = 0.0
    boxes = np.array([body.bounding_box() for body in bodies])
    for index, body in enumerate(bodies):
        own = body.volume()
        around = np.flatnonzero(
            np.all(boxes[:, :3] <= boxes[index, :3], axis=1)
            & np.all(boxes[:, 3:] >= boxes[index, 3:], axis=1)
        )
        if any(
            (body - bodies[other]).volume() < (1 - _SWALLOWED) * own
            for other in around
            if bodies[other].volume() > own
        ):
            volume += own
    return volume


def _sliced_volume(whole: manifold3d.Manifold) -> float:
    """Measures a volume by slices, in which what is there twice counts once.

    Slices miss what is thin along their normal, so the axis that finds most is
    taken.
    """
    most = 0.0
    for axis in range(3):
        turn = np.roll(np.eye(3), axis, axis=0)
        turned = whole.transform(np.column_stack([turn, np.zeros(3)]))
        bounds = turned.bounding_box()
        height = bounds[5] - bounds[2]
        levels = bounds[2] + (np.arange(_SLICES) + 0.5) / _SLICES * height
        areas = [turned.slice(float(level)).area() for level in levels]
        most = max(most, float(np.mean(areas)) * height)
        if most > (1 - MOST_CROSSED) * whole.volume():
            break
    return most


def _convex(bodies: list[manifold3d.Manifold]) -> list[np.ndarray]:
    """Returns the hull vertices of several bodies if all are convex."""
    if not 2 <= len(bodies) <= MOST_CONVEX or any(
        body.volume() < CONVEX * body.hull().volume() for body in bodies
    ):
        return []
    return [
        hull_vertices(np.asarray(body.to_mesh64().vert_properties[:, :3]))
        for body in bodies
    ]


def _inverted(made: manifold3d.Manifold) -> manifold3d.Manifold:
    mesh = made.to_mesh64()
    return solid(
        trimesh.Trimesh(
            mesh.vert_properties[:, :3], mesh.tri_verts[:, ::-1], process=False
        )
    )
