"""How alike two shapes are, and the table of draws that are not.

A shape is centred on the mean of its surface and scaled to unit root mean
square distance from there. The distance of two such shapes is the Chamfer
distance: the mean distance of 512 even points on the one from the surface of
the other (16,384 points of it), averaged over both directions, and the least
over the 24 rotations that map axes to axes, both between the body frames and
between the principal frames of the surfaces. It has no unit: 0.05 is a
twentieth of the mean radius. A shape is at some 0.02 from another sample of
itself.

Every object of the library, of whatever split, is farther than ``BOUND`` from
every other. ``python -m tests.scene.likeness`` measures all of them;
``--write`` draws the table ``families/draws.json`` again.
"""

import itertools
import json
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from xray_drake.kernels import kernel
from xray_drake.scene import families, library
from xray_drake.scene.families import (
    FAMILIES,
    TEST_FAMILIES,
)

BOUND = 0.03

POINTS = 512
SURFACE_POINTS = 16384

TRAINING_MEMBERS = 40
VALIDATION_MEMBERS = 5
TEST_MEMBERS = 16
"""Objects to draw of a family; of some the bound leaves fewer."""

PATIENCE = 10
"""Draws in a row that are alike others before a family is given up."""

FIRST_MEMBERS = 12
"""Of each family these are drawn before any more of another."""

TABLE = Path(families.__file__).parent / "draws.json"

_CELL, _HALF = 0.15, 16
_SIDE = 2 * _HALF + 1
_COUNT = 0.005
"""Distance fields: (33, 33, 33) cells of 0.15, uint8 counts of 0.005."""


def _axis_rotations() -> np.ndarray:
    """Returns the (24, 3, 3) rotations that map axes to axes."""
    rotations = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1, -1), repeat=3):
            matrix = np.zeros((3, 3), dtype=np.int64)
            matrix[range(3), order] = signs
            if round(np.linalg.det(matrix)) == 1:
                rotations.append(matrix)
    return np.array(rotations)


ROTATIONS = _axis_rotations()

_STRIDES = np.array([_SIDE * _SIDE, _SIDE, 1])
_STEPS = np.stack(
    [_STRIDES @ ROTATIONS, _STRIDES @ ROTATIONS.transpose(0, 2, 1)]
)
"""(2, 24, 3) steps in a flat field per cell along x, y and z of the shape that
is turned by a rotation, and by its inverse."""


def surface_points(mesh: trimesh.Trimesh, count: int) -> np.ndarray:
    """Returns (count, 3) points spread evenly over a surface, always the same.

    The areas of the faces are laid end to end and divided evenly; within the
    faces the points follow a sequence of low discrepancy.
    """
    ends = np.cumsum(mesh.area_faces)
    steps = (np.arange(count) + 0.5) / count * ends[-1]
    faces = np.minimum(np.searchsorted(ends, steps), len(ends) - 1)
    plastic = 1.32471795724474602596
    sequence = np.outer(np.arange(1, count + 1), [1 / plastic, plastic**-2])
    u, v = (sequence % 1).T
    root = np.sqrt(u)
    weights = np.stack([1 - root, root * (1 - v), root * v], axis=1)
    return np.einsum("ij,ijk->ik", weights, np.asarray(mesh.triangles)[faces])


@dataclass(frozen=True, eq=False)
class Likeness:
    """A normalised shape, ready to be compared.

    Both frames are kept: body (index 0) and principal (1).

    Attributes:
        points: (2, 512, 3) on the surface.
        tree: of the (16384, 3) points on the surface, for each frame.
        cells: (2, 512, 8, 3) int8 cells about the points, the nearest first.
        slack: (2, 512, 8) int16 distances of the points from these cells, in
            counts, rounded up.
        field: (2, 33³) uint8 distance from each cell to the surface points, in
            counts, rounded down.
    """

    points: np.ndarray
    tree: tuple[cKDTree, cKDTree]
    cells: np.ndarray
    slack: np.ndarray
    field: np.ndarray


