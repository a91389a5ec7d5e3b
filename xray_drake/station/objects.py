"""Chooses what lies in the bin of a scenario."""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import poisson

from xray_drake.scene.drop import drop_heap, release_heap
from xray_drake.scene.heap import (
    Heap,
    HeapError,
)
from xray_drake.scene.heap_file import (
    AT_REST,
    RESERVED,
    HeapFile,
    load_heap_file,
)
from xray_drake.scene.library import make_object, object_names
from xray_drake.scene.meshes import load_meshes
from xray_drake.scene.object_model import ObjectModel
from xray_drake.scene.packaging import PACKAGED
from xray_drake.scene.targets import make_target, target_name
from xray_drake.seeding import stream
from xray_drake.station.config import RandomNumber
from xray_drake.station.scenario import (
    Scenario,
    ScenarioError,
)
from xray_drake.station.start import look_at_heap
from xray_drake.trees import read_text, read_tree

_logger = logging.getLogger(__name__)

_MOST_REDRAWS = 50
"""So many heaps in a row that show too much of the target are given up."""


def choose_objects(
    scenario: Scenario, library: Mapping[str, ObjectModel] | None = None
) -> list[ObjectModel]:
    """Draws the distractors of a scenario, by its seed.

    Without replacement while the library lasts; then the same object can come
    again under a name of its own.

    Args:
        scenario: says how many, and from what.
        library: what :func:`imported_objects` gives, if it is known.

    Raises:
        ScenarioError: a folder of meshes that cannot be used.
    """
    rng = stream(scenario.seed, "objects")
    scene = scenario.scene
    count = scene.num_objects
    if scene.random_number.mean > 0:
        count = truncated_poisson(scene.random_number, rng)
    if library is None:
        library = imported_objects(scenario)
    names = tuple(library) or object_names(
        split=scene.split, packaged=scene.packaged
    )
    get = library.__getitem__ if library else make_object
    if scene.packaged_share > 0 and not library:
        names = _with_packaged(names, count, scene.packaged_share, rng)
    if count <= len(names):
        chosen = rng.choice(len(names), count, replace=False)
        return [get(names[i]) for i in chosen]
    return [
        replace(get(names[i]), name=f"{names[i]}_copy_{k}")
        for k, i in enumerate(rng.integers(len(names), size=count))
    ]


def _with_packaged(
    names: Sequence[str], count: int, share: float, rng: np.random.Generator
) -> tuple[str, ...]:
    """Draws names of which each is packaged with a probability.

    Fewer where the library has too few of the one or the other.
    """
    packaged = [name for name in names if name.endswith(PACKAGED)]
    plain = [name for name in names if not name.endswith(PACKAGED)]
    wanted = int(rng.binomial(count, share))
    return tuple(
        pool[i]
        for pool, size in ((packaged, wanted), (plain, count - wanted))
        for i in rng.choice(len(pool), min(size, len(pool)), replace=False)
    )


def truncated_poisson(number: RandomNumber, rng: np.random.Generator) -> int:
    """Draws a number of objects."""
    values = np.arange(number.least, number.most + 1)
    weights = poisson.pmf(values, number.mean)
    return int(rng.choice(values, p=weights / weights.sum()))


def imported_objects(
    scenario: Scenario, *, workers: int = 1
) -> dict[str, ObjectModel]:
    """Imports a scenario's folders of meshes; empty where it has none.

    Args:
        scenario: names the folders and their scale.
        workers: processes; decomposition takes seconds a mesh at first.

    Returns:
        Name to object.

    Raises:
        ScenarioError: a folder that cannot be used.
    """
    library: dict[str, ObjectModel] = {}
    for folder in scenario.scene.meshes:
        try:
            models = load_meshes(
                Path(folder),
                scale=scenario.scene.mesh_scale,
                time_limit=scenario.scene.mesh_time_limit,
                workers=workers,
            )
        except ValueError as error:
            raise ScenarioError(str(error)) from error
        for model in models:
            name = model.name
            if name in library:
                name = f"{name}_{len(library)}"
            library[name] = replace(model, name=name)
    return library


def make_heap(
    scenario: Scenario,
    *,
    library: Mapping[str, ObjectModel] | None = None,
    snapshots: int = 1,
    progress: Callable[[float], None] | None = None,
) -> Heap:
    """Drops the heap of a scenario; the same scenario gives the same heap.

    Where the target starts more visible than ``scene.most_visible``, the heap
    is drawn again, objects and all, from a seed that comes of the scenario's:
    the policy has no part in it.

    Args:
        scenario: says what, how many, and from which seed.
        library: what :func:`imported_objects` gives, if it is known.
        snapshots: how often the heap is remembered: evenly while it grows,
            from half of the objects on, and at the end. See ``Heap.growth``.
        progress: called now and then with the share done, in [0, 1].

    Raises:
        ScenarioError: a folder of meshes that cannot be used.
        HeapError: heap after heap failed, or showed too much of the target.
    """
    most_visible = scenario.scene.most_visible
    if scenario.scene.heap_file:
        return _heap_of_file(scenario, progress)
    target = scenario_target(scenario)
    if library is None:
        library = imported_objects(scenario)
    attempts = 0
    failures: tuple[str, ...] = ()
    for redrawn in range(_MOST_REDRAWS + 1):
        drawn = scenario
        if redrawn:
            rng = stream(scenario.seed, "redraw", redrawn)
            drawn = replace(scenario, seed=int(rng.integers(2**62)))
        objects = choose_objects(drawn, library)
        heap = drop_heap(
            target,
            objects,
            drawn.seed,
            bin_=scenario.cell.bin,
            config=scenario.scene.heap,
            contact=scenario.scene.contact,
            snapshots=snapshot_counts(len(objects), snapshots),
            plant_config=scenario.plant_config,
            progress=progress,
        )
        attempts, failures = attempts + heap.attempts, failures + heap.failures
        if (
            most_visible == 1
            or look_at_heap(drawn, heap).target_visible_fraction <= most_visible
        ):
            return replace(
                heap,
                seed=scenario.seed,
                attempts=attempts,
                growth=tuple(
                    replace(state, seed=scenario.seed) for state in heap.growth
                ),
                failures=failures,
                redrawn=redrawn,
            )
    raise HeapError(
        f"seed {scenario.seed}: in {_MOST_REDRAWS + 1} heaps in a row more "
        f"than {most_visible:.0%} of the target was seen: drop more objects, "
        "or raise scene.most_visible"
    )


