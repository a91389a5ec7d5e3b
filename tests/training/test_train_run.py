import csv
import dataclasses
import itertools
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import typer
from typer.testing import CliRunner

from tests.dataset.conftest import synthetic_sample
from tests.dataset.whole import tiny_dataset
from xray_drake.cli.train import train as train_command
from xray_drake.dataset.manifest import (
    read_manifest,
    write_manifest,
)
from xray_drake.dataset.reader import is_held_out
from xray_drake.dataset.shards import ForeignShardError
from xray_drake.files import InUseError, sole_writer
from xray_drake.occupancy.learned.inference import load_inference
from xray_drake.occupancy.learned.weights import (
    NetworkCard,
    WeightsError,
    load_weights,
    read_card,
)
from xray_drake.provenance import MANIFEST, ManifestError, read_runs
from xray_drake.training.config import TrainConfig, TrainingError
from xray_drake.training.losses import OccupancyMetrics
from xray_drake.training.module import CompactTraining
from xray_drake.training.prepare import PrepareConfig, plan, prepare_shard
from xray_drake.training.run import CARD, CHECKPOINT, WEIGHTS, RunOptions, train
from xray_drake.training.windows import WindowedData, WindowedTraining

pytestmark = [
    pytest.mark.filterwarnings(f"ignore:{text}")
    for text in (
        "Checkpoint directory",
        "Experiment logs directory",
        "The number of training batches",
        ".*treespec, LeafSpec",
    )
]

ABSENT = "mps" if torch.backends.cuda.is_built() else "gpu"
SHAPE = (64, 96)
HEAPS = 8
SHARE = 0.3
STEPS = 9

CONFIG = TrainConfig(
    name="tiny",
    options={"widths": [8, 8, 8, 8], "depths": [1, 1, 1, 1]},
    validation_share=SHARE,
    # 3 epochs of 3 steps.
    passes=36 / 12,
    items_per_epoch=12,
    batch_size=4,
    precision="32-true",
    prepare=PrepareConfig(virtual=1),
)

YAML = f"""
name: tiny
options: {{widths: [8, 8, 8, 8], depths: [1, 1, 1, 1]}}
validation_share: {SHARE}
passes: 1.0
items_per_epoch: 12
batch_size: 4
precision: 32-true
prepare: {{virtual: 1}}
"""


def _write(folder: Path, heaps: list[int]) -> Path:
    folder.mkdir()
    return tiny_dataset(
        folder,
        lambda i: synthetic_sample(
            heaps[i], cover=(0.4, 1.0)[heaps[i] % 2], shape=SHAPE
        ),
        len(heaps),
        shard_size=len(heaps),
        seed=5,
    )


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("training") / "dataset"
    return _write(folder, list(range(HEAPS)))


@pytest.fixture(scope="module")
def cache(dataset: Path) -> Path:
    """Items are prepared, so that no run starts processes for it."""
    folder = dataset.parent / "cache"
    folder.mkdir()
    for job in plan([dataset], folder, CONFIG.prepare, SHARE):
        prepare_shard(*job, CONFIG.prepare, SHARE)
    return folder


_Run = Callable[..., NetworkCard]


@pytest.fixture(scope="module")
def run(dataset: Path, cache: Path) -> _Run:
    """Trains in a folder."""

    def run(out: Path, *, resume: bool = False, **change: Any) -> NetworkCard:
        return train(
            [dataset],
            dataclasses.replace(CONFIG, **change),
            RunOptions(
                out=out,
                resume=resume,
                cache=cache,
                accelerator="cpu",
                progress=False,
            ),
        )

    return run


@pytest.fixture(scope="module")
def whole(run: _Run, dataset: Path) -> tuple[Path, NetworkCard]:
    """A run from beginning to end; not to be changed."""
    out = dataset.parent / "whole"
    return out, run(out)


def _same_weights(one: Path, other: Path) -> bool:
    first, second = (
        load_weights(one / WEIGHTS)[0],
        load_weights(other / WEIGHTS)[0],
    )
    assert first.keys() == second.keys()
    return all(torch.equal(first[name], second[name]) for name in first)


def _steps_of(checkpoint: Path) -> int:
    return torch.load(checkpoint, weights_only=True)["global_step"]


