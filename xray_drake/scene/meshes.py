"""Imports objects from a folder of OBJ files, each as its convex hull."""

import json
import logging
import zlib
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError

from xray_drake.scene.colors import distractor_color
from xray_drake.scene.object_model import ObjectModel, object_from_pieces

DEFAULT_DENSITY = 300.0
"""kg/m³ of the convex hull, where the folder gives no mass."""

MASSES_FILE = "masses.json"

SMALLEST = 0.005
LARGEST = 0.25
"""m. The longest side of the bounding box must lie between these."""

LIGHTEST = 0.0005
"""kg. Lighter bodies do not survive contact with the others."""

COLLISION_VERTICES = 12

_logger = logging.getLogger(__name__)


def load_meshes(
    folder: Path,
    *,
    density: float = DEFAULT_DENSITY,
    collision_vertices: int = COLLISION_VERTICES,
) -> list[ObjectModel]:
    """Reads every OBJ file under a folder, in the order of the paths.

    Each object is the convex hull of its mesh, taken to be in metres, with the
    body origin at the hull's centre of mass. It collides as the hull of a few
    of the hull's vertices, which lies inside. Colours are drawn by name and are
    never red. Files that cannot be used are skipped with one line in the log.

    ``masses.json`` in the folder, where there is one, maps names to kg. A name
    is a file's path in the folder without suffix, the same of its directory,
    or the file's stem.

    Args:
        folder: where to look, also in its subfolders.
        density: kg/m³ for what has no mass in ``masses.json``.
        collision_vertices: most vertices of a collision hull.

    Returns:
        Objects called ``folder/path`` without suffix, as in
        ``toys/duck/textured``.

    Raises:
        ValueError: the folder does not exist, its ``masses.json`` is not a map
            from names to positive numbers, or no file can be used.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ValueError(f"no folder of meshes: {folder}")
    paths = sorted(
        path for path in folder.rglob("*") if path.suffix.lower() == ".obj"
    )
    if not paths:
        raise ValueError(f"no OBJ file in {folder}")
    masses = _read_masses(folder)
    models = []
    for path in paths:
        try:
            hull = _read_hull(path)
            mass = _mass(path.relative_to(folder), masses)
            if mass is None:
                mass = density * hull.volume
            if mass < LIGHTEST:
                raise ValueError(f"it weighs only {mass * 1e6:.3g} mg")
        except ValueError as error:
            _logger.warning("skipped %s: %s", path, error)
            continue
        relative = path.relative_to(folder).with_suffix("").as_posix()
        name = f"{folder.resolve().name}/{relative}"
        corners = np.asarray(hull.vertices)
        rng = np.random.default_rng(zlib.crc32(name.encode()))
        models.append(
            object_from_pieces(
                name,
                [hull],
                density=mass / hull.volume,
                collision=[simplified_hull(corners, collision_vertices)],
                color=distractor_color(rng),
            )
        )
    if not models:
        raise ValueError(
            f"none of the {len(paths)} OBJ files in {folder} can be used"
        )
    return models


def simplified_hull(points: np.ndarray, count: int) -> np.ndarray:
    """Chooses points whose convex hull comes close to that of all.

    Four points far apart begin; each next one is the farthest outside the hull
    of those chosen. (Farthest from the chosen *points* would be the simpler
    rule, but at 12 points it keeps 75 % of a typical volume, this 84 %.)

    Args:
        points: (n, 3), not in a plane.
        count: how many to choose, at least 4.

    Returns:
        (m, 3) of ``points``, m ≤ ``count``, all vertices of their hull.
    """
    chosen = _far_apart(points, 4)
    while len(chosen) < count:
        planes = ConvexHull(chosen, qhull_options="QJ").equations
        outside = (points @ planes[:, :3].T + planes[:, 3]).max(axis=1)
        index = int(np.argmax(outside))
        if outside[index] < 1e-6:
            break
        chosen = np.vstack([chosen, points[index]])
    return chosen[ConvexHull(chosen).vertices]


def _far_apart(points: np.ndarray, count: int) -> np.ndarray:
    """Chooses the farthest from the mean, then the farthest from those."""
    first = np.linalg.norm(points - points.mean(axis=0), axis=1)
    chosen = [int(np.argmax(first))]
    distance = np.full(len(points), np.inf)
    while len(chosen) < count:
        step = np.linalg.norm(points - points[chosen[-1]], axis=1)
        distance = np.minimum(distance, step)
        chosen.append(int(np.argmax(distance)))
    return points[chosen]


def _read_hull(path: Path) -> trimesh.Trimesh:
    """Reads the convex hull of a file.

    Raises:
        ValueError: it cannot be used; the message says why in one line.
    """
    try:
        mesh = trimesh.load_mesh(path, process=False, skip_materials=True)
        corners = np.asarray(mesh.vertices)[np.unique(mesh.faces)]
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"cannot be read ({reason})") from error
    if len(corners) == 0:
        raise ValueError("it has no faces")
    if not np.isfinite(corners).all():
        raise ValueError("a vertex is not finite")
    longest = float(np.ptp(corners, axis=0).max())
    if not SMALLEST <= longest <= LARGEST:
        raise ValueError(
            f"its longest side is {longest:.4g} m, not {SMALLEST} to "
            f"{LARGEST} m"
        )
    try:
        hull = trimesh.Trimesh(corners, process=False).convex_hull
    except (QhullError, ValueError):
        raise ValueError("it is flat") from None
    if not hull.is_volume or hull.volume < 1e-6 * longest**3:
        raise ValueError("it is flat")
    return hull


def _mass(relative: Path, masses: dict[str, float]) -> float | None:
    stem = relative.with_suffix("")
    for key in (stem.as_posix(), stem.parent.as_posix(), stem.name):
        if key in masses:
            return masses[key]
    return None


def _read_masses(folder: Path) -> dict[str, float]:
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