def _heap_of_file(
    scenario: Scenario, progress: Callable[[float], None] | None
) -> Heap:
    """Lets the objects of a heap file come to rest.

    Raises:
        ScenarioError: the file cannot be used, or does not fit the cell.
        HeapError: the heap does not come to rest.
    """
    scene, file = scenario.scene, _heap_file(scenario)
    if file.release == AT_REST:
        return file.heap()
    heap = release_heap(
        file.target,
        file.objects,
        file.poses,
        release=file.release,
        order=file.order,
        bin_=scenario.cell.bin,
        config=scene.heap,
        contact=scene.contact,
        plant_config=scenario.plant_config,
        progress=progress,
    )
    lost = sorted(set(file.order) - set(heap.poses))
    if lost:
        _logger.warning(
            "%s: fell out of the bin: %s", scene.heap_file, ", ".join(lost)
        )
    return heap


def check_heaps(scenario: Scenario) -> None:
    """Checks what a scenario's heaps are made of, before one is dropped.

    Raises:
        ScenarioError: the target or the heap file cannot be used.
    """
    if scenario.scene.heap_file:
        _heap_file(scenario)
    else:
        scenario_target(scenario)


def _heap_file(scenario: Scenario) -> HeapFile:
    """Reads a scenario's heap file, and checks that it fits the scenario."""
    scene = scenario.scene
    file = load_heap_file(
        Path(scene.heap_file), time_limit=scene.mesh_time_limit
    )
    file.check_fits(scenario.cell.bin)
    check_target(scenario, file.target)
    return file


def name_of_target(scenario: Scenario) -> str:
    """Returns what the target of a scenario's heaps is called.

    Raises:
        ScenarioError: a heap file that cannot be read.
    """
    scene = scenario.scene
    if scene.heap_file:
        path = Path(scene.heap_file)
        return str(read_tree(read_text(path), str(path)).get("target", ""))
    return target_name(scene.target)


def scenario_target(scenario: Scenario) -> ObjectModel:
    """Returns the target of a scenario.

    Raises:
        ScenarioError: it cannot be made, does not fit into the bin, or is
            nothing that the scenario's inference can look for.
    """
    scene = scenario.scene
    try:
        target = make_target(
            scene.target,
            scale=scene.target_scale,
            mass=scene.target_mass,
            color=tuple(scene.target_color),
        )
    except ValueError as error:
        raise ScenarioError(str(error)) from error
    check_target(scenario, target)
    return target


def check_target(scenario: Scenario, target: ObjectModel) -> None:
    """Checks that a target fits into a scenario's bin, and its inference.

    Raises:
        ScenarioError: it does not.
    """
    if target.name in RESERVED:
        raise ScenarioError(
            f"the target is called {target.name!r}, as a part of the cell is: "
            "give its file another name"
        )
    length, width = np.sort(target.extents[:2])[::-1]
    bin_ = scenario.cell.bin
    room = np.sort([bin_.length, bin_.width])[::-1]
    if length > room[0] or width > room[1]:
        raise ScenarioError(
            f"the target {target.name} is {1e3 * length:.0f} × "
            f"{1e3 * width:.0f} mm, and the bin {1e3 * room[0]:.0f} × "
            f"{1e3 * room[1]:.0f} mm: is scene.target_scale right?"
        )
    flat_only = scenario.perception.occupancy == "geometric_label"
    if flat_only and not target.is_flat:
        raise ScenarioError(
            f"the target {target.name} need not lie flat, and "
            "perception.occupancy: geometric_label takes it to: choose "
            "geometric"
        )


def snapshot_counts(num_objects: int, snapshots: int) -> tuple[int, ...]:
    """Returns how many objects lie in the bin when a heap is remembered.

    Evenly from half of them on; the last time, when all are at rest, is left
    out.

    Args:
        num_objects: of the whole heap.
        snapshots: how often it is remembered.

    Raises:
        ValueError: there are too few objects for so many.
    """
    counts = np.linspace(num_objects / 2, num_objects, snapshots + 1)[1:-1]
    numbers = tuple(int(count) for count in counts)
    if numbers and len({0, *numbers, num_objects}) < snapshots + 1:
        raise ValueError(
            f"a heap of {num_objects} objects has no {snapshots} different "
            "snapshots: take more objects, or fewer snapshots"
        )
    return numbers