def test_a_run_writes_weights_that_inference_takes(
    whole: tuple[Path, NetworkCard], dataset: Path
) -> None:
    out, card = whole
    state, stored = load_weights(out / WEIGHTS)
    assert stored == card
    # They saw every step.
    (seen,) = {
        int(tensor)
        for name, tensor in state.items()
        if name.endswith("num_batches_tracked")
    }
    assert seen == STEPS
    sample = synthetic_sample(1, shape=SHAPE)
    for output in ("occupancy", "posterior"):
        inference = load_inference(
            out / WEIGHTS,
            target_size=sample.target_size,
            output=output,  # type: ignore[arg-type]
        )
        answer = inference.infer(
            sample.depth, sample.target_modal, sample.camera
        )
        assert answer.data.shape == SHAPE
        assert 0 < answer.data.max() <= 1


def test_a_short_run_logs_every_loss(whole: tuple[Path, NetworkCard]) -> None:
    (log,) = (whole[0] / "logs").glob("*/metrics.csv")
    with log.open(newline="", encoding="utf-8") as file:
        losses = [row["train/loss"] for row in csv.DictReader(file)]
    assert len([loss for loss in losses if loss]) == STEPS


def test_the_card_says_what_was_trained_on_what(
    whole: tuple[Path, NetworkCard],
) -> None:
    out, card = whole
    assert card.architecture == "compact"
    assert card.input == "geometry"
    assert card.options == CONFIG.options
    assert card.targets == ("box_2to1",)
    assert card.box_size is None
    (told,) = card.data["datasets"]
    assert told["seed"] == 5
    assert card.data["images used"] == HEAPS
    assert told["scenario"] == "name: tiny\n"
    out_of = card.data["items to train on"] + card.data["items held out"]
    held_out = sum(is_held_out(heap, SHARE) for heap in range(HEAPS))
    assert held_out <= card.data["items held out"] <= 2 * held_out
    assert HEAPS < out_of <= 2 * HEAPS
    assert card.training["seed"] == 0
    versions = card.training["provenance"]["versions"]
    assert versions["lightning"] == version("lightning")
    assert card.training["optimizer steps"] == STEPS
    assert card.training["prepare"]["virtual"] == 1
    (figures,) = card.figures.values()
    for name in ("loss", "iou", "balanced_accuracy", "mass_on_target"):
        assert np.isfinite(figures[f"validation/{name}"])
    page = (out / CARD).read_text(encoding="utf-8")
    assert page == card.to_markdown()


def test_it_learns(run: _Run, dataset: Path, tmp_path: Path) -> None:
    found = []
    for passes in (0.1, 40.0):
        out = tmp_path / str(passes)
        card = run(out, passes=passes, learning_rate=0.01, items_per_epoch=60)
        (figures,) = card.figures.values()
        found.append(figures)
    first, last = found
    assert last["validation/loss"] < 0.7 * first["validation/loss"]
    assert last["validation/iou"] > first["validation/iou"] + 0.05
    mass = "validation/mass_on_target"
    assert last[mass] > first[mass] + 0.3


def test_a_seed_decides_the_weights(
    run: _Run, whole: tuple[Path, NetworkCard], tmp_path: Path
) -> None:
    again = run(tmp_path / "again")
    assert _same_weights(whole[0], tmp_path / "again")
    assert again.figures == whole[1].figures
    run(tmp_path / "other", seed=1)
    assert not _same_weights(whole[0], tmp_path / "other")


class Killed(BaseException):
    """Nothing catches it."""


def _killed(
    run: _Run,
    out: Path,
    monkeypatch: pytest.MonkeyPatch,
    *,
    epoch: int,
    training: Any = CompactTraining,
    **change: Any,
) -> None:
    """Begins a run, which ends in the midst of an epoch."""
    step = training.training_step

    def training_step(self: Any, batch: Any, index: int) -> Any:
        if self.current_epoch == epoch and index == 1:
            raise Killed
        return step(self, batch, index)

    with monkeypatch.context() as patch:
        patch.setattr(training, "training_step", training_step)
        with pytest.raises(Killed):
            run(out, **change)
    assert not (out / WEIGHTS).exists()


