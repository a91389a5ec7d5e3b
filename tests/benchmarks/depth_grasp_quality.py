"""Asks whether grasps planned from depth hold.

    python tests/benchmarks/depth_grasp_quality.py --heaps 6 --alone 12

plans a grasp on every object seen, in heaps and for objects alone on the bin's
floor, from depth as rendered and as a sensor gives it, and from the models for
comparison. Each grasp is executed quasi-statically a number of times as
PROTOCOL.md perturbs it, judged on the true shapes and poses. Masks are true.
Prints a table, what each quality is worth, and why grasps fail.
"""

import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import numpy as np
import trimesh
import typer
from rich.console import Console
from rich.progress import track

from xray_drake.dataset.images import LabelledImages
from xray_drake.dataset.pictures import Photographer, Picture
from xray_drake.grasping.depth_planner import DepthGraspPlanner
from xray_drake.grasping.perturbation import PerturbationConfig, perturb
from xray_drake.grasping.planner import ModelGraspPlanner
from xray_drake.messages import Grasp, GraspKind
from xray_drake.perception.depth_noise import DepthNoise
from xray_drake.provenance import current, describe
from xray_drake.scene.heap import Heap
from xray_drake.scene.library import make_object, object_names
from xray_drake.scene.object_model import ObjectModel
from xray_drake.scene.targets import target_model
from xray_drake.seeding import stream
from xray_drake.station.objects import make_heap
from xray_drake.station.scenario import load_scenario, nominal_camera

MIN_PIXELS = 50
"""Objects of which less is seen are not candidates (PROTOCOL.md)."""

BINS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 1.0)
"""Of quality, for its calibration."""

RESTS = 3
"""Resting poses of an object alone."""


@dataclass(frozen=True)
class Trial:
    """One grasp planned.

    Attributes:
        scene: "alone" or "heap".
        source: what it was planned from.
        kind: of the grasp.
        quality: as planned.
        nominal: it holds where it is executed as planned.
        held: share of the perturbed executions that hold.
        reasons: why the others do not.
        seconds: of processor time.
    """

    scene: str
    source: str
    kind: GraspKind
    quality: float
    nominal: bool
    held: float
    reasons: tuple[str, ...]
    seconds: float


def photograph(heap: Heap) -> Picture:
    """Takes the picture of the overhead camera."""
    photographer = Photographer(heap.target, heap.objects, nominal_camera())
    photographer.place(heap)
    return photographer.take()


def noisy(picture: Picture, seed: int) -> np.ndarray:
    """Returns the depth that a sensor would give."""
    nothing = np.zeros(picture.depth.shape, bool)
    depth = np.where(np.isfinite(picture.depth), picture.depth, 0.0)
    images = LabelledImages(
        depth=depth.astype(np.float32),
        modal=nothing,
        amodal=nothing,
        occupancy=nothing.astype(np.float32),
        focal_length=float(picture.camera.intrinsics[0, 0]),
    )
    return DepthNoise()(images, stream(seed, "depth noise")).depth


def laid_down(model: ObjectModel, seed: int) -> Iterator[Heap]:
    """Yields an object alone in the bin, in its likeliest resting poses.

    The target stands in for a heap's and is far away.
    """
    rng = stream(seed, model.name)
    hull = model.visual.convex_hull
    rests, _ = trimesh.poses.compute_stable_poses(
        hull, center_mass=model.p_OCom, threshold=0.0
    )
    target = target_model("box_2to1")
    away = np.eye(4)
    away[2, 3] = -50.0
    for X_rest in rests[:RESTS]:
        X = trimesh.transformations.rotation_matrix(
            rng.uniform(0, 2 * np.pi), [0, 0, 1]
        )
        X[:2, 3] = rng.uniform(-0.1, 0.1, 2)
        X_WO = X @ X_rest
        X_WO[2, 3] -= (model.visual.vertices @ X_WO[2, :3] + X_WO[2, 3]).min()
        yield Heap(
            target=target,
            objects=(model,),
            poses={target.name: away, model.name: X_WO},
            seed=seed,
            num_dropped=1,
            attempts=1,
            settle_time=0.0,
        )


def trials(
    heap: Heap, scene: str, executions: int, seed: int
) -> Iterator[Trial]:
    """Plans and executes grasps on all that is seen of a heap."""
    picture = photograph(heap)
    judge = ModelGraspPlanner(heap.models)
    planner = DepthGraspPlanner()
    images = {"depth": picture.depth, "noisy depth": noisy(picture, seed)}
    for number, name in enumerate([heap.target.name, *picture.names], start=1):
        mask = picture.instances == number
        if np.count_nonzero(mask) < MIN_PIXELS:
            continue
        for source in ("models", *images):
            start = time.process_time()
            if source == "models":
                grasp = judge.plan(name, heap.poses)
            else:
                grasp = planner.plan(name, mask, images[source], picture.camera)
            seconds = time.process_time() - start
            yield execute(
                grasp, judge, heap, executions, scene, source, seconds
            )


