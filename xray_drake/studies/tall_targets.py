"""Geometric inference of tall targets: taken for flat, and in resting poses.

Heaps of packaged objects are dropped over each tall target, lying on any face.
For both inferences: in how many heaps the support holds 95 % of the target's
true amodal mask, how the distribution agrees with the paper's label (candidates
on a grid of 8 pixels through the true pose, IoU above 0.9 with the true modal
mask) summed over all resting poses by probability, and the time of a core.
"""

import time
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from xray_drake.choices import TALL_TARGETS
from xray_drake.dataset.pictures import Photographer, Picture
from xray_drake.geometry.resting import RestingPose, resting_poses
from xray_drake.geometry.silhouette import project_mesh_mask
from xray_drake.occupancy.geometric.config import GeometricConfig
from xray_drake.occupancy.geometric.inference import GeometricInference
from xray_drake.occupancy.label.ground_truth import occupancy_label
from xray_drake.occupancy.metrics import pixel_counts
from xray_drake.scene.heap import Heap
from xray_drake.scene.object_model import ObjectModel
from xray_drake.scene.targets import target_model
from xray_drake.station.objects import make_heap
from xray_drake.station.scenario import Scenario
from xray_drake.studies.study import Line, Study, Table

_KINDS = ("flat", "resting")
"""Poses of geometric inference."""

FIRST_SEED = 50_000
OBJECTS = 6
"""In a heap."""

HELD = 0.95
"""Share of the true mask that a support is to hold."""


def tall_targets(heaps: int) -> Study:
    """Returns the comparison of inferences on so many heaps of each target."""
    seeds = range(FIRST_SEED, FIRST_SEED + heaps)
    return Study(
        "tall_targets",
        [{"target": t, "seed": seed} for seed in seeds for t in TALL_TARGETS],
        _measure,
        tall_tables,
        seeds=seeds,
    )


def _measure(item: Line) -> Line:
    """Drops a heap and infers its image in both ways."""
    scenario = Scenario(seed=item["seed"])
    scenario.scene.target = item["target"]
    scenario.scene.num_objects = OBJECTS
    # On backing cards and close together, so that few cover a tall target.
    scenario.scene.packaged = True
    scenario.scene.packaged_share = 1.0
    scenario.scene.heap.offset_sigma = 0.03
    heap = make_heap(scenario)
    photographer = Photographer(
        heap.target, heap.objects, scenario.camera, scenario.cell.bin
    )
    photographer.place(heap)
    picture = photographer.take()
    X_WT = heap.poses[heap.target.name]
    amodal = project_mesh_mask(
        heap.target.visual.vertices,
        heap.target.visual.faces,
        X_WT,
        picture.camera,
    )
    modal = picture.instances == 1
    poses = resting_poses(heap.target.visual, heap.target.p_OCom)
    aligned = [float((pose.downs @ -X_WT[2, :3]).max()) for pose in poses]
    true = int(np.argmax(aligned))
    label = _label(heap, scenario, picture, poses, true)
    line: Line = {
        "lean_deg": float(np.rad2deg(heap.target_tilt)),
        "visible": float(modal.sum() / amodal.sum()),
        "pose": true,
    }
    for kind in _KINDS:
        model = GeometricInference(
            target_model(item["target"]), GeometricConfig(kind)
        )
        # The first image compiles, or loads what is compiled.
        depth = picture.camera.plane_depth(0.0).astype(np.float32)
        for seen in (False, True):
            mask = np.zeros(depth.shape, dtype=bool)
            mask[180:210, 240:270] = seen
            model.infer(depth - np.float32(0.1), mask, picture.camera)
        start = time.process_time()
        found = model.infer(picture.depth, modal, picture.camera)
        line[kind] = {
            "seconds": time.process_time() - start,
            "held": float((found.support() & amodal).sum() / amodal.sum()),
            "support": found.support_size(),
            "iou": pixel_counts(label, found.data).iou,
        }
    return line


def _label(
    heap: Heap,
    scenario: Scenario,
    picture: Picture,
    poses: tuple[RestingPose, ...],
    true: int,
) -> np.ndarray:
    """Sums the paper's label over all resting poses, by probability.

    Returns:
        (H, W) float32 in [0, 1].
    """
    alone = Photographer(heap.target, (), scenario.camera, None)
    X_WT = heap.poses[heap.target.name]
    total = np.zeros(picture.depth.shape)
    for k, pose in enumerate(poses):
        X = X_WT if k == true else _on_another_face(heap.target, X_WT, pose)
        alone.place(replace(heap, objects=(), poses={heap.target.name: X}))
        one = occupancy_label(
            alone.depth(),
            picture.depth_without_target,
            picture.camera,
            X[:3, 3],
            observed=picture.instances == 1,
            true_pose=k == true,
        )
        total += pose.probability * one.largest * one.distribution
    return (total / max(total.max(), 1e-12)).astype(np.float32)


def _on_another_face(
    target: ObjectModel, X_WT: np.ndarray, pose: RestingPose
) -> np.ndarray:
    """Returns the target where its centre of mass is, lying otherwise."""
    X = np.array(X_WT)
    center = X_WT[:3, :3] @ target.p_OCom + X_WT[:3, 3]
    X[:3, :3] = pose.R_WO
    X[:3, 3] = center - pose.R_WO @ target.p_OCom
    X[2, 3] = -(target.visual.vertices @ pose.R_WO.T)[:, 2].min()
    return X


def tall_tables(lines: list[Line]) -> Mapping[str, Table]:
    """Returns rows by target, by how much is seen of it, and by inference."""
    rows = []
    for target in sorted({line["target"] for line in lines}):
        for most, title in ((1.01, "all"), (0.9, "at most 90 %")):
            chosen = [
                line
                for line in lines
                if line["target"] == target and line["visible"] <= most
            ]
            for poses in _KINDS if chosen else ():
                held, iou, support, seconds = np.array(
                    [
                        [line[poses][key] for line in chosen]
                        for key in ("held", "iou", "support", "seconds")
                    ]
                )
                rows.append(
                    {
                        "target": target,
                        "visible": title,
                        "heaps": len(chosen),
                        "poses": poses,
                        "true mask in support": np.mean(held >= HELD),
                        "IoU with the label": np.nanmean(iou),
                        "support, pixels": np.median(support),
                        "core-s an image": np.median(seconds),
                    }
                )
    return {"tall_targets": rows}
