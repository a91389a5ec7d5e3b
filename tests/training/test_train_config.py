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
        ("pases: 3", "'pases' not in 'TrainConfig'"),
        ("prepare: {nois: 1}", "'nois' not in 'PrepareConfig'"),
        ("prepare: {noise: {sigmas: 1}}", "'sigmas' not in 'DepthNoise'"),
        ("passes: many", "'many' of type 'str'.* Float .*passes"),
        ("batch_size: 1.5", "'1.5' of type 'float'.* Integer .*batch_size"),
        ("virtual: maybe", "'maybe' is not a valid bool.*virtual"),
        ("targets: lid", "targets"),
        ("options: 5", "int .*options"),
        ("passes: null", "None.*passes"),
        ("prepare: 3", "PrepareConfig"),
        (
            "prepare: {labels: known}",
            "prepare.labels is 'known', not one of given, expected",
        ),
        ("architecture: unet", "architecture is 'unet', not one of compact"),
        ("input: color", "input is 'color', not one of geometry"),
        ("optimizer: adam", "optimizer is 'adam', not one of adamw, sgd"),
        ("loss: l1", "loss is 'l1', not one of robust, mse"),
        ("input: augmented_depth", "compact takes the input geometry"),
        ("architecture: fcn_resnet50", "takes the input augmented_depth"),
        ("passes: 0", "passes is 0.0, not above 0"),
        ("items_per_epoch: -1", "items_per_epoch is -1, not above 0"),
        ("batch_size: 0", "batch_size is 0, not above 0"),
        ("learning_rate: -0.1", "learning_rate is -0.1, not above 0"),
        ("learning_rate: .nan", "learning_rate is nan, not above 0"),
        ("validation_share: 0", "validation_share is 0.0, not between 0"),
        ("validation_share: 1.0", "validation_share is 1.0, not between 0"),
        ("items_per_epoch: 8\nbatch_size: 9", "items_per_epoch is 8, less"),
        ("name: [", "mine.yaml"),
        ("name: a\nname: b", "duplicate key name"),
        ("name: ${nothing}", "'nothing' not found"),
        ("5", "int"),
    ],
)
def test_what_is_wrong_is_one_line(path: Path, text: str, words: str) -> None:
    path.write_text(text + "\n")
    assert re.search(words, message(path))


def test_a_list_is_no_configuration(path: Path) -> None:
    path.write_text("- name: mine\n")
    message(path)


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
