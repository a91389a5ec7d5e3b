"""Imports the objects of a folder of mesh files."""

import logging
import multiprocessing
import zlib
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from xray_drake.scene.colors import distractor_color
from xray_drake.scene.meshes.cache import default_cache_dir
from xray_drake.scene.meshes.files import MeshFile, find_meshes, read_masses
from xray_drake.scene.meshes.losses import Losses, LossLimits
from xray_drake.scene.meshes.prepare import (
    Outcome,
    Prepared,
    Settings,
    prepare_cached,
)
from xray_drake.scene.meshes.textures import is_red
from xray_drake.scene.object_model import ObjectModel
from xray_drake.threads import limit_threads

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
    progress: Callable[[float], None] | None = None,
) -> MeshImport:
    """Reads one object per mesh under a folder, in the order of the paths.

    Surfaces are closed where they can be, with one line in the log where that
    changes more than a little, split into a few convex pieces, and
    put with the centre of mass at the body's origin. The groups of an OBJ file
    that are convex are its pieces. Objects without a texture or colours get a
    colour drawn by name; none is red. Files that cannot be used are
    skipped with one line in the log.

    What comes of a file is kept in the cache as soon as it is known, so an
    import that was stopped goes on where it was.

    ``masses.json`` in the folder, where there is one, maps names to kg. A name
    is a file's path in the folder without suffix, the same of its directory,
    or the file's stem.

    Args:
        folder: where to look, also in its subfolders.
        scale: metres per unit of the files.
        density: kg/m³ for what has no mass in ``masses.json``.
        max_pieces: most convex pieces of a collision shape.
        max_vertices: most vertices of each.
        max_loss: what loses more by that is rejected.
        cache_dir: where results are kept; by default in the user's cache.
        workers: processes; a script that asks for several must be guarded by
            ``if __name__ == "__main__"``.
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
    _check(scale, density, max_pieces, max_vertices, workers)
    files = find_meshes(folder)
    masses = read_masses(folder)
    settings = Settings(scale, max_pieces, max_vertices, max_loss)
    cache = default_cache_dir() if cache_dir is None else Path(cache_dir)

    outcomes: dict[int, Outcome] = {}
    for index, outcome in _prepare_all(files, settings, cache, workers):
        outcomes[index] = outcome
        if progress is not None:
            progress(len(outcomes) / len(files))

    models, rejected, losses, notes = [], [], {}, {}
    for index, file in enumerate(files):
        outcome = outcomes[index]
        try:
            if outcome.prepared is None:
                raise ValueError(outcome.reason)
            lost = Losses(*map(float, outcome.prepared.losses))
            max_loss.check(lost)
            mass = next((masses[k] for k in file.keys if k in masses), None)
            model = _model(file.name, outcome.prepared, mass, density)
        except ValueError as error:
            rejected.append((file.path, str(error)))
            _logger.warning("skipped %s: %s", file.path, error)
            continue
        models.append(model)
        losses[model.name] = lost
        if len(outcome.prepared.notes):
            notes[model.name] = "; ".join(map(str, outcome.prepared.notes))
            _logger.warning("%s: %s", file.path, notes[model.name])
    if not all(outcome.kept for outcome in outcomes.values()):
        _logger.warning("cannot write to %s: next time takes as long", cache)
    result = MeshImport(
        models=tuple(models),
        losses=losses,
        notes=notes,
        rejected=tuple(rejected),
        from_cache=sum(outcome.cached for outcome in outcomes.values()),
    )
    if not models:
        path, reason = rejected[0]
        raise ValueError(
            f"none of the {len(files)} mesh files in {folder} can be used; "
            f"{path.name}: {reason}"
        )
    _logger.info("%s: %s", folder, result.summary())
    return result


def _prepare_all(
    files: list[MeshFile], settings: Settings, cache: Path, workers: int
) -> Iterator[tuple[int, Outcome]]:
    """Yields index and outcome of each file, as they are ready."""
    if workers == 1:
        for index, file in enumerate(files):
            yield index, prepare_cached(file.path, settings, cache)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(
        workers, mp_context=context, initializer=limit_threads
    ) as pool:
        futures = {
            pool.submit(prepare_cached, file.path, settings, cache): index
            for index, file in enumerate(files)
        }
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _model(
    name: str, prepared: Prepared, mass: float | None, density: float
) -> ObjectModel:
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
    )


def _check(
    scale: float,
    density: float,
    max_pieces: int,
    max_vertices: int,
    workers: int,
) -> None:
    for name, value in (("scale", scale), ("density", density)):
        if not 0 < value < np.inf:
            raise ValueError(f"{name} must be positive and finite, not {value}")
    for name, count, least in (
        ("max_pieces", max_pieces, 1),
        ("max_vertices", max_vertices, 4),
        ("workers", workers, 1),
    ):
        if count < least:
            raise ValueError(f"{name} must be at least {least}, not {count}")
