import re
from pathlib import Path

import pytest

from xray_drake.resources import models_dir
from xray_drake.training.config import (
    TrainConfig,
    TrainingError,
    load_config,
)

SHIPPED = sorted(p.stem for p in (models_dir() / "training").glob("*.yaml"))


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


def test_what_is_not_given_is_the_default(path: Path) -> None:
    path.write_text("")
    assert load_config(str(path)) == TrainConfig()
    path.write_text(
        "name: mine\nseed: 7\npasses: 2\noptions: {widths: [8, 8, 8, 8]}\n"
        "prepare: {virtual: 1, noise: {sigma: 0.001}}\ntargets: [lid, flute]\n"
    )
    config = load_config(str(path))
    expected = TrainConfig(name="mine", seed=7, passes=2.0)
    assert config.prepare.virtual == 1
    assert config.prepare.noise.sigma == 0.001
    assert config.prepare.noise.speckle == expected.prepare.noise.speckle
    assert config.prepare.seed == expected.prepare.seed
    assert config.options == {"widths": [8, 8, 8, 8]}
    assert config.targets == ["lid", "flute"]
    assert type(config.targets) is list
    assert type(config.options["widths"]) is list
    for key in ("name", "seed", "passes", "batch_size", "precision"):
        assert getattr(config, key) == getattr(expected, key)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("pases: 3", "unknown key pases; did you mean passes"),
        ("prepare: {noise: {sigmas: 1}}", "unknown key prepare.noise.sigmas"),
        ("passes: many", "passes is 'many': it must be a number"),
        ("prepare: null", "prepare is None: it must be keys and values"),
        ("name: a\nname: b", "the key 'name' stands twice"),
        ("- name: mine", "top level must be keys and values, not list"),
        (
            "prepare: {labels: known}",
            "prepare.labels is 'known': choose one of given, expected",
        ),
        ("architecture: unet", "architecture is 'unet': choose one of compact"),
        ("input: color", "input is 'color': choose one of geometry"),
        ("optimizer: adam", "optimizer is 'adam': choose one of adamw, sgd"),
        ("loss: l1", "loss is 'l1': choose one of robust, mse"),
        ("precision: half", "precision is 'half': choose one of 32-true"),
        ("passes: 0", "passes is 0: it must be above 0"),
        ("passes: .inf", "passes is inf: it must be above 0"),
        ("learning_rate: 1e400", "learning_rate is inf: it must be above 0"),
        ("validation_share: 1.0", "validation_share is 1.0: .* below 1"),
        ("seed: 4294967296", "seed is 4294967296: .* to 4294967295"),
        ("label_scale: 0", "label_scale is 0: it must be above 0"),
        (
            "prepare: {noise: {sigma: .nan}}",
            "prepare.noise.sigma is nan: it must be from 0",
        ),
        (
            "prepare: {virtual_size: [0.1, 0.1]}",
            "prepare.virtual_size is .*: it must be 0 or 3 numbers, not 2",
        ),
        ("items_per_epoch: 8\nbatch_size: 9", "items_per_epoch is 8, less"),
        # What an architecture leaves no choice of.
        ("input: augmented_depth", "compact takes the input geometry"),
        ("label_scale: 255", "compact takes the label_scale 1.0, not 255.0"),
        (
            "backbone: a.safetensors",
            r"compact takes the backbone '', not .*a\.safetensors",
        ),
        ("loss: mse", "compact takes the loss robust, not mse"),
        ("architecture: fcn_resnet50", "takes the input augmented_depth"),
        (
            "{architecture: fcn_resnet50, input: augmented_depth}",
            "fcn_resnet50 takes the loss mse, not robust",
        ),
        (
            "{architecture: fcn_resnet50, input: augmented_depth, loss: mse}",
            "fcn_resnet50 takes the virtual False, not True",
        ),
        ("targets: [box_2to1]", "no virtual targets of other sizes"),
    ],
)
def test_what_is_wrong_is_one_line(path: Path, text: str, words: str) -> None:
    path.write_text(text + "\n")
    assert re.search(words, message(path))


def test_paths_are_relative_to_the_file(path: Path) -> None:
    path.write_text("weights: a.safetensors\n")
    assert load_config(str(path)).weights == str(path.parent / "a.safetensors")
    path.write_text("weights: /a.safetensors\n")
    assert load_config(str(path)).weights == "/a.safetensors"
    path.write_text("")
    assert load_config(str(path)).weights == ""


def test_what_is_no_text_is_one_line(path: Path) -> None:
    path.write_bytes(b"\xff\xfe\x00name")
    message(path)


def test_reading_runs_no_code(path: Path, tmp_path: Path) -> None:
    witness = tmp_path / "witness"
    path.write_text(f"name: !!python/object/apply:os.mkdir ['{witness}']\n")
    message(path)
    assert not witness.exists()


def test_a_missing_file_says_what_there_is(tmp_path: Path) -> None:
    assert "no training configuration" in message(tmp_path / "gone.yaml")
    text = message("gone")
    assert text.endswith(f"one of {', '.join(SHIPPED)}")
    with pytest.raises(TrainingError):
        load_config(str(tmp_path))
