"""What a training run is: read from YAML, every key known."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from xray_drake.choices import BOX_TARGETS
from xray_drake.configuration import (
    check,
    choice,
    configured,
    count,
    number,
    path_field,
)
from xray_drake.occupancy.learned.weights import INPUTS
from xray_drake.resources import models_dir
from xray_drake.training.prepare import PrepareConfig
from xray_drake.trees import ConfigurationError, read_text, read_tree

_OPTIMIZERS = ("adamw", "sgd")
_LOSSES = ("robust", "mse")
_PRECISIONS = (
    "32-true",
    "bf16-mixed",
    "16-mixed",
    "64-true",
    "bf16-true",
    "16-true",
)

_GEOMETRY: Mapping[str, Any] = {
    "input": "geometry",
    "loss": "robust",
    "label_scale": 1.0,
    "backbone": "",
}

_FIXED: Mapping[str, Mapping[str, Any]] = {
    "compact": _GEOMETRY,
    "windowed": _GEOMETRY,
    "fcn_resnet50": {
        "input": "augmented_depth",
        "loss": "mse",
        "virtual": False,
        "posterior_weight": 0.0,
    },
}
"""Each architecture, and what it leaves no choice of."""


class TrainingError(ValueError):
    """A run that cannot be made: what, where, what to do."""


@dataclass
class TrainConfig:
    """A training run; see ``models/training/*.yaml``."""

    name: str = "compact"
    # "compact"; "windowed", of which the part for windows is trained, and the
    # other is that of "weights"; or "fcn_resnet50".
    architecture: str = choice("compact", tuple(_FIXED))
    # Its constructor's arguments.
    options: dict[str, Any] = field(default_factory=dict)
    # "geometry" (heights, the target's size; prepared once), or
    # "augmented_depth", the paper's (section IV.A).
    input: str = choice("geometry", INPUTS)
    # Samples of these targets alone; all if empty. A network of a single box
    # is later used for other targets by scaling the image.
    targets: list[str] = field(default_factory=list)
    # Items of virtual targets, too ("geometry" only).
    virtual: bool = True
    # Share of the heaps that is held out for validation.
    validation_share: float = number(0.05, "(0, 1)")
    # Passes over the items. One of the trainer's epochs is a part of a pass,
    # so that a run that is killed loses little.
    passes: float = number(3.0, "(0, 1000000]")
    items_per_epoch: int = count(6000, "[1, 1000000000]")
    batch_size: int = count(16, "[1, 1000000]")
    # Mirror batches at random, left and right, up and down.
    flips: bool = True
    # "adamw" with a cosine schedule, or "sgd" at a constant rate.
    optimizer: str = choice("adamw", _OPTIMIZERS)
    learning_rate: float = number(2e-3, "(0, 10]")
    momentum: float = number(0.9, "[0, 1)")
    weight_decay: float = number(0.01, "[0, 10]")
    # Share of the steps over which the rate rises ("adamw").
    warmup: float = number(0.03, "[0, 1]")
    # "robust": smooth L1 and cross entropy, see ``training.losses``; or "mse",
    # the paper's, the mean over all pixels.
    loss: str = choice("robust", _LOSSES)
    # Weight of the cross entropy in "robust", a mean over the pixels: a window
    # has fewer of them that are empty.
    entropy_weight: float = number(2.0, "[0, 10000]")
    # Weight of pixels that are far off in "robust".
    miss_weight: float = number(0.0, "[0, 10000]")
    # What the label's 1 is to the "mse" (the paper's authors' labels are bytes,
    # so 255); a learning rate means nothing without it.
    label_scale: float = number(1.0, "(0, 1000000]")
    # The input's mean is that of so many training images, of all if there are
    # fewer ("augmented_depth" only).
    input_mean_images: int = count(1000, "[1, 1000000000]")
    # Weights of the same network to begin with, to train them further or on
    # other objects: a file of "xray-drake train". Drawn at random if empty.
    weights: str = path_field()
    # Weights that the ResNet-50 begins with: safetensors, with torchvision's
    # names. Drawn at random if empty.
    backbone: str = path_field()
    # Share of the steps after which the normalisation's means and variances
    # stay ("windowed"): one batch has windows of one size, inference of any.
    # Until then validation, which takes them, says less than the network can.
    freeze_norm: float = number(0.6, "[0, 1]")
    # Weight of the second answer's loss, the posterior; 0 does without.
    posterior_weight: float = number(1.0, "[0, 10000]")
    # One of Lightning's names.
    precision: str = choice("bf16-mixed", _PRECISIONS)
    seed: int = count(0, "[0, 4294967295]")
    prepare: PrepareConfig = field(default_factory=PrepareConfig)


def single_box(config: TrainConfig) -> str:
    """Names the one box that a network is to know; "" if it is not one box."""
    names = set(config.targets)
    return names.pop() if len(names) == 1 and names < set(BOX_TARGETS) else ""


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
        tree = read_tree(read_text(path), str(path))
        config = configured(TrainConfig, tree, str(path), folder=path.parent)
    except ConfigurationError as error:
        raise TrainingError(str(error)) from error
    check_config(config, str(path))
    return config


def check_config(config: TrainConfig, path: str) -> None:
    """Refuses what no run can be made of.

    Args:
        config: of a run.
        path: what messages begin with: where the configuration is from.

    Raises:
        TrainingError: one line that names the key.
    """
    try:
        check(config, path)
    except ConfigurationError as error:
        raise TrainingError(str(error)) from error
    for key, wanted in _FIXED[config.architecture].items():
        value = getattr(config, key)
        if value != wanted:
            raise TrainingError(
                f"{path}: {config.architecture} takes the {key} "
                f"{_text(wanted)}, not {_text(value)}"
            )
    if config.weights and config.backbone:
        raise TrainingError(
            f"{path}: both weights and a backbone are given to begin with: "
            "leave one out"
        )
    if config.items_per_epoch < config.batch_size:
        raise TrainingError(
            f"{path}: items_per_epoch is {config.items_per_epoch}, less than "
            f"the batch_size, {config.batch_size}"
        )
    single, prepare = single_box(config), config.prepare
    virtual = config.virtual and prepare.virtual
    if single and virtual and not prepare.virtual_size:
        raise TrainingError(
            f"{path}: a network of {single} alone takes no virtual targets of "
            "other sizes: give prepare.virtual_size, or virtual: false"
        )


def _text(value: object) -> str:
    return value if value and isinstance(value, str) else repr(value)
