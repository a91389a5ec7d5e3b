import re
from pathlib import Path

import pytest

from xray_drake.dataset.augmentation import DepthNoise
from xray_drake.occupancy.learned.build import build_network
from xray_drake.resources import models_dir
from xray_drake.training.config import (
    TrainConfig,
    TrainingError,
    load_config,
)
from xray_drake.training.prepare import PrepareConfig

SHIPPED = sorted(p.stem for p in (models_dir() / "training").glob("*.yaml"))


PAPER = """architecture: fcn_resnet50
input: augmented_depth
loss: mse
virtual: false
posterior_weight: 0.0"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "mine.yaml"


def message(name: Path | str) -> str:
    with pytest.raises(TrainingError) as error:
        load_config(str(name))
    text = str(error.value)
    assert "\n" not in text
    assert str(name) in text
    return text


@pytest.mark.parametrize("name", SHIPPED)
def test_what_is_shipped_can_be_read(name: str) -> None:
    assert "compact" in SHIPPED
    config = load_config(name)
    assert config.name
    by_path = load_config(str(models_dir() / "training" / f"{name}.yaml"))
    assert by_path == config
    net = build_network(config.architecture, config.options)
    if not name.endswith("to1"):
        return
    # Those of a single box have that box, and are small.
    ratio = int(name.removeprefix("compact_").removesuffix("to1"))
    assert config.targets == [f"box_{ratio}to1"]
    sides = [0.03 * ratio**0.5, 0.03 / ratio**0.5, 0.005]
    assert config.prepare.virtual_size == pytest.approx(sides, abs=1e-5)
    assert sum(p.numel() for p in net.parameters()) < 500_000


def test_what_is_not_given_is_the_default(path: Path) -> None:
    path.write_text("")
    assert load_config(str(path)) == TrainConfig()
    path.write_text(
        "name: mine\npasses: 2\noptions: {widths: [8, 8, 8, 8]}\n"
        "prepare: {virtual: 1, noise: {sigma: 0.001}}\ntargets: [lid, flute]\n"
    )
    assert load_config(str(path)) == TrainConfig(
        name="mine",
        passes=2.0,
        options={"widths": [8, 8, 8, 8]},
        prepare=PrepareConfig(virtual=1, noise=DepthNoise(sigma=0.001)),
        targets=["lid", "flute"],
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("pases: 3", "unknown key pases; did you mean passes"),
        ("prepare: {noise: {sigmas: 1}}", "unknown key prepare.noise.sigmas"),
        ("prepare: {labels: known}", "'known': choose one of given, expected"),
        ("architecture: unet", "architecture is 'unet': choose one of compact"),
        ("input: color", "input is 'color': choose one of geometry"),
        ("optimizer: adam", "optimizer is 'adam': choose one of adamw, sgd"),
        ("loss: l1", "loss is 'l1': choose one of robust, mse"),
        ("precision: half", "precision is 'half': choose one of 32-true"),
        ("passes: 0", "passes is 0: it must be above 0"),
        ("validation_share: 1.0", "validation_share is 1.0: .* below 1"),
        ("seed: 4294967296", "seed is 4294967296: .* to 4294967295"),
        ("prepare: {virtual_size: [0.1, 0.1]}", "must be 0 or 3 numbers, not"),
        ("items_per_epoch: 8\nbatch_size: 9", "items_per_epoch is 8, less"),
        ("weights: a\nbackbone: b\n" + PAPER, "both weights and a backbone"),
        # What an architecture leaves no choice of.
        ("input: augmented_depth", "compact takes the input geometry"),
        ("label_scale: 255", "compact takes the label_scale 1.0, not 255.0"),
        ("backbone: a.pt", r"compact takes the backbone '', not .*a\.pt"),
        ("loss: mse", "compact takes the loss robust, not mse"),
        ("architecture: fcn_resnet50", "takes the input augmented_depth"),
        (PAPER.replace("mse", "robust"), "takes the loss mse, not robust"),
        (PAPER.replace("virtual: false", ""), "takes the virtual False, not"),
        ("targets: [box_2to1]", "no virtual targets of other sizes"),
    ],
)
def test_what_is_wrong_is_one_line(path: Path, text: str, words: str) -> None:
    path.write_text(text + "\n")
    assert re.search(words, message(path))


def test_paths_are_relative_to_the_file(path: Path) -> None:
    for given, found in (
        ("a.safetensors", str(path.parent / "a.safetensors")),
        ("/a.safetensors", "/a.safetensors"),
    ):
        path.write_text(f"weights: {given}\nbackbone: ''\n")
        config = load_config(str(path))
        assert (config.weights, config.backbone) == (found, "")


def test_a_missing_file_says_what_there_is(path: Path) -> None:
    assert "no training configuration" in message(path)
    assert message("gone").endswith(f"one of {', '.join(SHIPPED)}")
    path.write_bytes(b"\xff\xfe\x00name")
    assert "cannot read" in message(path)
