"""What a training run is: read from YAML, every key known."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from xray_drake.choices import BOX_TARGETS
from xray_drake.occupancy.networks.weights import INPUTS
from xray_drake.resources import models_dir
from xray_drake.training.prepare import LABELS, PrepareConfig

_OPTIMIZERS = ("adamw", "sgd")
_LOSSES = ("robust", "mse")

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
    architecture: str = "compact"
    # Its constructor's arguments.
    options: dict[str, Any] = field(default_factory=dict)
    # "geometry" (heights, the target's size; prepared once), or
    # "augmented_depth", the paper's (section IV.A).
    input: str = "geometry"
    # Samples of these targets alone; all if empty. A network of a single box
    # is later used for other targets by scaling the image.
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
    # Mirror batches at random, left and right, up and down.
    flips: bool = True
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
    # Weight of the cross entropy in "robust", a mean over the pixels: a window
    # has fewer of them that are empty.
    entropy_weight: float = 2.0
    # Weight of pixels that are far off in "robust".
    miss_weight: float = 0.0
    # What the label's 1 is to the "mse" (the paper's authors' labels are bytes,
    # so 255); a learning rate means nothing without it.
    label_scale: float = 1.0
    # The input's mean is that of so many training images, of all if there are
    # fewer ("augmented_depth" only).
    input_mean_images: int = 1000
    # Weights of the same network to begin with, to train them further or on
    # other objects: a file of "xray-drake train". Drawn at random if empty.
    weights: str = ""
    # Weights that the ResNet-50 begins with: safetensors, with torchvision's
    # names. Drawn at random if empty.
    backbone: str = ""
    # Share of the steps after which the normalisation's means and variances
    # stay ("windowed"): one batch has windows of one size, inference of any.
    # Until then validation, which takes them, says less than the network can.
    freeze_norm: float = 0.6
    # Weight of the second answer's loss, the posterior; 0 does without.
    posterior_weight: float = 1.0
    # Lightning's name: "32-true", "bf16-mixed", ...
    precision: str = "bf16-mixed"
    seed: int = 0
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
        merged = OmegaConf.merge(
            OmegaConf.structured(TrainConfig), OmegaConf.load(path)
        )
        config = OmegaConf.to_object(merged)
    except (
        OmegaConfBaseException,
        YAMLError,
        OSError,
        TypeError,
        ValueError,
    ) as error:
        reason = " ".join(str(error).split())
        raise TrainingError(f"{path}: {reason}") from error
    assert isinstance(config, TrainConfig)
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
    for key, value, allowed in (
        ("architecture", config.architecture, tuple(_FIXED)),
        ("input", config.input, INPUTS),
        ("optimizer", config.optimizer, _OPTIMIZERS),
        ("loss", config.loss, _LOSSES),
        ("prepare.labels", config.prepare.labels, LABELS),
    ):
        if value not in allowed:
            raise TrainingError(
                f"{path}: {key} is {value!r}, not one of {', '.join(allowed)}"
            )
    for key in (
        "passes",
        "items_per_epoch",
        "batch_size",
        "learning_rate",
        "label_scale",
        "input_mean_images",
    ):
        if not 0 < getattr(config, key) < math.inf:
            raise TrainingError(
                f"{path}: {key} is {getattr(config, key)}, not above 0 and "
                "finite"
            )
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
    if not 0 < config.validation_share < 1:
        raise TrainingError(
            f"{path}: validation_share is {config.validation_share}, not "
            "between 0 and 1"
        )
    _check_virtual(config, path)


def _check_virtual(config: TrainConfig, path: str) -> None:
    size = config.prepare.virtual_size
    if size and not (len(size) == 3 and all(side > 0 for side in size)):
        raise TrainingError(
            f"{path}: prepare.virtual_size is {size}, not a box's length, "
            "width and thickness in m"
        )
    single = single_box(config)
    if single and config.virtual and config.prepare.virtual and not size:
        raise TrainingError(
            f"{path}: a network of {single} alone takes no virtual targets of "
            "other sizes: give prepare.virtual_size, or virtual: false"
        )


def _text(value: object) -> str:
    return value if value and isinstance(value, str) else repr(value)
