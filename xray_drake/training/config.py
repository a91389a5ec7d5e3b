"""What a training run is: read from YAML, every key known."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from xray_drake.resources import models_dir
from xray_drake.training.prepare import PrepareConfig


class TrainingError(ValueError):
    """A run that cannot be made: what, where, what to do."""


@dataclass
class TrainConfig:
    """A training run; see ``models/training/*.yaml``."""

    name: str = "compact"
    # "compact" or "fcn_resnet50".
    architecture: str = "compact"
    # Its constructor's arguments.
    options: dict[str, Any] = field(default_factory=dict)
    # "geometry" (heights, the target's size; prepared once), or
    # "augmented_depth", the paper's (section IV.A).
    input: str = "geometry"
    # Samples of these targets alone; all if empty.
    targets: list[str] = field(default_factory=list)
    # Items of virtual targets, too ("geometry" only).
    virtual: bool = True
    # Share of the heaps that is held out for validation.
    validation_share: float = 0.05
    # Passes over the items. One of the trainer's epochs is a part of a pass,
    # so that a run that is killed loses little.
    passes: float = 3.0
    items_per_epoch: int = 6000
    batch_size: int = 16
    # "adamw" with a cosine schedule, or "sgd" at a constant rate.
    optimizer: str = "adamw"
    learning_rate: float = 2e-3
    momentum: float = 0.9
    weight_decay: float = 0.01
    # Share of the steps over which the rate rises ("adamw").
    warmup: float = 0.03
    # "robust": smooth L1 and cross entropy, see ``training.losses``; or "mse",
    # the paper's, the mean over all pixels.
    loss: str = "robust"
    # Weight of the second answer's loss, the posterior; 0 does without.
    posterior_weight: float = 1.0
    # Lightning's name: "32-true", "bf16-mixed", ...
    precision: str = "bf16-mixed"
    seed: int = 0
    prepare: PrepareConfig = field(default_factory=PrepareConfig)


def load_config(name: str) -> TrainConfig:
    """Reads a configuration.

    Args:
        name: of one in ``models/training``, or a YAML file.

    Raises:
        TrainingError: there is none, or something in it is unknown or wrong.
    """
    folder = models_dir() / "training"
    path = Path(name) if name.endswith((".yaml", ".yml")) else None
    path = path or folder / f"{name}.yaml"
    if not path.is_file():
        names = ", ".join(sorted(p.stem for p in folder.glob("*.yaml")))
        raise TrainingError(
            f"no training configuration {path}: give a YAML file or one of "
            f"{names}"
        )
    try:
        merged = OmegaConf.merge(
            OmegaConf.structured(TrainConfig), OmegaConf.load(path)
        )
        config = OmegaConf.to_object(merged)
    except (OmegaConfBaseException, YAMLError, OSError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise TrainingError(f"{path}: {reason}") from error
    assert isinstance(config, TrainConfig)
    _check(config, path)
    return config


def _check(config: TrainConfig, path: Path) -> None:
    choices = {
        "architecture": ("compact", "fcn_resnet50"),
        "input": ("geometry", "augmented_depth"),
        "optimizer": ("adamw", "sgd"),
        "loss": ("robust", "mse"),
    }
    for key, allowed in choices.items():
        value = getattr(config, key)
        if value not in allowed:
            raise TrainingError(
                f"{path}: {key} is {value!r}, not one of {', '.join(allowed)}"
            )
    wanted = {"compact": "geometry", "fcn_resnet50": "augmented_depth"}
    if config.input != wanted[config.architecture]:
        raise TrainingError(
            f"{path}: {config.architecture} takes the input "
            f"{wanted[config.architecture]}, not {config.input}"
        )
    for key in ("passes", "items_per_epoch", "batch_size", "learning_rate"):
        if getattr(config, key) <= 0:
            raise TrainingError(
                f"{path}: {key} is {getattr(config, key)}, not above 0"
            )
    if not 0 < config.validation_share < 1:
        raise TrainingError(
            f"{path}: validation_share is {config.validation_share}, not "
            "between 0 and 1"
        )