def execute(
    grasp: Grasp,
    judge: ModelGraspPlanner,
    heap: Heap,
    executions: int,
    scene: str,
    source: str,
    seconds: float,
) -> Trial:
    """Executes a grasp with and without errors."""
    if not grasp:
        return Trial(scene, source, grasp.kind, 0, False, 0, (), seconds)
    exact = judge.judge(
        grasp, heap.poses, X_WG_perturbed=grasp.X_WG, friction=0.5
    )
    rng = stream(heap.seed, "execution")
    reasons = []
    for _ in range(executions):
        X_WG, friction = perturb(grasp, rng, PerturbationConfig())
        judged = judge.judge(
            grasp, heap.poses, X_WG_perturbed=X_WG, friction=friction
        )
        reasons.append(judged.reason)
    failed = tuple(reason for reason in reasons if reason)
    return Trial(
        scene=scene,
        source=source,
        kind=grasp.kind,
        quality=grasp.quality,
        nominal=exact.quality > 0,
        held=1 - len(failed) / executions,
        reasons=failed,
        seconds=seconds,
    )


def share(values: list[float]) -> str:
    """Returns a mean as per cent."""
    return f"{np.mean(values):.0%}" if values else "–"


def table(done: list[Trial]) -> Iterator[str]:
    """Yields rows of Markdown: how many grasps there are, and hold."""
    yield (
        "| scene | planned from | seen | with a grasp | hold as planned | "
        "hold perturbed | jaw | suction | ms: mean, 95 % |"
    )
    yield "|---|---|---|---|---|---|---|---|---|"
    for scene in ("alone", "heap"):
        for source in ("models", "depth", "noisy depth"):
            all_ = [t for t in done if (t.scene, t.source) == (scene, source)]
            some = [t for t in all_ if t.kind is not GraspKind.NONE]
            if not all_:
                continue
            kinds = []
            for kind in (GraspKind.JAW, GraspKind.SUCTION):
                held = [t.held for t in some if t.kind is kind]
                kinds.append(f"{share(held)} of {len(held)}")
            ms = 1e3 * np.array([t.seconds for t in all_])
            yield (
                f"| {scene} | {source} | {len(all_)} | "
                f"{len(some) / len(all_):.0%} | "
                f"{share([float(t.nominal) for t in some])} | "
                f"{share([t.held for t in some])} | {' | '.join(kinds)} | "
                f"{ms.mean():.0f}, {np.percentile(ms, 95):.0f} |"
            )


def calibration(done: list[Trial]) -> Iterator[str]:
    """Yields rows of Markdown: what share holds at which quality."""
    yield "| quality | models | depth | noisy depth |"
    yield "|---|---|---|---|"
    for low, high in pairwise(BINS):
        cells = []
        for source in ("models", "depth", "noisy depth"):
            held = [
                t.held
                for t in done
                if t.source == source
                and t.kind is not GraspKind.NONE
                and low < t.quality <= high
            ]
            cells.append(f"{share(held)} of {len(held)}")
        yield f"| {low} to {high} | {' | '.join(cells)} |"


def main(
    heaps: Annotated[int, typer.Option(min=0)] = 6,
    alone: Annotated[int, typer.Option(min=0)] = 12,
    executions: Annotated[int, typer.Option(min=1)] = 10,
    first_seed: Annotated[int, typer.Option(min=10_000)] = 10_000,
    scenario: Annotated[str, typer.Option()] = "demo",
) -> None:
    """Tells how many grasps planned from depth hold."""
    console = Console(width=200)
    rng = np.random.default_rng(first_seed)
    names = rng.choice(object_names(), alone, replace=False).tolist()
    done: list[Trial] = []
    for name in track(names, "alone", console=console):
        for heap in laid_down(make_object(name), first_seed):
            done += [
                t
                for t in trials(heap, "alone", executions, first_seed)
                if t is not None
            ]
    chosen = load_scenario(scenario)
    for seed in track(
        range(first_seed, first_seed + heaps), "heaps", console=console
    ):
        heap = make_heap(replace(chosen, seed=seed))
        done += trials(heap, "heap", executions, seed)
    for rows in (table(done), calibration(done)):
        for row in rows:
            console.print(row, highlight=False, soft_wrap=True)
        console.print()
    for source in ("depth", "noisy depth"):
        causes = Counter(
            " ".join(reason.split()[:2])
            for t in done
            if t.source == source
            for reason in t.reasons
        )
        told = ", ".join(f"{why} {n}" for why, n in causes.most_common(8))
        console.print(f"failures, {source}: {told}", highlight=False)
    line = describe(
        [current(scripts=[Path(__file__)])],
        scenario=scenario,
        seeds=range(first_seed, first_seed + max(heaps, 1)),
    )
    console.print(line, highlight=False, soft_wrap=True)


if __name__ == "__main__":
    typer.run(main)
