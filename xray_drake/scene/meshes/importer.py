"""Imports the objects of a folder of mesh files."""

import logging
import multiprocessing
import signal
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from xray_drake.caches import cache_folder
from xray_drake.choices import MESH_TIME_LIMIT
from xray_drake.processes import Lost, run_jobs
from xray_drake.scene.colors import distractor_color
from xray_drake.scene.meshes.files import (
    MASSES_FILE,
    MeshFile,
    find_meshes,
    masses_of,
    printable,
    problem_of,
    read_masses,
)
from xray_drake.scene.meshes.formats import FORMATS
from xray_drake.scene.meshes.losses import Losses, LossLimits
from xray_drake.scene.meshes.prepare import (
    Outcome,
    Prepared,
    Settings,
    keep_reason,
    prepare_cached,
    read_outcome,
)
from xray_drake.scene.meshes.textures import is_red
from xray_drake.scene.object_model import ObjectModel, Origin

DEFAULT_DENSITY = 300.0
"""kg/m³ of the closed surface's inside, where the folder gives no mass."""

LIGHTEST = 0.0005
"""kg. Lighter bodies do not survive contact with the others."""

MAX_PIECES = 32
MAX_VERTICES = 12
"""Of an object's collision shape; it has eight pieces at most where they lose
no more than is allowed, since contact costs follow them."""

DEFAULT_LIMITS = LossLimits()

_logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class MeshImport:
    """What became of a folder.

    Attributes:
        models: the objects, in the order of the paths.
        losses: what their collision shapes lose, by name.
        notes: what was repaired or not used of a file, by the object's name,
            where there is any.
        rejected: path and reason, one line, of each file that is not used.
        from_cache: how many files had been prepared before.
    """

    models: tuple[ObjectModel, ...]
    losses: dict[str, Losses]
    notes: dict[str, str]
    rejected: tuple[tuple[Path, str], ...]
    from_cache: int

    def summary(self) -> str:
        """Returns one line on how many were imported and what they lose."""
        text = f"{len(self.models)} objects imported"
        if self.notes:
            text += f", {len(self.notes)} of them with a remark"
        if self.rejected:
            text += f", {len(self.rejected)} files rejected"
        if self.losses:
            volume = np.median([abs(x.volume) for x in self.losses.values()])
            worst = max(x.silhouette for x in self.losses.values())
            text += (
                f"; collision shapes differ by {volume:.0%} in volume "
                f"(median), at worst by {worst:.0%} in silhouette"
            )
        return text


def load_meshes(folder: Path, **options: Any) -> list[ObjectModel]:
    """Reads the objects of a folder; see :func:`import_meshes`."""
    return list(import_meshes(folder, **options).models)


