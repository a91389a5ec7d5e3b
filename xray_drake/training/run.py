"""A training run from datasets to a file of weights."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from pickle import UnpicklingError

import lightning
import torch
from lightning.pytorch.callbacks import ModelCheckpoint, RichProgressBar
from lightning.pytorch.loggers import CSVLogger
from lightning.pytorch.utilities.exceptions import MisconfigurationException
from lightning.pytorch.utilities.rank_zero import rank_zero_only
from torch import nn

from xray_drake.dataset.manifest import read_manifest
from xray_drake.files import sole_writer, write_whole_file
from xray_drake.occupancy.learned.build import build_network
from xray_drake.occupancy.learned.weights import NetworkCard, save_weights
from xray_drake.occupancy.learned.windowed import WindowedNet
from xray_drake.provenance import Run, check_resumable, record_run
from xray_drake.training.beginning import begin_with, load_backbone
from xray_drake.training.box import box_size
from xray_drake.training.card import make_card, provenance
from xray_drake.training.config import TrainConfig, TrainingError
from xray_drake.training.data import (
    TrainingData,
    open_items,
    steps_per_epoch,
)
from xray_drake.training.module import CompactTraining, OccupancyTraining
from xray_drake.training.paper import PaperTraining, input_mean, paper_items
from xray_drake.training.prepare import plan, prepare
from xray_drake.training.windows import WindowedData, WindowedTraining

Progress = Callable[[int, int], None]
"""Is told of prepared shards, done and of all."""

_LOG_EVERY = 50
"""Steps between two entries of the log."""

_FEWEST_LOGGED = 100
"""A short run logs more often, so that its loss makes a curve."""

_FREE = {"name", "passes", "weights", "backbone", "precision"}
"""Keys of a configuration that may change when a run is resumed: the number
type is the manifest's."""

CHECKPOINT = "last.ckpt"
WEIGHTS = "weights.safetensors"
CARD = "card.md"


@dataclass(frozen=True)
class RunOptions:
    """Where and on what a run happens; nothing here changes what is learned.

    Attributes:
        out: folder of the run.
        resume: go on from the checkpoint in it.
        mix: even if other code, versions, weights or another number type made
            it.
        cache: folder of prepared items; by default in ``out``.
        workers: processes that prepare; or that read, where nothing is
            prepared.
        accelerator: Lightning's name: auto, cpu, gpu.
        devices: how many.
        incomplete: train on what is there of datasets that lack shards.
        progress: draw a bar.
    """

    out: Path
    resume: bool = False
    mix: bool = False
    cache: Path | None = None
    workers: int = 1
    accelerator: str = "auto"
    devices: int = 1
    incomplete: bool = False
    progress: bool = True


def train(
    datasets: Sequence[Path],
    config: TrainConfig,
    options: RunOptions,
    *,
    prepared: Progress = lambda done, total: None,
) -> NetworkCard:
    """Trains a network and writes its weights and card.

    Args:
        datasets: folders that ``xray-drake generate`` made; all object splits
            in them are used, so give those of training objects.
        config: what to train.
        options: where.
        prepared: told of what is prepared ("compact" only).

    Returns:
        The card that was written with the weights.

    Raises:
        DatasetError, TrainingError, WeightsError: what was given cannot be
            trained on, or what to begin with is of another network.
        ManifestError: a run is to be resumed that other code has begun.
        InUseError: another process trains in the folder.
        OSError: something cannot be written.
    """
    steps_per_epoch(config, options.devices)
    options.out.mkdir(parents=True, exist_ok=True)
    # Lightning starts a process for each further device.
    alone = sole_writer(options.out) if _is_first() else nullcontext()
    with alone:
        _open_run(datasets, config, options)
        return _train(datasets, config, options, prepared)


def _is_first() -> bool:
    return not getattr(rank_zero_only, "rank", 0)


def _train(
    datasets: Sequence[Path],
    config: TrainConfig,
    options: RunOptions,
    prepared: Progress,
) -> NetworkCard:
    lightning.seed_everything(config.seed, workers=True, verbose=False)
    size = box_size(datasets, config)
    net = build_network(config.architecture, config.options)
    # What is resumed has its weights in the checkpoint.
    if config.weights and not options.resume:
        begin_with(net, Path(config.weights))
    make = _MAKERS[config.architecture]
    module, data = make(net, datasets, config, options, prepared)
    steps = data.steps
    try:
        trainer = _trainer(config, options, data.epochs, steps)
    except (MisconfigurationException, ValueError) as error:
        # Lightning's, of an accelerator or precision that it has not got.
        raise TrainingError(str(error)) from error
    _fit(trainer, module, data, options)
    if trainer.global_step < steps:
        raise TrainingError(
            f"stopped after {trainer.global_step} of {steps} steps; go on "
            "with --resume"
        )
    card = make_card(
        datasets, config, data, module, trainer, box_size=size, out=options.out
    )
    state = {name: value.detach() for name, value in net.state_dict().items()}
    save_weights(options.out / WEIGHTS, state, card)
    write_whole_file(options.out / CARD, card.to_markdown().encode())
    return card


