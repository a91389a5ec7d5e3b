"""Compares exact inference of tall targets: taken for flat, and resting.

    python tests/benchmarks/tall_targets.py --heaps 15 --out FOLDER

drops heaps of packaged objects over each tall target, lying on any face, and
prints for both inferences, over all heaps and over those that show at most 90 %
of the target: in how many heaps the support holds 95 % of the target's true
amodal mask, how it agrees with the paper's label (candidates on a grid of 8
pixels through the true pose, IoU above 0.9 with the true modal mask) summed
over all resting poses by probability, and the time of a core. A line of JSON
for each heap, and its images, are kept in FOLDER; what is there is not dropped
again. ``--pictures 3`` draws that many of each target.
"""

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from xray_drake.cli.options import Mix
from xray_drake.provenance import Run, current, made_by, open_lines

FIRST_SEED = 50_000
HELD = 0.95


def photograph(target: str, seed: int, objects: int, file: Path) -> None:
    """Drops a heap and keeps what the camera sees of it."""
    from xray_drake.dataset.pictures import Photographer
    from xray_drake.geometry.resting import resting_poses
    from xray_drake.geometry.silhouette import project_mesh_mask
    from xray_drake.station.objects import make_heap
    from xray_drake.station.scenario import Scenario

    scenario = Scenario(seed=seed)
    scenario.scene.target = target
    scenario.scene.num_objects = objects
    # On backing cards and close together, so that few cover a tall target.
    scenario.scene.packaged = True
    scenario.scene.packaged_share = 1.0
    scenario.scene.heap.offset_sigma = 0.03
    heap = make_heap(scenario)
    photographer = Photographer(
        heap.target, heap.objects, scenario.camera, color=True
    )
    photographer.place(heap)
    picture = photographer.take()
    amodal = project_mesh_mask(
        heap.target.visual.vertices,
        heap.target.visual.faces,
        heap.poses[heap.target.name],
        picture.camera,
    )
    alone = Photographer(heap.target, (), scenario.camera, bin_visible=False)
    X_WT = heap.poses[heap.target.name]
    poses = resting_poses(heap.target.visual, heap.target.p_OCom)
    aligned = [float((pose.downs @ -X_WT[2, :3]).max()) for pose in poses]
    placements = []
    for k, pose in enumerate(poses):
        X = np.array(X_WT)
        if k != int(np.argmax(aligned)):
            # Where its centre of mass is, on another of its faces.
            X[:3, :3] = pose.R_WO
            lowest = (heap.target.visual.vertices @ pose.R_WO.T)[:, 2].min()
            center = X_WT[:3, :3] @ heap.target.p_OCom + X_WT[:3, 3]
            X[:3, 3] = center - pose.R_WO @ heap.target.p_OCom
            X[2, 3] = -lowest
        placements.append(X)
    views = []
    for X in placements:
        alone.place(replace(heap, objects=(), poses={heap.target.name: X}))
        views.append(alone.depth())
    np.savez_compressed(
        file,
        depth=picture.depth,
        without=picture.depth_without_target,
        modal=picture.instances == 1,
        amodal=amodal,
        color=picture.color,
        lean=heap.target_tilt,
        placements=np.array(placements),
        views=np.array(views),
        probabilities=[pose.probability for pose in poses],
        true=int(np.argmax(aligned)),
    )


def compare(target: str, images: dict[str, np.ndarray]) -> dict[str, Any]:
    """Infers one image in both ways."""
    from xray_drake.occupancy.geometric.config import POSES
    from xray_drake.occupancy.metrics import pixel_counts

    camera, amodal = _camera(), images["amodal"]
    truth = label(images)
    line: dict[str, Any] = {
        "lean_deg": float(np.rad2deg(images["lean"])),
        "visible": float(images["modal"].sum() / amodal.sum()),
        "pose": int(images["true"]),
    }
    for poses in POSES:
        model = _model(target, poses)
        start = time.process_time()
        found = model.infer(images["depth"], images["modal"], camera)
        line[poses] = {
            "seconds": time.process_time() - start,
            "held": float((found.support() & amodal).sum() / amodal.sum()),
            "support": found.support_size(),
            "iou": pixel_counts(truth, found.data).iou,
        }
    return line


def label(images: dict[str, np.ndarray]) -> np.ndarray:
    """Sums the paper's label over all resting poses, by probability."""
    from xray_drake.occupancy.label.ground_truth import occupancy_label

    total = np.zeros(images["depth"].shape)
    for k, share in enumerate(images["probabilities"]):
        one = occupancy_label(
            images["views"][k],
            images["without"],
            _camera(),
            images["placements"][k][:3, 3],
            observed=images["modal"],
            true_pose=k == images["true"],
        )
        total += share * one.largest * one.distribution
    return (total / max(total.max(), 1e-12)).astype(np.float32)


