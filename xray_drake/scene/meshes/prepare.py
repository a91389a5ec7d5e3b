"""Converts one mesh file into a simulation asset, and keeps it in a cache."""

import hashlib
import io
import logging
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from xray_drake.faults import is_fault, one_line
from xray_drake.files import write_whole_file
from xray_drake.scene.meshes.closing import closed_solid
from xray_drake.scene.meshes.decompose import convex_pieces, decimated
from xray_drake.scene.meshes.formats import FileMesh, read_file, side_files
from xray_drake.scene.meshes.losses import LossLimits
from xray_drake.scene.meshes.pieces import hull_volume, without_slivers
from xray_drake.scene.meshes.textures import mean_color, read_texture
from xray_drake.scene.object_model import TexturedMesh

ALGORITHM = 5
"""Raised with every change of what comes of a file, so that caches renew."""

VISUAL_FACES = 5000
"""Cameras and Meshcat get no more, unless fewer would show."""

VISUAL_SHARE = 0.995
VISUAL_DEVIATION = 0.0005
"""m. This share of the true vertices lies as near to the decimated surface."""

SMALLEST = 0.005
LARGEST = 0.5
"""m. The longest side of the bounding box must lie between these; the bin's
floor is no longer."""

FLATTEST = 1e-6
"""A hull of less volume than this share of the cubed longest side is flat."""

_TEXTURE = "texture_"
"""Before the names of a texture's arrays in the cache."""

_SAMPLES = 30_000
_NEAREST = 6

_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Settings:
    """What the result of an import depends on beside the file.

    Attributes:
        scale: metres per unit of the file.
        max_pieces: convex pieces an object may have.
        max_vertices: vertices a piece may have.
        limits: more pieces are made where few would lose more.
    """

    scale: float
    max_pieces: int
    max_vertices: int
    limits: LossLimits = field(default_factory=LossLimits)