def _make_geometry(
    net: nn.Module,
    datasets: Sequence[Path],
    config: TrainConfig,
    options: RunOptions,
    prepared: Progress,
) -> tuple[OccupancyTraining, TrainingData]:
    """Prepares the items of the datasets, and trains on those."""
    if isinstance(net, WindowedNet) and not config.weights:
        raise TrainingError(
            "a windowed network needs weights of a compact one, which answers "
            "where nothing of the target is seen: train that first, and give "
            "its file by --weights"
        )
    cache = options.cache or options.out / "cache"
    share = config.validation_share
    jobs = plan(
        datasets, cache, config.prepare, share, incomplete=options.incomplete
    )
    for done in prepare(jobs, config.prepare, share, workers=options.workers):
        prepared(done, len(jobs))
    files = [path for _, path in jobs]
    if isinstance(net, WindowedNet):
        windows = WindowedData(files, config, devices=options.devices)
        return WindowedTraining(net, config, windows.steps), windows
    data = TrainingData(
        *open_items(files, config), config, workers=1, devices=options.devices
    )
    return CompactTraining(net, config, data.steps), data


def _make_paper(
    net: nn.Module,
    datasets: Sequence[Path],
    config: TrainConfig,
    options: RunOptions,
    prepared: Progress,
) -> tuple[OccupancyTraining, TrainingData]:
    """Trains on the datasets as they are."""
    # What is resumed has its weights in the checkpoint.
    if config.backbone and not options.resume:
        load_backbone(net, Path(config.backbone))
    data = TrainingData(
        *paper_items(datasets, config, incomplete=options.incomplete),
        config,
        workers=options.workers,
        devices=options.devices,
    )
    mean = input_mean(data.train_items, config)
    return PaperTraining(net, config, data.steps, mean), data


_MAKERS: Mapping[str, Callable[..., tuple[OccupancyTraining, TrainingData]]] = {
    "compact": _make_geometry,
    "windowed": _make_geometry,
    "fcn_resnet50": _make_paper,
}
"""By architecture: what trains the network, and the data."""


def _fit(
    trainer: lightning.Trainer,
    module: OccupancyTraining,
    data: TrainingData,
    options: RunOptions,
) -> None:
    """Trains to the end, and validates.

    Raises:
        TrainingError: the checkpoint is damaged.
        KeyboardInterrupt: as it was pressed.
    """
    path = options.out / CHECKPOINT if options.resume else None
    if path is not None:
        try:
            torch.load(path, map_location="cpu", weights_only=True)
        except (RuntimeError, IndexError, EOFError, UnpicklingError) as error:
            reason = " ".join(str(error).split())
            raise TrainingError(
                f"{path} is damaged ({reason}): take best.ckpt in its place, "
                "or begin anew in another folder"
            ) from error
    with warnings.catch_warnings():
        # One process reads; more would take the trainer's cores.
        warnings.filterwarnings("ignore", ".*does not have many workers.*")
        # The manifest is there before the first checkpoint.
        warnings.filterwarnings("ignore", ".*Checkpoint directory.*")
        try:
            trainer.fit(
                module,
                data,
                ckpt_path=str(path) if path else None,
                weights_only=True,
            )
            if "validation/iou" not in trainer.callback_metrics:
                # A run that was complete when it was taken up.
                trainer.validate(module, data, verbose=False)
        except SystemExit:
            # So the trainer answers Ctrl-C.
            raise KeyboardInterrupt from None


def _open_run(
    datasets: Sequence[Path], config: TrainConfig, options: RunOptions
) -> None:
    """Checks that a run may begin or go on, and writes its manifest."""
    out = options.out
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
    manifests = [read_manifest(dataset) for dataset in datasets]
    settings = {
        **asdict(config),
        "datasets": [manifest.fingerprint() for manifest in manifests],
    }
    now = provenance(config)
    if options.resume:
        kept = {k: v for k, v in settings.items() if k not in _FREE}
        check_resumable(out, now, settings=kept, mix=options.mix)
    if _is_first():
        scenarios = "---\n".join(manifest.scenario for manifest in manifests)
        run = Run("train", now, scenarios, [config.seed], settings)
        record_run(out, run, resumed=options.resume)


def _trainer(
    config: TrainConfig, options: RunOptions, epochs: int, steps: int
) -> lightning.Trainer:
    best = ModelCheckpoint(
        dirpath=options.out,
        filename="best",
        monitor="validation/iou",
        mode="max",
        enable_version_counter=False,
    )
    # One of its own: "save_last" saves only what is also the best.
    last = ModelCheckpoint(
        dirpath=options.out,
        filename=Path(CHECKPOINT).stem,
        enable_version_counter=False,
    )
    callbacks: list[lightning.Callback] = [best, last]
    if options.progress:
        callbacks.append(RichProgressBar())
    return lightning.Trainer(
        max_epochs=epochs,
        accelerator=options.accelerator,
        devices=options.devices,
        precision=config.precision,  # type: ignore[arg-type]
        # A folder for each start: a logger deletes what it finds.
        logger=CSVLogger(options.out, name="logs"),
        callbacks=callbacks,
        enable_progress_bar=options.progress,
        enable_model_summary=False,
        log_every_n_steps=max(1, min(_LOG_EVERY, steps // _FEWEST_LOGGED)),
        num_sanity_val_steps=0,
        # The data share themselves out.
        use_distributed_sampler=False,
    )
