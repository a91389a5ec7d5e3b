"""A training run from datasets to a file of weights."""

import platform
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from datetime import date
from pathlib import Path
from typing import Any

import lightning
import torch
from lightning.pytorch.callbacks import ModelCheckpoint, RichProgressBar
from lightning.pytorch.loggers import CSVLogger
from torch import nn

from xray_drake.dataset.manifest import read_manifest
from xray_drake.files import write_whole_file
from xray_drake.occupancy.networks.build import build_network
from xray_drake.occupancy.networks.weights import NetworkCard, save_weights
from xray_drake.training.config import TrainConfig, TrainingError
from xray_drake.training.data import PreparedData
from xray_drake.training.module import CompactTraining
from xray_drake.training.prepare import plan, prepare

CHECKPOINT = "last.ckpt"
WEIGHTS = "weights.safetensors"
CARD = "card.md"


@dataclass(frozen=True)
class RunOptions:
    """Where and on what a run happens; nothing here changes what is learned.

    Attributes:
        out: folder of the run.
        resume: go on from the checkpoint in it.
        cache: folder of prepared items; by default in ``out``.
        workers: processes that prepare.
        accelerator: Lightning's name: auto, cpu, gpu.
        devices: how many.
        progress: draw a bar.
    """

    out: Path
    resume: bool = False
    cache: Path | None = None
    workers: int = 1
    accelerator: str = "auto"
    devices: int = 1
    progress: bool = True


def train(
    datasets: Sequence[Path],
    config: TrainConfig,
    options: RunOptions,
    *,
    prepared: Callable[[int, int], None] = lambda done, total: None,
) -> NetworkCard:
    """Trains a network and writes its weights and card.

    Args:
        datasets: folders that ``xray-drake generate`` made; all object splits
            in them are used, so give those of training objects.
        config: what to train.
        options: where.
        prepared: told of prepared shards, done and of all.

    Returns:
        The card that was written with the weights.

    Raises:
        DatasetError, TrainingError: what was given cannot be trained on.
        OSError: something cannot be written.
    """
    _open_run(options)
    lightning.seed_everything(config.seed, workers=True, verbose=False)
    cache = options.cache or options.out / "cache"
    share = config.validation_share
    jobs = plan(datasets, cache, config.prepare, share)
    for done in prepare(jobs, config.prepare, share, workers=options.workers):
        prepared(done, len(jobs))
    data = PreparedData([path for _, path in jobs], config)
    net = build_network(config.architecture, config.options)
    steps = data.epochs * data.steps_per_epoch
    module = CompactTraining(net, config, steps)
    trainer = _trainer(config, options, data.epochs)
    path = options.out / CHECKPOINT
    with warnings.catch_warnings():
        # One process reads; more would take the trainer's cores.
        warnings.filterwarnings("ignore", ".*does not have many workers.*")
        trainer.fit(
            module,
            data,
            ckpt_path=str(path) if options.resume else None,
            weights_only=True,
        )
    if trainer.interrupted or trainer.global_step < steps:
        raise TrainingError(
            f"stopped after {trainer.global_step} of {steps} steps; go on "
            "with --resume"
        )
    card = _card(datasets, config, data, trainer)
    _export(options.out, net, card)
    return card


def _open_run(options: RunOptions) -> None:
    out = options.out
    out.mkdir(parents=True, exist_ok=True)
    checkpoint = out / CHECKPOINT
    if options.resume and not checkpoint.is_file():
        raise TrainingError(
            f"{checkpoint} is missing: there is nothing to resume; leave out "
            "--resume"
        )
    if not options.resume and checkpoint.is_file():
        raise TrainingError(
            f"{out} holds a run: give --resume to go on with it, or another "
            "folder"
        )


def _trainer(
    config: TrainConfig, options: RunOptions, epochs: int
) -> lightning.Trainer:
    checkpoints = ModelCheckpoint(
        dirpath=options.out,
        filename="best",
        monitor="validation/iou",
        mode="max",
        save_last=True,
        enable_version_counter=False,
    )
    callbacks: list[lightning.Callback] = [checkpoints]
    if options.progress:
        callbacks.append(RichProgressBar())
    return lightning.Trainer(
        max_epochs=epochs,
        accelerator=options.accelerator,
        devices=options.devices,
        precision=config.precision,  # type: ignore[arg-type]
        logger=CSVLogger(options.out, name="", version="logs"),
        callbacks=callbacks,
        enable_progress_bar=options.progress,
        enable_model_summary=False,
        log_every_n_steps=50,
        num_sanity_val_steps=0,
    )


def _card(
    datasets: Sequence[Path],
    config: TrainConfig,
    data: PreparedData,
    trainer: lightning.Trainer,
) -> NetworkCard:
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
        box_size=None,
        data={
            "datasets": [
                {
                    "scenario": manifest.scenario,
                    "seed": manifest.seed,
                    "images": manifest.num_samples,
                    "views per heap": manifest.views_per_heap,
                    "drake": manifest.drake_version,
                }
                for dataset, manifest in zip(datasets, manifests, strict=True)
            ],
            "items to train on": len(data.train_items),
            "items held out": len(data.validation_items),
        },
        training={
            **_plain(config),
            "optimizer steps": trainer.global_step,
            "date": date.today().isoformat(),
            "machine": platform.machine(),
            "threads": torch.get_num_threads(),
            "torch": torch.__version__,
        },
        figures={"held-out heaps, half resolution": metrics},
    )


def _plain(config: TrainConfig) -> dict[str, Any]:
    return asdict(config)


def _export(out: Path, net: nn.Module, card: NetworkCard) -> None:
    state = {name: value.detach() for name, value in net.state_dict().items()}
    save_weights(out / WEIGHTS, state, card)
    write_whole_file(out / CARD, card.to_markdown().encode())