_MODELS: dict[tuple[str, str], Any] = {}


def _model(target: str, poses: str) -> Any:
    from xray_drake.occupancy.geometric.config import ExactInferenceConfig
    from xray_drake.occupancy.geometric.inference import exact_model
    from xray_drake.scene.targets import target_model

    key = target, poses
    if key not in _MODELS:
        _MODELS[key] = exact_model(
            target_model(target), ExactInferenceConfig(poses)
        )
        # The first image compiles, or loads what is compiled.
        depth = _camera().plane_depth(0.0).astype(np.float32)
        for seen in (False, True):
            mask = np.zeros(depth.shape, dtype=bool)
            mask[180:210, 240:270] = seen
            _MODELS[key].infer(depth - np.float32(0.1), mask, _camera())
    return _MODELS[key]


def _camera() -> Any:
    from xray_drake.scene.cameras import pinhole_camera
    from xray_drake.station.scenario import nominal_camera

    return pinhole_camera(nominal_camera())


def draw(target: str, images: dict[str, np.ndarray], file: Path) -> None:
    """Draws a heap and both distributions, the true mask outlined."""
    import cv2

    color = images["color"][..., ::-1]
    panels = [color.copy()]
    for poses in ("flat", "resting"):
        found = _model(target, poses).infer(
            images["depth"], images["modal"], _camera()
        )
        heat = cv2.applyColorMap(
            (found.data * 255).astype(np.uint8), cv2.COLORMAP_INFERNO
        )
        panels.append(np.where(found.support()[..., None], heat, color // 2))
    outline, _ = cv2.findContours(
        images["amodal"].astype(np.uint8),
        cv2.RETR_EXTERNAL,
        cv2.CHAIN_APPROX_NONE,
    )
    for k, panel in enumerate(panels):
        panels[k] = np.ascontiguousarray(panel)
        cv2.drawContours(panels[k], outline, -1, (0, 255, 0), 1)
    cv2.imwrite(str(file), np.hstack(panels))


def main(
    out: Annotated[Path, typer.Option(help="folder of lines and images")],
    heaps: Annotated[int, typer.Option(help="of each target")] = 15,
    objects: Annotated[int, typer.Option(help="in a heap")] = 6,
    pictures: Annotated[int, typer.Option(help="drawn of each target")] = 0,
    mix: Mix = False,
) -> None:
    """Drops what is missing and prints the table."""
    from xray_drake.choices import TALL_TARGETS

    out.mkdir(parents=True, exist_ok=True)
    seeds = range(FIRST_SEED, FIRST_SEED + heaps)
    run = Run(
        "tall_targets",
        current(scripts=[Path(__file__)]),
        seeds=seeds,
        settings={"objects": objects},
    )
    with open_lines(out / "results.jsonl", run, mix=mix) as (lines, add):
        done = {(line["target"], line["seed"]) for line in lines}
        for seed in seeds:
            for target in TALL_TARGETS:
                file = out / f"{target}_{seed}.npz"
                if not file.is_file():
                    photograph(target, seed, objects, file)
                images = dict(np.load(file))
                if (target, seed) not in done:
                    line = {"target": target, "seed": seed}
                    line |= compare(target, images)
                    lines.append(line)
                    add(line)
                if seed < FIRST_SEED + pictures:
                    draw(target, images, out / f"{target}_{seed}.png")
    _print(lines)
    Console().print(made_by(out / "results.jsonl"), soft_wrap=True)


def _print(lines: list[dict[str, Any]]) -> None:
    table = Table()
    for name in (
        "target",
        "visible",
        "heaps",
        "poses",
        "true mask in support",
        "IoU with the label",
        "support, pixels",
        "core-s an image",
    ):
        table.add_column(name)
    for target in sorted({line["target"] for line in lines}):
        for most, title in ((1.01, "all"), (0.9, "at most 90 %")):
            chosen = [
                line
                for line in lines
                if line["target"] == target and line["visible"] <= most
            ]
            for poses in ("flat", "resting") if chosen else ():
                own = [line[poses] for line in chosen]
                held = np.mean([one["held"] >= HELD for one in own])
                table.add_row(
                    target,
                    title,
                    str(len(own)),
                    poses,
                    f"{held:.0%}",
                    f"{np.nanmean([one['iou'] for one in own]):.2f}",
                    f"{np.median([one['support'] for one in own]):.0f}",
                    f"{np.median([one['seconds'] for one in own]):.2f}",
                )
    Console(width=110).print(table)


if __name__ == "__main__":
    typer.run(main)
