"""Measures how well the label can be known at all, from the image alone.

    python tests/benchmarks/label_ceiling.py FOLDER --images 100

The label of an image is made from the target's true pose: its candidates lie on
a grid of 8 pixels and 16 orientations through that pose. Whoever sees the image
knows the pose only as far as the image shows it. For each image of a box this
walks at random over poses that show the same visible pixels, labels the image
as if each were the true one, and scores against the dataset's label

- *another pose*: the label of one of them;
- *mean*: their mean, the answer of least expected squared error;
- *best*: for each pixel the answer within 0.2 of most of them, as the metrics
  ask, where all that can be known of the pose is known;
- *guess*: what ``ExpectedLabel`` answers, from the image alone;
- *network*, with ``--weights``: what that answers to the same images.

The walk starts at the true pose and keeps the target's tilt, so that where
there are poses far away it finds fewer than there are: the ceiling is, if
anything, lower.
"""

from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from pydrake.math import RotationMatrix
from rich.console import Console
from rich.progress import track
from rich.table import Table

from xray_drake.choices import DTYPES
from xray_drake.dataset.manifest import read_manifest
from xray_drake.dataset.reader import OccupancyDataset
from xray_drake.dataset.sample import Sample
from xray_drake.dataset.virtual import VirtualTarget, make_target, target_depth
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.occupancy.geometric.expected import ExpectedLabel
from xray_drake.occupancy.label.ground_truth import LabelConfig, occupancy_label
from xray_drake.occupancy.learned.inference import load_inference
from xray_drake.occupancy.metrics import TOLERANCE, PixelCounts, pixel_counts
from xray_drake.provenance import current, describe
from xray_drake.scene.targets import target_model
from xray_drake.seeding import stream

STEPS = (0.0005, 0.003, 0.015, 0.08)
"""Lengths of the walk's steps, m; over 0.02 m, the angle's in rad."""

ALIKE = 0.02
"""Share of the visible pixels that may differ: the target's outline falls
between pixels."""

ANSWERS = np.arange(0.0, 1.001, 0.05)


class Poses:
    """A random walk over poses that show what is seen of the target."""

    def __init__(
        self, sample: Sample, target: VirtualTarget, rng: np.random.Generator
    ) -> None:
        self._camera: PinholeCamera = sample.camera
        self._scene = sample.depth_without_target
        self._target, self._rng = target, rng
        self.pose = np.array(sample.X_WT)
        self._seen = self._visible(target_depth(target, self.pose, self.camera))

    @property
    def camera(self) -> PinholeCamera:
        return self._camera

    def _visible(self, depth: np.ndarray) -> np.ndarray:
        tolerance = LabelConfig().depth_tolerance
        return (depth > 0) & (self._scene - depth > tolerance)

    def _is_alike(self, depth: np.ndarray) -> bool:
        visible = self._visible(depth)
        if not self._seen.any():
            return bool(depth.any()) and not visible.any()
        differing = np.count_nonzero(visible ^ self._seen)
        return bool(differing <= ALIKE * np.count_nonzero(self._seen))

    def step(self) -> bool:
        """Goes on to another pose, if that shows the same."""
        length = self._rng.choice(STEPS)
        pose = np.array(self.pose)
        turn = RotationMatrix.MakeZRotation(
            self._rng.normal(0.0, length / 0.02)
        ).matrix()
        pose[:3, :3] = turn @ pose[:3, :3]
        pose[:2, 3] += self._rng.normal(0.0, length, 2)
        low_x, high_x, low_y, high_y = LabelConfig().floor
        inside = low_x < pose[0, 3] < high_x and low_y < pose[1, 3] < high_y
        if not inside or not self._is_alike(
            target_depth(self._target, pose, self._camera)
        ):
            return False
        self.pose = pose
        return True


def score(
    folder: Path, index: int, *, labels: int, walk: int, weights: Path | None
) -> tuple[str, float, dict[str, PixelCounts]] | None:
    """Returns target, visible fraction and counts of one image."""
    sample = OccupancyDataset(folder, incomplete=True).sample(index)
    if not sample.target_name.startswith("box"):
        return None
    target = make_target("box", sample.target_size)
    poses = Poses(sample, target, stream(0, "ceiling", index))
    found = []
    for _ in range(labels):
        for _ in range(walk):
            poses.step()
        depth = target_depth(target, poses.pose, poses.camera)
        found.append(
            occupancy_label(
                depth,
                sample.depth_without_target,
                poses.camera,
                poses.pose[:3, 3],
            ).distribution
        )
    stack = np.array(found)
    within = np.array(
        [(np.abs(stack - p) < TOLERANCE).sum(axis=0) for p in ANSWERS]
    )
    answers = {
        "another pose": stack[-1],
        "mean": stack.mean(axis=0),
        "best": ANSWERS[within.argmax(axis=0)],
    }
    guess = ExpectedLabel(target_model(sample.target_name))
    answers["guess"] = guess.infer(
        sample.depth, sample.target_modal, poses.camera
    ).data
    if weights is not None:
        network = load_inference(weights, target_size=sample.target_size)
        answers["network"] = network.infer(
            sample.depth, sample.target_modal, poses.camera
        ).data
    return (
        sample.target_name,
        sample.visible_fraction,
        {k: pixel_counts(sample.occupancy, p) for k, p in answers.items()},
    )


def main(
    dataset: Annotated[Path, typer.Argument(help="Holds dataset.json.")],
    images: Annotated[int, typer.Option(min=1)] = 100,
    step: Annotated[int, typer.Option(min=1, help="Every n-th image.")] = 1,
    labels: Annotated[int, typer.Option(min=2, help="Poses an image.")] = 24,
    walk: Annotated[int, typer.Option(min=1, help="Steps between.")] = 40,
    weights: Annotated[Path | None, typer.Option(help="To compare.")] = None,
    workers: Annotated[int, typer.Option(min=1)] = 2,
) -> None:
    """Prints how well the label can be known."""
    number = len(OccupancyDataset(dataset, incomplete=True))
    indices = range(0, number, step)[:images]
    total: dict[str, dict[str, PixelCounts]] = defaultdict(dict)
    count: dict[str, int] = defaultdict(int)
    work = partial(score, dataset, labels=labels, walk=walk, weights=weights)
    with ProcessPoolExecutor(workers) as pool:
        for result in track(pool.map(work, indices), total=len(indices)):
            if result is None:
                continue
            name, visible, counts = result
            start = "hidden" if visible == 0 else "partly visible"
            if visible >= 1:
                start = "fully visible"
            for row in (name, start, "all boxes"):
                count[row] += 1
                for answer, counted in counts.items():
                    so_far = total[row].get(answer)
                    total[row][answer] = (
                        counted if so_far is None else so_far + counted
                    )
    table = Table(title="balanced accuracy / IoU")
    answers = next(iter(total.values()), {})
    for column in ("target", "images", *answers):
        table.add_column(column, justify="right")
    for row in sorted(total):
        table.add_row(
            row,
            str(count[row]),
            *(
                f"{c.balanced_accuracy:.1%} / {c.iou:.3f}"
                for c in total[row].values()
            ),
        )
    console = Console(width=100)
    console.print(table)
    now = current(
        weights=[weights] if weights else [],
        dtype=DTYPES[0] if weights else "",
        scripts=[Path(__file__)],
    )
    line = describe([now], seeds=[read_manifest(dataset).seed])
    console.print(line, highlight=False, soft_wrap=True)


if __name__ == "__main__":
    typer.run(main)
