"""Chooses what lies in the bin of a scenario."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import poisson

from xray_drake.scene.heap import Heap, drop_heap
from xray_drake.scene.library import make_object, object_names
from xray_drake.scene.meshes import load_meshes
from xray_drake.scene.object_model import ObjectModel
from xray_drake.scene.targets import target_model
from xray_drake.seeding import stream
from xray_drake.station.scenario import (
    RandomNumber,
    Scenario,
    ScenarioError,
)


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
    if count <= len(names):
        chosen = rng.choice(len(names), count, replace=False)
        return [get(names[i]) for i in chosen]
    return [
        replace(get(names[i]), name=f"{names[i]}_copy_{k}")
        for k, i in enumerate(rng.integers(len(names), size=count))
    ]


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
                Path(folder), scale=scenario.scene.mesh_scale, workers=workers
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

    Args:
        scenario: says what, how many, and from which seed.
        library: what :func:`imported_objects` gives, if it is known.
        snapshots: how often the heap is remembered: evenly while it grows,
            from half of the objects on, and at the end. See ``Heap.growth``.
        progress: called now and then with the share done, in [0, 1].

    Raises:
        ScenarioError: a folder of meshes that cannot be used.
        HeapError: heap after heap failed.
    """
    objects = choose_objects(scenario, library)
    counts = np.linspace(len(objects) / 2, len(objects), snapshots + 1)[1:]
    return drop_heap(
        target_model(scenario.scene.target),
        objects,
        scenario.seed,
        config=scenario.scene.heap,
        contact=scenario.scene.contact,
        snapshots={int(count) for count in counts[:-1]} - {0},
        plant_config=scenario.plant_config,
        progress=progress,
    )
