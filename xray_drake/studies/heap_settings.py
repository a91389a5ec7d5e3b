"""Physics settings compared by the speed and the quality of heaps.

The same heaps of 12 objects are dropped under each setting; then all bodies may
move for a further second. Heaps whose resting bodies sleep are compared with
those whose bodies do not by the test of Kolmogorov and Smirnov.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from scipy.stats import ks_2samp

from xray_drake.cell.bin import Bin
from xray_drake.scene.contact import ContactConfig
from xray_drake.scene.drop import drop_heap
from xray_drake.scene.heap import (
    Heap,
    HeapConfig,
    HeapError,
)
from xray_drake.scene.library import make_object, object_names
from xray_drake.scene.plant import (
    add_bin,
    add_objects,
    add_plant,
    default_plant_config,
)
from xray_drake.scene.rest import box_corners
from xray_drake.scene.targets import target_model
from xray_drake.station.scenario import Scenario
from xray_drake.station.start import look_at_heap
from xray_drake.studies.study import Line, Study, Table

FIRST_SEED = 40_000
OBJECTS = 12


SETTINGS: dict[str, tuple[HeapConfig, ContactConfig]] = {
    "default": (HeapConfig(), ContactConfig()),
    # Resting bodies sleep.
    "sleep": (HeapConfig(sleep=True), ContactConfig()),
    # s/m: light flat things hop.
    "lively": (HeapConfig(), ContactConfig(dissipation=3.0)),
    # Pa/m: bodies sink deeper, or light things hop.
    "soft": (HeapConfig(), ContactConfig(pressure_gradient=2e7)),
    "hard": (HeapConfig(), ContactConfig(pressure_gradient=2e8)),
}


def heap_settings(settings: str, heaps: int) -> Study:
    """Returns the comparison of physics settings.

    Args:
        settings: names of :data:`SETTINGS` with commas between; none for all.
        heaps: of each.

    Raises:
        ValueError: there is no such setting.
    """
    names = settings.split(",") if settings else list(SETTINGS)
    for name in names:
        if name not in SETTINGS:
            raise ValueError(
                f"no setting is called {name!r}: there are "
                f"{', '.join(SETTINGS)}"
            )
    seeds = range(FIRST_SEED, FIRST_SEED + heaps)
    return Study(
        "heap_settings",
        [{"setting": n, "seed": seed} for seed in seeds for n in names],
        measure_heap,
        heap_tables,
        seeds=seeds,
    )


def measure_heap(item: Line) -> Line:
    """Drops the heap of a seed under a setting and measures it."""
    (config, contact), seed = SETTINGS[item["setting"]], item["seed"]
    names = np.random.default_rng(seed).choice(
        object_names(), OBJECTS, replace=False
    )
    start = time.process_time()
    try:
        heap = drop_heap(
            target_model("box_2to1"),
            [make_object(str(name)) for name in names],
            seed,
            config=replace(config, max_attempts=1),
            contact=contact,
        )
    except HeapError as error:
        return {"cpu": time.process_time() - start, "failed": str(error)}
    cpu = time.process_time() - start
    poses = [(model, heap.poses[model.name]) for model in heap.objects]
    tops = [
        float((m.visual.vertices @ X[2, :3]).max() + X[2, 3]) for m, X in poses
    ]
    places = np.array([X[:2, 3] for _, X in poses])
    return {
        "cpu": cpu,
        "settle_time": heap.settle_time,
        "outside": OBJECTS - len(heap.objects),
        "tilt": float(np.rad2deg(heap.target_tilt)),
        "height": 1e3 * max(tops),
        "spread": 1e3 * float(np.sqrt(places.var(axis=0).sum())),
        "visible": look_at_heap(Scenario(), heap).target_visible_fraction,
        **_motion(heap, contact),
    }


def _motion(heap: Heap, contact: ContactConfig) -> dict[str, list[float]]:
    """Returns how deep bodies overlap and how far they move in 1 s, mm."""
    builder = DiagramBuilder()
    plant, _ = add_plant(builder, default_plant_config())
    add_bin(plant, Bin())
    items = add_objects(plant, heap.models, contact=contact, visible=False)
    for item in items:
        item.joint.SetDefaultPose(RigidTransform(heap.poses[item.name]))
    plant.Finalize()
    simulator = Simulator(builder.Build())
    context = plant.GetMyContextFromRoot(simulator.get_context())
    query = plant.get_geometry_query_input_port().Eval(context)
    depths = [1e3 * p.depth for p in query.ComputePointPairPenetration()]

    def corners() -> list[np.ndarray]:
        return [
            box_corners(
                item.model, item.body.EvalPoseInWorld(context).GetAsMatrix4()
            )
            for item in items
        ]

    before = corners()
    simulator.AdvanceTo(1.0)
    moved = [
        1e3 * float(np.linalg.norm(b - a, axis=-1).max())
        for a, b in zip(before, corners(), strict=True)
    ]
    return {"moved": moved, "depths": depths}


def heap_tables(lines: list[Line]) -> Mapping[str, Table]:
    """Returns a row for each setting, and the test of those with sleep."""
    rows, good = [], {}
    for name in SETTINGS:
        mine = [line for line in lines if line["setting"] == name]
        good[name] = [line for line in mine if "failed" not in line]
        if not good[name]:
            continue
        moved, depths = (
            np.concatenate([line[key] for line in good[name]])
            for key in ("moved", "depths")
        )
        settled, tilted, outside = (
            np.array([line[key] for line in good[name]])
            for key in ("settle_time", "tilt", "outside")
        )
        rows.append(
            {
                "setting": name,
                "heaps": len(mine),
                "failed": len(mine) - len(good[name]),
                "core-s a heap": np.mean([line["cpu"] for line in mine]),
                "simulated s": settled.mean(),
                "moved > 1 mm in 1 s": np.mean(moved > 1),
                "most, mm": moved.max(),
                "mean overlap, mm": depths.mean(),
                "most overlap, mm": depths.max(),
                "tilted > 5 deg": np.mean(tilted > 5),
                "fell outside": outside.sum(),
            }
        )
    tables = {"heap_settings": rows}
    if good["default"] and good["sleep"]:
        tables["heap_settings_sleep"] = [
            _compared(key, good["default"], good["sleep"])
            for key in ("height", "spread", "visible")
        ]
    return tables


def _compared(
    key: str, lines: Sequence[Line], others: Sequence[Line]
) -> dict[str, Any]:
    one, other = (np.array([r[key] for r in rs]) for rs in (lines, others))
    test = ks_2samp(one, other)
    return {
        "quantity": key if key == "visible" else f"{key}, mm",
        "default": one.mean(),
        "default, sd": one.std(),
        "sleep": other.mean(),
        "sleep, sd": other.std(),
        "KS distance": test.statistic,
        "p": test.pvalue,
    }
