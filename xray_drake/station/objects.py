"""Chooses what lies in the bin of a scenario."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from xray_drake.scene.heap import Heap, drop_heap
from xray_drake.scene.library import make_object, object_names
from xray_drake.scene.meshes import load_meshes
from xray_drake.scene.object_model import ObjectModel
from xray_drake.scene.targets import target_model
from xray_drake.seeding import stream
from xray_drake.station.scenario import Scenario, ScenarioError


def choose_objects(scenario: Scenario) -> list[ObjectModel]:
    """Draws the distractors of a scenario, by its seed.

    Without replacement while the library lasts; then the same object can come
    again under a name of its own.

    Raises:
        ScenarioError: a folder of meshes that cannot be used.
    """
    count = scenario.scene.num_objects
    rng = stream(scenario.seed, "objects")
    library: dict[str, ObjectModel] = {}
    for folder in scenario.scene.meshes:
        try:
            models = load_meshes(Path(folder))
        except ValueError as error:
            raise ScenarioError(str(error)) from error
        for model in models:
            name = model.name
            if name in library:
                name = f"{name}_{len(library)}"
            library[name] = replace(model, name=name)
    names = tuple(library) or object_names()
    get = library.__getitem__ if library else make_object
    if count <= len(names):
        chosen = rng.choice(len(names), count, replace=False)
        return [get(names[i]) for i in chosen]
    return [
        replace(get(names[i]), name=f"{names[i]}_copy_{k}")
        for k, i in enumerate(rng.integers(len(names), size=count))
    ]


def make_heap(
    scenario: Scenario, *, progress: Callable[[float], None] | None = None
) -> Heap:
    """Drops the heap of a scenario; the same scenario gives the same heap.

    Args:
        scenario: says what, how many, and from which seed.
        progress: called now and then with the share done, in [0, 1].

    Raises:
        ScenarioError: a folder of meshes that cannot be used.
        HeapError: heap after heap failed.
    """
    return drop_heap(
        target_model(scenario.scene.target),
        choose_objects(scenario),
        scenario.seed,
        config=scenario.scene.heap,
        plant_config=scenario.plant_config,
        progress=progress,
    )