@pytest.fixture
def worse_and_worse(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first epoch stays the best."""
    numbers = itertools.count(1)
    monkeypatch.setattr(
        OccupancyMetrics, "compute", lambda _: {"iou": 1.0 / next(numbers)}
    )


@pytest.mark.usefixtures("worse_and_worse")
def test_the_last_checkpoint_is_that_of_the_last_epoch(
    run: _Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "run"
    _killed(run, out, monkeypatch, epoch=2)
    assert _steps_of(out / CHECKPOINT) == 6


def test_a_run_that_is_complete_stays_as_it_is(
    run: _Run, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    # Of one epoch, so that the last checkpoint is the best.
    run(out, passes=1.0)
    assert _steps_of(out / CHECKPOINT) == 3
    state, card = load_weights(out / WEIGHTS)
    again = run(out, passes=1.0, resume=True)
    assert all(
        torch.equal(tensor, state[name])
        for name, tensor in load_weights(out / WEIGHTS)[0].items()
    )
    (before,), (after,) = card.figures.values(), again.figures.values()
    assert after.keys() == before.keys()
    assert after["validation/loss"] == before["validation/loss"]


def test_a_manifest_lies_beside_the_weights(
    whole: tuple[Path, NetworkCard], dataset: Path
) -> None:
    out, card = whole
    (told,) = read_runs(out)
    assert told["command"] == "train"
    assert (told["dtype"], told["seeds"]) == ("32-true", [0])
    assert told["scenario"] == "name: tiny\n"
    assert told["settings"]["batch_size"] == 4
    assert card.training["provenance"]["code"] == told["code"]
    assert card.training["made by"].startswith("Made by code")
    assert told["code"] in (out / CARD).read_text()
    (data,) = card.data["datasets"]
    assert data["fingerprint"] == read_manifest(dataset).fingerprint()
    assert "unknown" in data["made by"]


def test_a_run_has_one_writer(
    run: _Run, whole: tuple[Path, NetworkCard], tmp_path: Path
) -> None:
    for folder, resume in ((tmp_path, False), (whole[0], True)):
        with sole_writer(folder), pytest.raises(InUseError):
            run(folder, resume=resume)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"seed": 3}, "begun with seed 0, not 3"),
        ({"learning_rate": 1.0}, "begun with learning_rate 0.002, not 1.0"),
        ({"precision": "bf16-true"}, "32-true, now bf16-true.*--mix"),
    ],
)
def test_a_run_goes_on_as_it_was_begun(
    run: _Run,
    whole: tuple[Path, NetworkCard],
    change: dict[str, Any],
    words: str,
) -> None:
    before = (whole[0] / WEIGHTS).read_bytes()
    with pytest.raises(ValueError, match=words):
        run(whole[0], resume=True, **change)
    assert (whole[0] / WEIGHTS).read_bytes() == before
    assert len(read_runs(whole[0])) == 1


def test_a_run_of_other_code_is_mixed_on_demand_alone(
    run: _Run, dataset: Path, cache: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    run(out, passes=1.0)
    path = out / MANIFEST
    path.write_text(path.read_text().replace('"code": "', '"code": "f'))
    with pytest.raises(ManifestError, match=r"holds results of code f"):
        run(out, passes=1.0, resume=True)
    options = RunOptions(
        out=out,
        resume=True,
        mix=True,
        cache=cache,
        accelerator="cpu",
        progress=False,
    )
    card = train([dataset], dataclasses.replace(CONFIG, passes=1.0), options)
    assert card.training["made by"].startswith("**Mixed**")


def test_a_shard_of_another_dataset_is_not_trained_on(
    run: _Run, dataset: Path, tmp_path: Path
) -> None:
    own = _write(tmp_path / "own", list(range(1, HEAPS + 1)))
    manifest = dataclasses.replace(read_manifest(own), seed=6)
    write_manifest(own, manifest)
    options = RunOptions(out=tmp_path / "run", progress=False)
    for change in ({}, {"targets": ["box_2to1"], "virtual": False}):
        with pytest.raises(ForeignShardError, match="another dataset"):
            train([own], dataclasses.replace(CONFIG, **change), options)


@pytest.mark.parametrize(
    ("held_out", "words"),
    [
        (True, "no sample is to train on"),
        (False, "no sample is held out for validation"),
    ],
)
def test_there_must_be_items_of_both_kinds(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    held_out: bool,
    words: str,
) -> None:
    heaps = [h for h in range(20) if is_held_out(h, SHARE) == held_out][:2]
    folder = _write(tmp_path / "dataset", heaps)
    options = RunOptions(
        out=tmp_path / "run", accelerator="cpu", progress=False
    )
    (job,) = plan([folder], options.out / "cache", CONFIG.prepare, SHARE)
    job[1].parent.mkdir(parents=True)
    prepare_shard(*job, CONFIG.prepare, SHARE)
    with pytest.raises(TrainingError, match=words) as error:
        train([folder], CONFIG, options)
    assert "\n" not in str(error.value)


def test_weights_are_trained_further(
    whole: tuple[Path, NetworkCard], run: _Run, tmp_path: Path
) -> None:
    weights = whole[0] / WEIGHTS
    card = run(
        tmp_path / "run", weights=str(weights), learning_rate=1e-12, passes=1
    )
    assert card.training["weights"] == str(weights)
    assert card.training["began with"]["optimizer steps"] == STEPS
    before, _ = load_weights(weights)
    after, _ = load_weights(tmp_path / "run" / WEIGHTS)
    learned = [name for name in before if name.endswith(".weight")]
    assert learned
    for name in learned:
        torch.testing.assert_close(after[name], before[name])
    # What is resumed needs them no more.
    change = {"weights": "gone", "learning_rate": 1e-12, "passes": 2}
    run(tmp_path / "run", resume=True, **change)


def test_weights_of_another_network_are_refused(
    whole: tuple[Path, NetworkCard], run: _Run, tmp_path: Path
) -> None:
    options = {"widths": [8, 8, 8, 16], "depths": [1, 1, 1, 1]}
    weights = str(whole[0] / WEIGHTS)
    with pytest.raises(WeightsError, match="is not the configuration's"):
        run(tmp_path / "other", weights=weights, options=options)
    with pytest.raises(WeightsError, match="gone"):
        run(tmp_path / "none", weights="gone.safetensors")


WINDOWED: dict[str, Any] = {
    "architecture": "windowed",
    "options": {
        "whole": CONFIG.options,
        "near": {"widths": [8, 8, 8, 12], "depths": [1, 1, 1, 1]},
    },
}


def test_the_part_for_windows_is_trained_beside_that_for_images(
    whole: tuple[Path, NetworkCard], run: _Run, tmp_path: Path
) -> None:
    weights = whole[0] / WEIGHTS
    out = tmp_path / "run"
    card = run(out, weights=str(weights), **WINDOWED)
    assert card.architecture == "windowed"
    assert card.training["freeze_norm"] == 0.6
    before, _ = load_weights(weights)
    after, _ = load_weights(out / WEIGHTS)
    for name, tensor in before.items():
        assert torch.equal(after[f"whole.{name}"], tensor), name
    (figures,) = card.figures.values()
    assert 0 <= figures["validation/iou"] <= 1
    load_inference(out / WEIGHTS, target_size=np.array([0.06, 0.03, 0.005]))
    # It is itself something to train further.
    on = run(tmp_path / "on", weights=str(out / WEIGHTS), passes=1, **WINDOWED)
    further, _ = load_weights(tmp_path / "on" / WEIGHTS)
    assert on.training["weights"] == str(out / WEIGHTS)
    assert further.keys() == after.keys()


def test_every_device_has_windows_to_validate_on(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Although all that are held out would fit into one batch."""
    config = dataclasses.replace(CONFIG, **WINDOWED)
    files = sorted(cache.iterdir())
    number = len(WindowedData(files, config).validation_items)  # type: ignore[arg-type]
    assert 1 < number <= CONFIG.batch_size
    shares = []
    for rank in range(2):
        monkeypatch.setattr(WindowedData, "_rank", lambda data, r=rank: r)
        data = WindowedData(files, config, devices=2)
        loader = data.val_dataloader()
        assert isinstance(loader.batch_sampler, list)
        shares.append([i for batch in loader.batch_sampler for i in batch])
    assert all(shares)
    assert sorted([*shares[0], *shares[1]]) == list(range(number))
    with pytest.raises(TrainingError, match=f"{number} sample is held out"):
        WindowedData(files, config, devices=number + 1)


def test_too_many_devices_are_told_before_anything_is_done(
    dataset: Path, tmp_path: Path
) -> None:
    options = RunOptions(out=tmp_path / "run", accelerator="cpu", devices=4)
    with pytest.raises(TrainingError, match="items_per_epoch is 12: 4 devices"):
        train([dataset], CONFIG, options)
    assert not options.out.exists()


def test_windows_need_a_network_for_what_is_hidden(
    run: _Run, tmp_path: Path
) -> None:
    with pytest.raises(TrainingError, match="give its file by --weights"):
        run(tmp_path / "run", **WINDOWED)


@pytest.mark.parametrize("windowed", [False, True])
def test_a_run_that_was_killed_goes_on_as_it_would_have_gone(
    whole: tuple[Path, NetworkCard],
    run: _Run,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    windowed: bool,
) -> None:
    (once, expected), out = whole, tmp_path / "run"
    change: dict[str, Any] = {}
    training: Any = CompactTraining
    if windowed:
        change = {**WINDOWED, "weights": str(once / WEIGHTS)}
        once, training = tmp_path / "once", WindowedTraining
        expected = run(once, **change)
    _killed(run, out, monkeypatch, epoch=1, training=training, **change)
    assert _steps_of(out / CHECKPOINT) == 3
    card = run(out, resume=True, **change)
    steps = expected.training["optimizer steps"]
    assert card.training["optimizer steps"] == steps
    assert _same_weights(once, out)
    np.testing.assert_equal(card.figures, expected.figures)
    # What was logged before stays.
    epochs = set()
    for path in out.rglob("metrics*.csv"):
        with path.open(newline="", encoding="utf-8") as file:
            epochs |= {int(row["epoch"]) for row in csv.DictReader(file)}
    assert epochs == set(range(steps // 3))


main = typer.Typer()
main.command()(train_command)


@pytest.fixture
def config_file(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.yaml"
    path.write_text(YAML)
    return path


def _invoke(*arguments: object) -> Any:
    result = CliRunner().invoke(main, [str(word) for word in arguments])
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def test_the_command_trains(
    dataset: Path, cache: Path, config_file: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    result = _invoke(
        *(dataset, "--out", out, "--config", config_file, "--cache", cache),
        *("--seed", 3, "--passes", 0.5, "--accelerator", "cpu"),
    )
    assert result.exit_code == 0, result.output
    card = read_card(out / WEIGHTS)
    assert card.training["seed"] == 3
    assert card.training["passes"] == 0.5
    (figures,) = card.figures.values()
    assert f"validation/iou {figures['validation/iou']}" in result.stdout
    text = "".join(result.stdout.splitlines())
    assert f"{out / WEIGHTS} and {out / CARD}" in text


def _line(*arguments: object) -> tuple[str, int]:
    """What a command that fails says, and its exit status."""
    result = _invoke(*arguments)
    assert result.stdout == ""
    (line,) = result.stderr.splitlines()
    return line, result.exit_code


@pytest.mark.parametrize(
    ("options", "words", "code"),
    [
        (["--config", "gone"], "no training configuration", 2),
        (["--config", "bad.yaml"], "bad.yaml: unknown key pases; did you", 2),
        (["--resume"], "there is nothing to resume", 2),
        (["--weights", "gone.safetensors"], "gone.safetensors", 2),
        (["--out", "old"], "old holds a run: give --resume", 2),
        (["--out", "file"], "file", 1),
        (["--out", "old", "--resume", "--mix"], "last.ckpt is damaged", 2),
        (["--accelerator", "abacus"], "accelerator='abacus'", 2),
        (["--accelerator", ABSENT], "", 2),
        (["--passes", "0"], "passes", 2),
        (["--passes", "-1"], "passes", 2),
        (["--passes", "nan"], "passes", 2),
        (["no_dataset"], "no_dataset is no dataset", 2),
    ],
)
def test_what_cannot_be_done_is_one_line(
    dataset: Path,
    cache: Path,
    config_file: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    options: list[str],
    words: str,
    code: int,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("bad.yaml").write_text("pases: 3\n")
    Path("old").mkdir()
    Path("old", CHECKPOINT).touch()
    Path("file").touch()
    if options[0].startswith("--"):
        options = [str(dataset), *options]
    line, found = _line(
        *("--out", "run", "--config", config_file, "--cache", cache),
        *("--accelerator", "cpu", *options),
    )
    assert words in line
    assert found == code