def likeness(mesh: trimesh.Trimesh) -> Likeness:
    """Prepares a shape for comparisons; takes some 50 ms."""
    surface = surface_points(mesh, SURFACE_POINTS)
    center = surface.mean(axis=0)
    scale = np.sqrt(np.mean(np.sum((surface - center) ** 2, axis=1)))
    surface = (surface - center) / scale
    points = (surface_points(mesh, POINTS) - center) / scale
    # In no order, so that a part of them speaks for all.
    points = points[np.random.default_rng(0).permutation(POINTS)]
    _, principal = np.linalg.eigh(surface.T @ surface)
    principal[:, 0] *= np.sign(np.linalg.det(principal))
    frames = (np.eye(3), principal)
    both = np.stack([points @ frame for frame in frames])
    trees = tuple(cKDTree(surface @ frame) for frame in frames)
    corners = np.array(list(itertools.product((0, 1), repeat=3)))
    cells = np.floor(both / _CELL)[:, :, None] + corners
    cells = np.clip(cells, -_HALF, _HALF).astype(np.int8)
    slack = np.linalg.norm(both[:, :, None] - cells * _CELL, axis=3) / _COUNT
    order = np.argsort(slack, axis=2)
    cells = np.take_along_axis(cells, order[..., None], axis=2)
    slack = np.take_along_axis(slack, order, axis=2)
    axis = np.arange(-_HALF, _HALF + 1) * _CELL
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    farthest = 3 * _CELL
    fields = []
    for tree in trees:
        distance, _ = tree.query(
            grid.reshape(-1, 3), distance_upper_bound=farthest
        )
        distance = np.minimum(distance, farthest)
        fields.append(np.floor(distance / _COUNT).astype(np.uint8))
    return Likeness(
        both, trees, cells, np.ceil(slack).astype(np.int16), np.stack(fields)
    )


def distance(one: Likeness, other: Likeness, enough: float = np.inf) -> float:
    """Returns the Chamfer distance of two shapes.

    Args:
        one: a shape.
        other: another.
        enough: a larger distance need not be told exactly.

    Returns:
        The distance, or something not less than ``enough`` where it is not
        less than that.
    """
    least = _least_bounds(
        one.cells,
        one.slack,
        one.field,
        other.cells[None],
        other.slack[None],
        other.field[None],
        _STEPS,
        enough,
    )[0]
    best = enough
    for flat in np.argsort(least, axis=None):
        frame, k = divmod(int(flat), len(ROTATIONS))
        if least[frame, k] >= best:
            break
        R = ROTATIONS[k]
        total = 0.0
        for part in np.split(np.arange(POINTS), 8):
            there, _ = other.tree[frame].query(one.points[frame, part] @ R.T)
            back, _ = one.tree[frame].query(other.points[frame, part] @ R)
            total += float(there.sum() + back.sum()) / (2 * POINTS)
            if total >= best:
                break
        best = min(best, total)
    return best


@dataclass
class Catalogue:
    """Shapes in an order, to be compared with one more.

    Attributes:
        names: what they are called.
        shapes: prepared for comparisons.
    """

    names: list[str] = field(default_factory=list)
    shapes: list[Likeness] = field(default_factory=list)

    def add(self, name: str, shape: Likeness) -> None:
        """Puts a shape at the end."""
        self.names.append(name)
        self.shapes.append(shape)

    def nearest(
        self,
        shape: Likeness,
        limit: float,
        *,
        leave_out: int = -1,
        any_will_do: bool = False,
    ) -> tuple[float, str]:
        """Finds the shape that is most alike, or any within the limit.

        Returns:
            The distance and the name; ``limit`` and "" where none is nearer.
        """
        if not self.shapes:
            return limit, ""
        bounds = _least_bounds(
            shape.cells[:, :, :1],
            shape.slack[:, :, :1],
            shape.field,
            np.stack([other.cells[:, :, :1] for other in self.shapes]),
            np.stack([other.slack[:, :, :1] for other in self.shapes]),
            np.stack([other.field for other in self.shapes]),
            _STEPS,
            limit,
        )
        bounds = bounds.reshape(len(self.shapes), -1).min(axis=1)
        best, name = limit, ""
        for index in np.argsort(bounds):
            if bounds[index] >= best or (name and any_will_do):
                break
            if index == leave_out:
                continue
            found = distance(shape, self.shapes[index], best)
            if found < best:
                best, name = found, self.names[index]
        return best, name