def import_meshes(
    folder: Path,
    *,
    scale: float = 1.0,
    density: float = DEFAULT_DENSITY,
    max_pieces: int = MAX_PIECES,
    max_vertices: int = MAX_VERTICES,
    max_loss: LossLimits = DEFAULT_LIMITS,
    cache_dir: Path | None = None,
    workers: int = 1,
    time_limit: float = MESH_TIME_LIMIT,
    progress: Callable[[float], None] | None = None,
) -> MeshImport:
    """Reads one object per mesh under a folder, in the order of the paths.

    Surfaces are closed where they can be, with one line in the log where that
    changes more than a little, split into a few convex pieces, and
    put with the centre of mass at the body's origin. The groups of an OBJ file
    that are convex are its pieces. Objects without a texture or colours get a
    colour drawn by name; none is red. Files that cannot be used are
    skipped with one line in the log; each is prepared in a process of its own,
    which may crash, or take too long, alone.

    What comes of a file is kept in the cache as soon as it is known, so an
    import that was stopped goes on where it was.

    ``masses.json`` in the folder, where there is one, maps names to kg. A name
    is a file's path in the folder without suffix, the same of its directory,
    or the file's stem; the file's suffix may follow. Names that belong to no
    file are told in one line of the log.

    Args:
        folder: where to look, also in its subfolders.
        scale: metres per unit of the files.
        density: kg/m³ for what has no mass in ``masses.json``.
        max_pieces: most convex pieces of a collision shape.
        max_vertices: most vertices of each.
        max_loss: what loses more by that is rejected.
        cache_dir: where results are kept; by default in the user's cache.
        workers: processes at a time.
        time_limit: s; a file that takes longer to prepare is skipped.
        progress: called after each file with the share done, in [0, 1].

    Returns:
        Objects called ``folder/path`` without suffix; a file called
        ``textured`` or the like by its directory, as in ``toys/duck``.

    Raises:
        ValueError: the folder does not exist, its ``masses.json`` is not a map
            from names to positive numbers, no file can be used, or an option
            makes no sense.
    """
    folder = Path(folder)
    _check(
        {"scale": scale, "density": density, "time_limit": time_limit},
        {
            "max_pieces": max_pieces,
            "max_vertices": max_vertices,
            "workers": workers,
        },
    )
    files = find_meshes(folder)
    masses = _masses(folder, files)
    settings = Settings(scale, max_pieces, max_vertices, max_loss)
    cache = cache_folder() / "meshes" if cache_dir is None else Path(cache_dir)

    outcomes: dict[int, Outcome] = {}
    prepared = _prepare_all(files, settings, cache, workers, time_limit)
    for index, outcome in prepared:
        outcomes[index] = outcome
        if progress is not None:
            progress(len(outcomes) / len(files))

    if not all(outcome.kept for outcome in outcomes.values()):
        _logger.warning("cannot write to %s: next time takes as long", cache)
    result = _collected(
        folder, files, outcomes, masses, density, max_loss, scale
    )
    _logger.info("%s: %s", folder, result.summary())
    return result


def import_mesh(
    path: Path,
    name: str,
    *,
    scale: float = 1.0,
    density: float = DEFAULT_DENSITY,
    mass: float | None = None,
    time_limit: float = MESH_TIME_LIMIT,
) -> ObjectModel:
    """Reads one object from a file; see :func:`import_meshes`.

    Args:
        path: of the file.
        name: of the object.
        scale: metres per unit of the file.
        density: kg/m³, where there is no mass.
        mass: kg.
        time_limit: s that preparing it may take.

    Raises:
        ValueError: it cannot be used; the message names the file.
    """
    _check({"scale": scale, "density": density, "time_limit": time_limit}, {})
    if path.suffix.lower() not in FORMATS:
        raise ValueError(
            f"{path} is no mesh: those are {', '.join(FORMATS)} files"
        )
    file = MeshFile(path, name, (), problem_of(path))
    settings = Settings(scale, MAX_PIECES, MAX_VERTICES, DEFAULT_LIMITS)
    cache = cache_folder() / "meshes"
    ((_, outcome),) = _prepare_all([file], settings, cache, 1, time_limit)
    try:
        if outcome.prepared is None:
            raise ValueError(outcome.reason)
        DEFAULT_LIMITS.check(Losses(*map(float, outcome.prepared.losses)))
        return _model(file, outcome.prepared, mass, density, scale)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _masses(folder: Path, files: list[MeshFile]) -> list[float | None]:
    """Reads the masses, and logs the names that belong to no file."""
    masses, idle = masses_of(files, read_masses(folder))
    if idle:
        _logger.warning(
            "%s: no mesh is called %s", folder / MASSES_FILE, _some(idle)
        )
    return masses


def _collected(
    folder: Path,
    files: list[MeshFile],
    outcomes: dict[int, Outcome],
    masses: list[float | None],
    density: float,
    max_loss: LossLimits,
    scale: float,
) -> MeshImport:
    """Makes the objects, and logs what is rejected or was repaired.

    Raises:
        ValueError: no file can be used.
    """
    models, rejected, losses, notes = [], [], {}, {}
    for index, file in enumerate(files):
        outcome = outcomes[index]
        try:
            if outcome.prepared is None:
                raise ValueError(outcome.reason)
            lost = Losses(*map(float, outcome.prepared.losses))
            max_loss.check(lost)
            model = _model(
                file, outcome.prepared, masses[index], density, scale
            )
        except ValueError as error:
            rejected.append((file.path, str(error)))
            _logger.warning("skipped %s: %s", printable(str(file.path)), error)
            continue
        models.append(model)
        losses[model.name] = lost
        if len(outcome.prepared.notes):
            notes[model.name] = "; ".join(map(str, outcome.prepared.notes))
            _logger.warning("%s: %s", file.path, notes[model.name])
    if not models:
        path, reason = rejected[0]
        raise ValueError(
            f"none of the {len(files)} mesh files in {folder} can be used; "
            f"{printable(path.name)}: {reason}"
        )
    return MeshImport(
        models=tuple(models),
        losses=losses,
        notes=notes,
        rejected=tuple(rejected),
        from_cache=sum(outcome.cached for outcome in outcomes.values()),
    )


