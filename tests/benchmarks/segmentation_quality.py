"""Measures how well instances are found in depth, on a generated dataset.

    python tests/benchmarks/segmentation_quality.py FOLDER --images 100

compares the segmentation of the first images with their true instances, and
prints a table: depth as rendered and as a real sensor sees it, each without
the target's mask and with the true one. ``--pictures FOLDER`` draws the truth
beside what was found.
"""

import time
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer
from rich.console import Console
from rich.progress import track
from rich.table import Table

from xray_drake.dataset.manifest import read_manifest
from xray_drake.dataset.reader import OccupancyDataset
from xray_drake.dataset.sample import Sample
from xray_drake.drawing.sample_figure import depth_picture, instance_picture
from xray_drake.perception.depth_noise import DepthNoise
from xray_drake.perception.depth_segmenter import segment_depth
from xray_drake.perception.segmentation_metrics import (
    SegmentationScore,
    score_segmentation,
)
from xray_drake.provenance import Run, current, describe, record_run
from xray_drake.seeding import stream


def observed(sample: Sample, noise: DepthNoise | None) -> np.ndarray:
    """Returns the depth image as rendered, or with noise of its own."""
    if noise is None:
        return sample.depth
    key = sample.key
    rng = stream(0, "sensor", key.heap_seed, key.view, key.num_dropped)
    return noise.noisy(sample.depth, float(sample.intrinsics[0, 0]), rng)


def truth(sample: Sample) -> np.ndarray:
    """Returns the (H, W) objects, −1 for the background."""
    return sample.instances.astype(np.int32) - 1


def draw(sample: Sample, depth: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Returns depth, truth and what was found, side by side, as RGB."""
    # No segment is red: red is the target in the truth.
    segments = np.where(found >= 0, found + 2, 0)
    return np.hstack(
        [
            depth_picture(depth),
            instance_picture(sample.instances),
            instance_picture(segments),
        ]
    )


def main(
    dataset: Annotated[Path, typer.Argument(help="Holds dataset.json.")],
    images: Annotated[int, typer.Option(min=1)] = 100,
    first: Annotated[int, typer.Option(min=0)] = 0,
    step: Annotated[int, typer.Option(min=1)] = 1,
    split: Annotated[str | None, typer.Option()] = None,
    pictures: Annotated[Path | None, typer.Option()] = None,
) -> None:
    """Prints how well the depth segmenter does."""
    data = OccupancyDataset(dataset, split=split, incomplete=True)
    indices = range(first, len(data), step)[:images]
    if pictures is not None:
        pictures.mkdir(parents=True, exist_ok=True)
    table = Table(title=f"{len(indices)} images")
    for column in (
        "depth",
        "target's mask",
        "objects",
        "segments",
        "mean IoU",
        "recall",
        "precision",
        "over-segm.",
        "under-segm.",
        "CPU ms",
    ):
        table.add_column(column, justify="right")
    for depth_name, noise in (("rendered", None), ("noisy", DepthNoise())):
        for mask_name in ("none", "true"):
            score, seconds = SegmentationScore(), 0.0
            for index in track(indices, f"{depth_name}, {mask_name}"):
                sample = data.sample(index)
                depth = observed(sample, noise)
                target = sample.target_modal if mask_name == "true" else None
                start = time.process_time()
                found = segment_depth(depth, sample.camera, target=target)
                seconds += time.process_time() - start
                score += score_segmentation(truth(sample), found.labels)
                if pictures is not None and mask_name == "none":
                    cv2.imwrite(
                        str(pictures / f"{index:05d}_{depth_name}.png"),
                        draw(sample, depth, found.labels)[..., ::-1],
                    )
            table.add_row(
                depth_name,
                mask_name,
                str(score.objects),
                str(score.segments),
                f"{score.mean_iou:.3f}",
                f"{score.recall:.1%}",
                f"{score.precision:.1%}",
                f"{score.over_segmentation:.3f}",
                f"{score.under_segmentation:.3f}",
                f"{1e3 * seconds / len(indices):.0f}",
            )
    console = Console(width=120)
    console.print(table)
    manifest, now = read_manifest(dataset), current(scripts=[Path(__file__)])
    if pictures is not None:
        settings = {"dataset": str(dataset), "images": list(indices)}
        record_run(
            pictures,
            Run(
                "segmentation_quality",
                now,
                manifest.scenario,
                [manifest.seed],
                settings,
            ),
        )
    line = describe([now], seeds=[manifest.seed])
    console.print(line, highlight=False, soft_wrap=True)


if __name__ == "__main__":
    typer.run(main)