@kernel(nogil=True)
def _least_bounds(  # type: ignore[no-untyped-def]
    cells, slack, field, other_cells, other_slack, other_field, steps, limit
):
    """Bounds the Chamfer distances of one shape and many from below.

    A point is no nearer to a surface than the centre of any cell is, less the
    way to that centre; and the rotations map cells to cells.

    Returns:
        (N, 2, 24) bounds; infinite where they are not below ``limit``.
    """
    count, points, corners = len(other_cells), cells.shape[1], cells.shape[2]
    middle = ((_HALF * _SIDE) + _HALF) * _SIDE + _HALF
    stop = 2 * points * limit / _COUNT
    bounds = np.full((count, 2, steps.shape[1]), np.inf)
    for n in range(count):
        for f in range(2):
            for k in range(steps.shape[1]):
                u, v, w = steps[0, k]
                p, q, r = steps[1, k]
                total = 0
                for i in range(points):
                    gap = 0
                    for j in range(corners):
                        x, y, z = cells[f, i, j]
                        at = middle + u * x + v * y + w * z
                        gap = max(gap, other_field[n, f, at] - slack[f, i, j])
                    total += gap
                    gap = 0
                    for j in range(corners):
                        x, y, z = other_cells[n, f, i, j]
                        at = middle + p * x + q * y + r * z
                        gap = max(gap, field[f, at] - other_slack[n, f, i, j])
                    total += gap
                    if total >= stop:
                        break
                if total < stop:
                    bounds[n, f, k] = total * _COUNT / (2 * points)
    return bounds


def draw_table(catalogue: Catalogue) -> dict[str, dict[str, list[int]]]:
    """Draws members of every family that are unlike all before them.

    First comes a dozen of each family, then the rest of each.

    Args:
        catalogue: empty; filled with what is drawn.

    Returns:
        Draws by family and split.
    """
    chosen: dict[str, list[int]] = {family: [] for family in FAMILIES}
    drawn = dict.fromkeys(FAMILIES, 0)
    for first, family in itertools.product((True, False), FAMILIES):
        wanted = TRAINING_MEMBERS + VALIDATION_MEMBERS
        if family in TEST_FAMILIES:
            wanted = TEST_MEMBERS
        if first:
            wanted = FIRST_MEMBERS
        refused = 0
        while len(chosen[family]) < wanted and refused < PATIENCE:
            name = f"{family}_{len(chosen[family]):03d}"
            model = library.drawn_object(name, family, drawn[family])
            shape = likeness(model.visual)
            if catalogue.nearest(shape, BOUND, any_will_do=True)[1]:
                refused += 1
            else:
                refused = 0
                catalogue.add(name, shape)
                chosen[family].append(drawn[family])
            drawn[family] += 1
    table: dict[str, dict[str, list[int]]] = {}
    for family, draws in chosen.items():
        if family in TEST_FAMILIES:
            table[family] = {"test": draws}
            continue
        kept = len(draws) - min(VALIDATION_MEMBERS, len(draws) // 5)
        table[family] = {"train": draws[:kept], "validation": draws[kept:]}
    return table


def main() -> int:
    """Measures the library, or with ``--write`` draws its table again."""
    catalogue = Catalogue()
    if "--write" in sys.argv[1:]:
        lines = (
            f"  {json.dumps(family)}: {json.dumps(draws)}"
            for family, draws in draw_table(catalogue).items()
        )
        TABLE.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
    else:
        for split in library.SPLITS:
            for name in library.object_names(split=split):
                catalogue.add(name, likeness(library.make_object(name).visual))
    found = [
        (*catalogue.nearest(shape, 2 * BOUND, leave_out=index), name)
        for index, (name, shape) in enumerate(
            zip(catalogue.names, catalogue.shapes, strict=True)
        )
    ]
    low, other, name = min(found)
    percent, median = np.percentile([row[0] for row in found], [1, 50])
    print(
        f"{len(found)} objects; distance to the nearest other: least {low:.4f} "
        f"({name} and {other}), 1st percentile {percent:.4f}, median "
        f"{median:.4f}; bound {BOUND}"
    )
    return 0 if low > BOUND else 1


if __name__ == "__main__":
    sys.exit(main())