def _prepare_all(
    files: list[MeshFile],
    settings: Settings,
    cache: Path,
    workers: int,
    time_limit: float,
) -> Iterator[tuple[int, Outcome]]:
    """Yields index and outcome of each file, as they are ready."""
    missing = []
    for index, file in enumerate(files):
        known: Outcome | None = Outcome(None, file.problem)
        if not file.problem:
            known = read_outcome(file.path, settings, cache, time_limit)
        if known is None:
            missing.append(index)
        else:
            yield index, known
    paths = [file.path for file in files]

    def lost(lost: Lost[int]) -> Outcome:
        path = paths[lost.job]
        if lost.cause == "failed":
            _logger.debug("%s\n%s", path, lost.traceback)
            return Outcome(None, f"cannot be decomposed ({lost.reason[:200]})")
        if lost.cause == "overran":
            reason = f"preparing it takes longer than {time_limit:g} s"
            return keep_reason(path, settings, cache, reason, time_limit)
        # Memory that ran out may suffice another time.
        if lost.status == -signal.SIGKILL:
            return Outcome(None, lost.reason)
        return keep_reason(path, settings, cache, lost.reason)

    yield from run_jobs(
        partial(_prepare, paths, settings, cache),
        missing,
        workers=workers,
        preload=["xray_drake.scene.meshes.prepare"],
        lost=lost,
        limit=time_limit,
    )


def _prepare(
    paths: list[Path],
    settings: Settings,
    cache: Path,
    index: int,
) -> Outcome:
    """Prepares one file, in a process of its own if that may be."""
    if not multiprocessing.current_process().daemon:
        with suppress(OSError):
            # Where memory runs out, Linux ends this process and not another.
            score = Path("/proc/self/oom_score_adj")
            score.write_text("1000", encoding="utf-8")
    return prepare_cached(paths[index], settings, cache)


def _some(names: list[str], most: int = 5) -> str:
    """Names the first of many."""
    text = ", ".join(map(repr, names[:most]))
    more = len(names) - most
    return f"{text} and {more} more" if more > 0 else text


def _model(
    file: MeshFile,
    prepared: Prepared,
    mass: float | None,
    density: float,
    scale: float,
) -> ObjectModel:
    name, X_FO = file.name, np.eye(4)
    X_FO[:3, 3] = prepared.center
    volume = float(prepared.volume)
    if mass is None:
        mass = density * volume
    if mass < LIGHTEST:
        raise ValueError(
            f"it weighs only {mass * 1e6:.3g} mg (at least "
            f"{LIGHTEST * 1e6:.3g} mg)"
        )
    color = distractor_color(np.random.default_rng(zlib.crc32(name.encode())))
    if len(prepared.color) and not is_red(prepared.color):
        red, green, blue = map(float, prepared.color)
        color = (red, green, blue, 1.0)
    return ObjectModel(
        name=name,
        visual=trimesh.Trimesh(
            prepared.vertices, prepared.faces, process=False
        ),
        pieces=tuple(
            np.split(prepared.pieces, np.cumsum(prepared.piece_sizes)[:-1])
        ),
        mass=mass,
        p_OCom=np.zeros(3),
        inertia=prepared.inertia * (mass / volume),
        color=color,
        textured=prepared.textured,
        origin=Origin(str(file.path.absolute()), scale, X_FO),
    )


def _check(positive: dict[str, float], counts: dict[str, int]) -> None:
    for name, value in positive.items():
        if not 0 < value < np.inf:
            raise ValueError(f"{name} must be positive and finite, not {value}")
    for name, count in counts.items():
        least = 4 if name == "max_vertices" else 1
        if count < least:
            raise ValueError(f"{name} must be at least {least}, not {count}")