@dataclass(frozen=True, eq=False)
class Prepared:
    """An object of one kg/m³ in its body frame, as arrays.

    The frame's origin is the centre of mass.

    Attributes:
        vertices: (n, 3) of the closed surface that is drawn, m.
        faces: (m, 3) of it.
        pieces: (k, 3) vertices of all convex pieces, m.
        piece_sizes: vertices of each.
        volume: m³.
        inertia: (3, 3) about the centre of mass at a density of 1 kg/m³.
        center: (3,) the centre of mass in the file's frame, m.
        losses: missing, added, volume and silhouette, as in ``Losses``.
        notes: what was repaired or could not be used, short sentences.
        color: (3,) mean colour, or (0,) where the file has none.
        textured: the surface with its texture, where the file has one.
    """

    vertices: np.ndarray
    faces: np.ndarray
    pieces: np.ndarray
    piece_sizes: np.ndarray
    volume: np.ndarray
    inertia: np.ndarray
    center: np.ndarray
    losses: np.ndarray
    notes: np.ndarray
    color: np.ndarray
    textured: TexturedMesh | None

    def arrays(self) -> dict[str, np.ndarray]:
        """Returns all of it by name, the texture's arrays after a prefix."""
        arrays = dict(vars(self))
        textured = arrays.pop("textured")
        if textured is not None:
            for name, value in vars(textured).items():
                arrays[_TEXTURE + name] = value
        return arrays

    @classmethod
    def from_arrays(cls, arrays: dict[str, np.ndarray]) -> "Prepared":
        """Makes it of what :meth:`arrays` returned.

        Raises:
            TypeError: an array is missing, or one too many.
        """
        texture = {
            name.removeprefix(_TEXTURE): arrays[name]
            for name in arrays
            if name.startswith(_TEXTURE)
        }
        rest = {n: a for n, a in arrays.items() if not n.startswith(_TEXTURE)}
        # Caches of before have empty arrays where there is no texture.
        some = len(texture.get("vertices", ())) > 0
        return cls(**rest, textured=TexturedMesh(**texture) if some else None)


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of one file.

    Attributes:
        prepared: the object, or ``None`` if the file cannot be used.
        reason: why not, one line.
        cached: whether it came from the cache.
        kept: whether it is in the cache now.
    """

    prepared: Prepared | None
    reason: str = ""
    cached: bool = False
    kept: bool = True


def read_outcome(
    path: Path, settings: Settings, cache: Path, time_limit: float
) -> Outcome | None:
    """Reads from the cache what became of a file before.

    Args:
        path: of the file.
        settings: of the import.
        cache: folder.
        time_limit: s. That it took longer counts only for a limit that was not
            lower.

    Returns:
        Also that it cannot be read; ``None`` where it is to be prepared.
    """
    try:
        arrays = _read_arrays(cache, _key(path, settings))
    except OSError as error:
        return Outcome(None, f"cannot be read ({error.strerror})")
    except MemoryError:
        return Outcome(None, "cannot be read (too large for the memory)")
    if arrays is None:
        return None
    if set(arrays) == {"reason", "time_limit"}:
        if arrays["time_limit"] < time_limit:
            return None
        return Outcome(None, str(arrays["reason"]), cached=True)
    try:
        return Outcome(Prepared.from_arrays(arrays), cached=True)
    except TypeError:
        return None


def keep_reason(
    path: Path,
    settings: Settings,
    cache: Path,
    reason: str,
    time_limit: float = np.inf,
) -> Outcome:
    """Returns that a file cannot be used, and keeps it in the cache.

    Args:
        path: of the file.
        settings: of the import.
        cache: folder.
        reason: one line.
        time_limit: s, which it took longer than, where that is the reason.
    """
    arrays = {"reason": np.array(reason), "time_limit": np.array(time_limit)}
    try:
        kept = _write_arrays(cache, _key(path, settings), arrays)
    except OSError:  # the file is gone
        kept = False
    return Outcome(None, reason, kept=kept)


def prepare_cached(path: Path, settings: Settings, cache: Path) -> Outcome:
    """Prepares a file and keeps what becomes of it in the cache.

    Raises:
        Exception: geometry libraries throw all kinds.
    """
    try:
        prepared = prepare(path, settings)
    except ValueError as error:
        if is_fault(error):
            raise
        return keep_reason(path, settings, cache, one_line(error))
    key = _key(path, settings)
    return Outcome(prepared, kept=_write_arrays(cache, key, prepared.arrays()))


def _key(path: Path, settings: Settings) -> str:
    """Names what comes of a file by its content and that of its side files."""
    digest = hashlib.sha256(f"{ALGORITHM} {settings}".encode())
    for source in [path, *side_files(path)]:
        content = source.read_bytes()
        digest.update(f"\n{source.suffix} {len(content)}\n".encode())
        digest.update(content)
    return digest.hexdigest()[:40]


def _read_arrays(folder: Path, key: str) -> dict[str, np.ndarray] | None:
    """Reads what was kept: name to array, shaped as it was written.

    ``None`` if it is missing or damaged.
    """
    path = folder / f"{key}.npz"
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except FileNotFoundError:
        return None
    except Exception:
        # Bytes of a damaged file raise anything, zlib's own errors too.
        _logger.debug("damaged cache file %s", path, exc_info=True)
        return None


def _write_arrays(
    folder: Path, key: str, arrays: Mapping[str, np.ndarray]
) -> bool:
    """Keeps arrays under a key; a reader sees all of them or none.

    Returns:
        Whether it could be written.
    """
    content = io.BytesIO()
    np.savez_compressed(content, **dict(arrays))  # type: ignore[arg-type]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_whole_file(folder / f"{key}.npz", content.getvalue())
    except OSError:
        return False
    return True


def read_mesh(path: Path, scale: float) -> FileMesh:
    """Reads a file; the nodes of a scene are put together.

    Args:
        path: OBJ, GLB, PLY, STL or OFF.
        scale: metres per unit of the file.

    Returns:
        What the file says, in metres.

    Raises:
        ValueError: it cannot be used; the message says why in one line.
    """
    file = read_file(path)
    vertices = file.vertices * scale
    used = vertices[np.unique(file.triangles)]
    if len(used) == 0:
        raise ValueError("it has no faces")
    if not np.isfinite(used).all():
        raise ValueError("a vertex is not finite")
    longest = float(np.ptp(used, axis=0).max())
    if not SMALLEST <= longest <= LARGEST:
        raise ValueError(
            f"its longest side is {longest:.4g} m, not {SMALLEST} to "
            f"{LARGEST} m; if it is not in metres, give a scale"
        )
    if hull_volume(used - used.mean(axis=0)) < FLATTEST * longest**3:
        raise ValueError("it is flat")
    if file.visual is not None:
        file.visual.apply_scale(scale)
    return replace(file, vertices=vertices)


def prepare(path: Path, settings: Settings) -> Prepared:
    """Reads, closes, decomposes and measures one mesh file.

    Raises:
        ValueError: it cannot be used; the message says why in one line.
    """
    raw = read_mesh(path, settings.scale)
    closed = closed_solid(raw.vertices, raw.triangles, raw.groups)
    mesh = closed.mesh
    pieces, losses = convex_pieces(
        mesh,
        closed.convex,
        settings.max_pieces,
        settings.max_vertices,
        settings.limits,
    )
    pieces = [without_slivers(piece) for piece in pieces]
    center = np.array(mesh.center_mass)
    mesh.density = 1.0
    shown = _decimated_visual(mesh)
    texture = None if raw.visual is None else read_texture(raw.visual)
    color = raw.color
    notes = [*closed.repairs, *raw.notes]
    if raw.visual is not None and texture is None:
        notes.append("its texture has no finite coordinates")
    if texture is not None:
        color = mean_color(texture)
        moved = (texture.vertices - center).astype(np.float32)
        texture = replace(texture, vertices=moved)
    return Prepared(
        vertices=np.asarray(shown.vertices) - center,
        faces=np.asarray(shown.faces, dtype=np.int32),
        pieces=np.concatenate(pieces) - center,
        piece_sizes=np.array([len(piece) for piece in pieces]),
        volume=np.array(mesh.volume),
        inertia=np.array(mesh.moment_inertia),
        center=center,
        losses=np.array(
            [losses.missing, losses.added, losses.volume, losses.silhouette]
        ),
        notes=np.array(notes, dtype=np.str_),
        color=color,
        textured=texture,
    )


def _decimated_visual(closed: trimesh.Trimesh) -> trimesh.Trimesh:
    faces = VISUAL_FACES
    while faces < len(closed.faces):
        coarse = decimated(closed, faces)
        if coarse.is_volume and deviation(closed, coarse) <= VISUAL_DEVIATION:
            return coarse
        faces *= 2
    return closed


def deviation(fine: trimesh.Trimesh, coarse: trimesh.Trimesh) -> float:
    """Bounds how far 99.5 % of a mesh's vertices lie from a coarser one, m.

    The rest are spikes and folds of scans. Each vertex is compared with the
    triangles of the few samples of the coarser surface that are nearest, so the
    true distance may be less.
    """
    points = np.asarray(fine.vertices)
    samples, owners = trimesh.sample.sample_surface(coarse, _SAMPLES, seed=0)
    samples = np.concatenate([samples, coarse.triangles_center])
    owners = np.concatenate([owners, np.arange(len(coarse.faces))])
    _, near = cKDTree(samples).query(points, k=_NEAREST)
    triangles = coarse.triangles[owners[near.ravel()]]
    repeated = np.repeat(points, _NEAREST, axis=0)
    closest = trimesh.triangles.closest_point(triangles, repeated)
    distances = np.linalg.norm(closest - repeated, axis=1)
    least = distances.reshape(-1, _NEAREST).min(axis=1)
    return float(np.percentile(least, 100 * VISUAL_SHARE))
