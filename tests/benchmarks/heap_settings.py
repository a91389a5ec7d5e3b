"""Compares physics settings by the speed and the quality of heaps.

    python tests/benchmarks/heap_settings.py --heaps 24 --out FOLDER

drops the same heaps under each setting, one process a core, and prints a table.
A line of JSON for each heap is kept in FOLDER; what is there is not dropped
again. ``--settings default,sleep --heaps 200`` compares heaps whose resting
bodies sleep with those whose bodies do not, with Kolmogorov and Smirnov's test.
"""

import gc
import multiprocessing
import os
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.progress import track
from scipy.stats import ks_2samp

from xray_drake.cli.options import Mix
from xray_drake.provenance import Run, current, made_by, open_lines
from xray_drake.threads import usable_cores

FIRST_SEED = 40_000
OBJECTS = 12
BATCH = 40
"""Heaps, after which the processes are replaced."""


@dataclass(frozen=True)
class Setting:
    """What differs from the defaults, and why one might want it."""

    why: str
    contact: dict[str, float] = field(default_factory=dict)
    heap: dict[str, Any] = field(default_factory=dict)
    plant: dict[str, Any] = field(default_factory=dict)


SETTINGS = {
    "default": Setting("what the package uses"),
    "sleep": Setting("resting bodies sleep", heap={"sleep": True}),
    "lively": Setting(
        "dissipation 3 s/m: light flat things hop",
        contact={"dissipation": 3.0},
    ),
    "soft": Setting(
        "2e7 Pa/m: less stiff, sinks deeper",
        contact={"pressure_gradient": 2e7},
    ),
    "hard": Setting(
        "2e8 Pa/m: sinks less, light things hop",
        contact={"pressure_gradient": 2e8},
    ),
    "slow": Setting("one object every 0.28 s", heap={"drop_period": 0.28}),
    "half_step": Setting("steps of 2.5 ms", plant={"time_step": 0.0025}),
}

QUANTITIES = {
    "height": "height of the heap, mm",
    "spread": "spread of the objects' places, mm",
    "visible": "visible share of the target",
}


def drop(name: str, seed: int) -> dict[str, Any]:
    """Drops one heap, in a worker, and measures it."""
    from xray_drake.scene.contact import ContactConfig
    from xray_drake.scene.heap import HeapConfig, HeapError, drop_heap
    from xray_drake.scene.library import make_object, object_names
    from xray_drake.scene.plant import default_plant_config
    from xray_drake.scene.targets import target_model

    setting = SETTINGS[name]
    rng = np.random.default_rng(seed)
    names = rng.choice(object_names(), OBJECTS, replace=False)
    objects = [make_object(str(n)) for n in names]
    plant_config = default_plant_config()
    for key, value in setting.plant.items():
        setattr(plant_config, key, value)
    contact = ContactConfig(**setting.contact)
    record: dict[str, Any] = {"setting": name, "seed": seed}
    start = time.process_time()
    try:
        heap = drop_heap(
            target_model("box_2to1"),
            objects,
            seed,
            config=HeapConfig(**setting.heap, max_attempts=1),
            contact=contact,
            plant_config=plant_config,
        )
    except HeapError as error:
        return {
            **record,
            "cpu": time.process_time() - start,
            "failed": str(error),
        }
    record["cpu"] = time.process_time() - start
    record["settle_time"] = heap.settle_time
    record["outside"] = OBJECTS - len(heap.objects)
    record["tilt"] = float(np.rad2deg(heap.target_tilt))
    places = np.array([heap.poses[m.name][:3, 3] for m in heap.objects])
    tops = [
        float((m.visual.vertices @ X[2, :3]).max() + X[2, 3])
        for m in heap.objects
        for X in [heap.poses[m.name]]
    ]
    record["height"] = 1e3 * max(tops)
    record["spread"] = 1e3 * float(np.sqrt(places[:, :2].var(axis=0).sum()))
    record["visible"] = visible_share(heap)
    record |= awake_motion(heap, contact, plant_config)
    gc.collect()
    return record


def visible_share(heap: Any) -> float:
    """Visible share of the target from the nominal camera."""
    from xray_drake.dataset.pictures import Photographer
    from xray_drake.geometry.silhouette import project_mesh_mask
    from xray_drake.station.scenario import nominal_camera

    camera = nominal_camera()
    photographer = Photographer(heap.target, heap.objects, camera)
    photographer.place(heap)
    photographer.look_from(camera)
    picture = photographer.take()
    amodal = project_mesh_mask(
        heap.target.visual.vertices,
        heap.target.visual.faces,
        heap.poses[heap.target.name],
        picture.camera,
    )
    modal = np.count_nonzero(picture.instances == 1)
    return min(1.0, modal / np.count_nonzero(amodal))


