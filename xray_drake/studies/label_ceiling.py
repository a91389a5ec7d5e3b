"""How well the label can be known at all, from the image alone.

The label of an image is made from the target's true pose: its candidates lie on
a grid of 8 pixels and 16 orientations through that pose. Whoever sees the image
knows the pose only as far as the image shows it. For each image of a box this
walks at random over poses that show the same visible pixels, labels the image
as if each were the true one, and scores against the dataset's label

- *another pose*: the label of one of them;
- *mean*: their mean, the answer of least expected squared error;
- *best*: for each pixel the answer within 0.2 of most of them, as the metrics
  ask, where all that can be known of the pose is known;
- *guess*: what ``geometric_label`` answers, from the image alone;
- *network*, with weights: what that answers to the same images.

The walk starts at the true pose and keeps the target's tilt, so that where
there are poses far away it finds fewer than there are: the ceiling is, if
anything, lower.
"""

from collections.abc import Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np
from pydrake.math import RotationMatrix

from xray_drake.choices import DTYPES
from xray_drake.dataset.manifest import read_manifest
from xray_drake.dataset.reader import OccupancyDataset
from xray_drake.dataset.sample import Sample
from xray_drake.dataset.virtual import VirtualTarget, make_target, target_depth
from xray_drake.occupancy.inference import make_inference
from xray_drake.occupancy.label.ground_truth import LabelConfig, occupancy_label
from xray_drake.occupancy.metrics import TOLERANCE, PixelCounts, pixel_counts
from xray_drake.provenance import current
from xray_drake.scene.targets import target_model
from xray_drake.seeding import stream
from xray_drake.studies.study import Line, Study, Table

STEPS = (0.0005, 0.003, 0.015, 0.08)
"""Lengths of the walk's steps, m; over 0.02 m, the angle's in rad."""

ALIKE = 0.02
"""Share of the visible pixels that may differ: the target's outline falls
between pixels."""

LABELS = 24
"""Poses an image."""

WALK = 40
"""Steps between two of them."""

ANSWERS = np.arange(0.0, 1.001, 0.05)


class PoseWalk:
    """A random walk over poses that show what is seen of the target.

    Args:
        sample: whose true pose it begins at.
        target: its shape.
        rng: of the steps.

    Attributes:
        pose: (4, 4) X_WT where it is.
    """

    def __init__(
        self, sample: Sample, target: VirtualTarget, rng: np.random.Generator
    ) -> None:
        self._camera, self._floor = sample.camera, sample.floor
        self._scene = sample.depth_without_target
        self._target, self._rng = target, rng
        self.pose = np.array(sample.X_WT)
        self._seen = self._visible(self.depth(self.pose))

    def depth(self, pose: np.ndarray) -> np.ndarray:
        """Returns the depth image of the target alone at a pose, m."""
        return target_depth(self._target, pose, self._camera)

    def _visible(self, depth: np.ndarray) -> np.ndarray:
        tolerance = LabelConfig().depth_tolerance
        return (depth > 0) & (self._scene - depth > tolerance)

    def _is_alike(self, depth: np.ndarray) -> bool:
        visible = self._visible(depth)
        if not self._seen.any():
            return bool(depth.any()) and not visible.any()
        differing = np.count_nonzero(visible ^ self._seen)
        return bool(differing <= ALIKE * np.count_nonzero(self._seen))

    def step(self) -> None:
        """Goes on to another pose, if that shows the same."""
        length = self._rng.choice(STEPS)
        pose = np.array(self.pose)
        turn = RotationMatrix.MakeZRotation(
            self._rng.normal(0.0, length / 0.02)
        ).matrix()
        pose[:3, :3] = turn @ pose[:3, :3]
        pose[:2, 3] += self._rng.normal(0.0, length, 2)
        inside = self._floor.contains(pose[:2, 3])
        if inside and self._is_alike(self.depth(pose)):
            self.pose = pose


def label_ceiling(
    dataset: Path,
    *,
    images: int,
    step: int = 1,
    weights: Path | None = None,
) -> Study:
    """Returns the study of what can be known of labels.

    Args:
        dataset: of :mod:`xray_drake.dataset`, complete or not.
        images: how many, at most; those of boxes count.
        step: every n-th image.
        weights: of a network to compare.

    Raises:
        DatasetError: the folder is no dataset, or it is damaged.
    """
    number = len(OccupancyDataset(dataset, incomplete=True))
    manifest = read_manifest(dataset)
    return Study(
        "label_ceiling",
        [{"index": index} for index in range(0, number, step)[:images]],
        partial(_score, dataset=dataset, weights=weights),
        ceiling_tables,
        seeds=[manifest.seed],
        settings={"fingerprint": manifest.fingerprint()},
        made_by=current(
            weights=[weights] if weights else [],
            dtype=DTYPES[0] if weights else "",
        ),
    )


def _score(item: Line, *, dataset: Path, weights: Path | None) -> Line:
    """Returns target, visible fraction and counts of one image."""
    sample = OccupancyDataset(dataset, incomplete=True).sample(item["index"])
    if not sample.target_name.startswith("box"):
        return {"target": sample.target_name, "counts": {}}
    target = make_target("box", sample.target_size)
    poses = PoseWalk(sample, target, stream(0, "ceiling", item["index"]))
    found = []
    for _ in range(LABELS):
        for _ in range(WALK):
            poses.step()
        found.append(
            occupancy_label(
                poses.depth(poses.pose),
                sample.depth_without_target,
                sample.camera,
                poses.pose[:3, 3],
                floor=sample.floor,
            ).distribution
        )
    stack = np.array(found)
    within = [(np.abs(stack - p) < TOLERANCE).sum(axis=0) for p in ANSWERS]
    answers = {
        "another pose": stack[-1],
        "mean": stack.mean(axis=0),
        "best": ANSWERS[np.argmax(within, axis=0)],
    }
    seen = sample.depth, sample.target_modal, sample.camera
    guess = make_inference(
        "geometric_label",
        target_model(sample.target_name),
        floor=sample.floor,
    )
    answers["guess"] = guess.infer(*seen).data
    if weights is not None:
        network = make_inference(
            "learned",
            sample.target_size,
            floor=sample.floor,
            weights=weights,
        )
        answers["network"] = network.infer(*seen).data
    return {
        "target": sample.target_name,
        "visible": sample.visible_fraction,
        "counts": {
            name: asdict(pixel_counts(sample.occupancy, answer))
            for name, answer in answers.items()
        },
    }


def ceiling_tables(lines: list[Line]) -> Mapping[str, Table]:
    """Returns rows by target and by how much of it is seen, and of all."""
    groups: dict[str, list[Line]] = {}
    for line in lines:
        if line["counts"]:
            start = "partly visible" if line["visible"] < 1 else "fully visible"
            start = start if line["visible"] else "hidden"
            for row in (line["target"], start, "all boxes"):
                groups.setdefault(row, []).append(line["counts"])
    rows = []
    for name, counts in sorted(groups.items()):
        row = {"target": name, "images": len(counts)}
        for answer in counts[0]:
            total = sum(
                (PixelCounts(**c[answer]) for c in counts), PixelCounts()
            )
            row[f"{answer}: balanced accuracy"] = total.balanced_accuracy
            row[f"{answer}: IoU"] = total.iou
        rows.append(row)
    return {"label_ceiling": rows}
