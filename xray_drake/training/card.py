"""The card of a network that was trained."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import lightning
import torch

from xray_drake.dataset.manifest import read_manifest
from xray_drake.occupancy.learned.weights import NetworkCard, read_card
from xray_drake.provenance import Provenance, current, made_by
from xray_drake.training.config import TrainConfig
from xray_drake.training.data import TrainingData
from xray_drake.training.module import OccupancyTraining


def make_card(
    datasets: Sequence[Path],
    config: TrainConfig,
    data: TrainingData,
    module: OccupancyTraining,
    trainer: lightning.Trainer,
    *,
    box_size: tuple[float, float, float] | None,
    out: Path,
) -> NetworkCard:
    """Says what was trained on what, and how good it became.

    Args:
        datasets: folders.
        config: of the run.
        data: what it was trained and validated on.
        module: when all is done.
        trainer: that did it.
        box_size: length, width, thickness of the one box that the network
            knows, m; None if it is told the target's size.
        out: folder of the run, with its manifest.
    """
    manifests = [read_manifest(dataset) for dataset in datasets]
    targets = sorted({name for m in manifests for name in m.targets})
    if config.targets:
        targets = [name for name in targets if name in config.targets]
    metrics = {
        name: round(float(value), 4)
        for name, value in trainer.callback_metrics.items()
        if name.startswith("validation/")
    }
    return NetworkCard(
        architecture=config.architecture,
        options=config.options,
        input=config.input,
        targets=tuple(targets),
        box_size=box_size,
        data={
            "datasets": [
                {
                    "scenario": manifest.scenario,
                    "seed": manifest.seed,
                    "images when complete": manifest.num_samples,
                    "views per heap": manifest.views_per_heap,
                    "fingerprint": manifest.fingerprint(),
                    "drake": manifest.drake_version,
                    "made by": made_by(dataset),
                }
                for dataset, manifest in zip(datasets, manifests, strict=True)
            ],
            "images used": data.num_images,
            "items to train on": data.num_train,
            "items held out": data.num_validation,
        },
        training={
            **module.facts(),
            **_beginning(config),
            "optimizer steps": trainer.global_step,
            "threads": torch.get_num_threads(),
            "made by": made_by(out),
            "provenance": provenance(config).to_dict(),
        },
        figures={f"held-out heaps, {module.resolution}": metrics},
    )


def provenance(config: TrainConfig) -> Provenance:
    """Returns the provenance of a run of training, of this process."""
    given = (config.weights, config.backbone)
    return current(
        weights=[Path(path) for path in given if path], dtype=config.precision
    )


def _beginning(config: TrainConfig) -> dict[str, Any]:
    """What the weights that training began with were trained on."""
    path = Path(config.weights)
    # A run that is resumed does not need them any more.
    if not config.weights or not path.is_file():
        return {}
    card = read_card(path)
    return {
        "began with": {
            "architecture": card.architecture,
            "images used": card.data.get("images used"),
            "seed": card.training.get("seed"),
            "passes": card.training.get("passes"),
            "optimizer steps": card.training.get("optimizer steps"),
            "date": card.training.get("provenance", card.training).get("date"),
        }
    }