def awake_motion(
    heap: Any, contact: Any, plant_config: Any
) -> dict[str, list[float]]:
    """How deep bodies overlap, and how far they move in a further second."""
    from pydrake.math import RigidTransform
    from pydrake.systems.analysis import Simulator
    from pydrake.systems.framework import DiagramBuilder

    from xray_drake.scene.plant import add_bin, add_objects, add_plant
    from xray_drake.scene.rest import box_corners

    builder = DiagramBuilder()
    plant, _ = add_plant(builder, plant_config)
    add_bin(plant)
    items = add_objects(plant, heap.models, contact=contact, visible=False)
    for item in items:
        item.joint.SetDefaultPose(RigidTransform(heap.poses[item.name]))
    plant.Finalize()
    simulator = Simulator(builder.Build())
    context = plant.GetMyContextFromRoot(simulator.get_context())
    query = plant.get_geometry_query_input_port().Eval(context)
    depths = [1e3 * p.depth for p in query.ComputePointPairPenetration()]

    def corners() -> list[np.ndarray]:
        poses = [item.body.EvalPoseInWorld(context) for item in items]
        return [
            box_corners(item.model, X.GetAsMatrix4())
            for item, X in zip(items, poses, strict=True)
        ]

    before = corners()
    simulator.AdvanceTo(1.0)
    moved = [
        1e3 * float(np.linalg.norm(b - a, axis=-1).max())
        for a, b in zip(before, corners(), strict=True)
    ]
    return {"moved": moved, "depths": depths}


def table(records: list[dict[str, Any]]) -> list[str]:
    """Rows of Markdown."""
    rows = [
        "| setting | heaps | failed | core-s a heap | simulated s | "
        "moved > 1 mm in 1 s | most, mm | overlap, mm: mean, most | "
        "tilted > 5° | fell outside |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name in SETTINGS:
        mine = [r for r in records if r["setting"] == name]
        good = [r for r in mine if "failed" not in r]
        if not good:
            if mine:
                rows.append(f"| {name} | {len(mine)} | {len(mine)} |")
            continue
        moved = np.concatenate([r["moved"] for r in good])
        depths = np.concatenate([r["depths"] for r in good])
        rows.append(
            f"| {name} | {len(mine)} | {len(mine) - len(good)} | "
            f"{np.mean([r['cpu'] for r in mine]):.2f} | "
            f"{np.mean([r['settle_time'] for r in good]):.2f} | "
            f"{np.mean(moved > 1):.1%} | {moved.max():.1f} | "
            f"{depths.mean():.2f}, {depths.max():.1f} | "
            f"{np.mean([r['tilt'] > 5 for r in good]):.1%} | "
            f"{sum(r['outside'] for r in good)} |"
        )
    return rows


def comparison(records: list[dict[str, Any]], a: str, b: str) -> list[str]:
    """Says how two settings' heaps differ."""
    rows = [
        f"| quantity | {a}: mean ± sd | {b}: mean ± sd | KS distance | p |",
        "|---|---|---|---|---|",
    ]
    for key, text in QUANTITIES.items():
        one, other = (
            np.array(
                [r[key] for r in records if r["setting"] == n and key in r]
            )
            for n in (a, b)
        )
        test = ks_2samp(one, other)
        rows.append(
            f"| {text} | {one.mean():.3g} ± {one.std():.3g} | "
            f"{other.mean():.3g} ± {other.std():.3g} | "
            f"{test.statistic:.3f} | {test.pvalue:.2f} |"
        )
    return rows


def main(
    out: Annotated[Path, typer.Option()],
    heaps: Annotated[int, typer.Option(min=1)] = 24,
    settings: Annotated[str, typer.Option()] = ",".join(SETTINGS),
    workers: Annotated[int, typer.Option(min=1)] = usable_cores(),
    mix: Mix = False,
) -> None:
    """Compares physics settings by the speed and the quality of heaps."""
    os.environ["OMP_NUM_THREADS"] = "1"
    out.mkdir(parents=True, exist_ok=True)
    path = out / "heaps.jsonl"
    names = settings.split(",")
    seeds = range(FIRST_SEED, FIRST_SEED + heaps)
    run = Run("heap_settings", current(scripts=[Path(__file__)]), seeds=seeds)
    context = multiprocessing.get_context("spawn")
    with open_lines(path, run, mix=mix) as (records, add):
        done = {(r["setting"], r["seed"]) for r in records}
        jobs = [
            (name, seed)
            for seed in seeds
            for name in names
            if (name, seed) not in done
        ]
        for start in track(range(0, len(jobs), BATCH), "batches"):
            with ProcessPoolExecutor(workers, mp_context=context) as pool:
                batch = jobs[start : start + BATCH]
                futures = [pool.submit(drop, *job) for job in batch]
                for future in as_completed(futures):
                    records.append(future.result())
                    add(records[-1])
    console = Console(width=200)
    for row in table(records):
        console.print(row, highlight=False, soft_wrap=True)
    if "default" in names and "sleep" in names:
        for row in comparison(records, "default", "sleep"):
            console.print(row, highlight=False, soft_wrap=True)
    console.print(made_by(path), highlight=False, soft_wrap=True)


if __name__ == "__main__":
    typer.run(main)
