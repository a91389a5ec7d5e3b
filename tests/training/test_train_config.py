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
        ("prepare: {nois: 1}", "unknown key prepare.nois"),
        ("prepare: {noise: {sigmas: 1}}", "unknown key prepare.noise.sigmas"),
        ("passes: many", "passes is 'many': it must be a number"),
        ("passes: true", "passes is True: it must be a number"),
        ("passes: '3'", "passes is '3': it must be a number"),
        ("batch_size: 1.5", "batch_size is 1.5: it must be a whole number"),
        ("batch_size: true", "batch_size is True: it must be a whole number"),
        ("virtual: maybe", "virtual is 'maybe': it must be true or false"),
        ("virtual: 1", "virtual is 1: it must be true or false"),
        ("name: 3", "name is 3: it must be text"),
        ("targets: lid", "targets is 'lid': it must be a list"),
        ("targets: [3]", r"targets\[0\] is 3: it must be text"),
        ("options: 5", "options is 5: it must be keys and values"),
        ("passes: null", "passes is None: it must be a number"),
        ("prepare: 3", "prepare is 3: it must be keys and values"),
        ("prepare: null", "prepare is None: it must be keys and values"),
        (
            "prepare: {labels: known}",
            "prepare.labels is 'known': choose one of given, expected",
        ),
        ("architecture: unet", "architecture is 'unet': choose one of compact"),
        ("input: color", "input is 'color': choose one of geometry"),
        ("optimizer: adam", "optimizer is 'adam': choose one of adamw, sgd"),
        ("loss: l1", "loss is 'l1': choose one of robust, mse"),
        ("precision: half", "precision is 'half': choose one of 32-true"),
        ("input: augmented_depth", "compact takes the input geometry"),
        ("architecture: fcn_resnet50", "takes the input augmented_depth"),
        ("passes: 0", "passes is 0: it must be above 0"),
        ("items_per_epoch: -1", "items_per_epoch is -1: it must be from 1"),
        ("batch_size: 0", "batch_size is 0: it must be from 1"),
        ("learning_rate: -0.1", "learning_rate is -0.1: it must be above 0"),
        ("learning_rate: .nan", "learning_rate is nan: it must be above 0"),
        ("learning_rate: 1e400", "learning_rate is inf: it must be above 0"),
        ("validation_share: 0", "validation_share is 0: it must be above 0"),
        ("validation_share: 1.0", "validation_share is 1.0: .* below 1"),
        ("momentum: 1", "momentum is 1: it must be at least 0 and below 1"),
        ("warmup: 2", "warmup is 2: it must be from 0 to 1"),
        ("miss_weight: -1", "miss_weight is -1: it must be from 0"),
        ("seed: -1", "seed is -1: it must be from 0"),
        ("seed: 4294967296", "seed is 4294967296: .* to 4294967295"),
        ("prepare: {noisy: 1.5}", "prepare.noisy is 1.5: it must be from 0"),
        ("prepare: {virtual: -1}", "prepare.virtual is -1: it must be from 0"),
        (
            "prepare: {noise: {sigma: .nan}}",
            "prepare.noise.sigma is nan: it must be from 0",
        ),
        (
            "prepare: {virtual_size: [0.1, 0.1]}",
            "prepare.virtual_size is .*: it must be 0 or 3 numbers, not 2",
        ),
        (
            "prepare: {virtual_size: [0.1, 0.1, 0]}",
            "prepare.virtual_size is .*: each must be above 0",
        ),
        ("items_per_epoch: 8\nbatch_size: 9", "items_per_epoch is 8, less"),
        ("name: [", "mine.yaml"),
        ("name: a\nname: b", "the key 'name' stands twice"),
        ("5", "top level must be keys and values, not int"),
    ],
)
def test_what_is_wrong_is_one_line(path: Path, text: str, words: str) -> None:
    path.write_text(text + "\n")
    assert re.search(words, message(path))


def test_a_list_is_no_configuration(path: Path) -> None:
    path.write_text("- name: mine\n")
    message(path)


def test_paths_are_relative_to_the_file(path: Path) -> None:
    path.write_text("weights: a.safetensors\n")
    assert load_config(str(path)).weights == str(path.parent / "a.safetensors")
    path.write_text("weights: /a.safetensors\n")
    assert load_config(str(path)).weights == "/a.safetensors"
    path.write_text("")
    assert load_config(str(path)).weights == ""


@pytest.mark.parametrize("key", ["passes", "learning_rate"])
def test_nothing_is_infinite(path: Path, key: str) -> None:
    path.write_text(f"{key}: .inf\n")
    assert key in message(path)


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
