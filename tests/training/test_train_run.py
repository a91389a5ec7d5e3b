import csv
import dataclasses
import itertools
import shutil
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
from tests.training.making import SMALL, prepare_here, train_here
from xray_drake.cli.train import train as train_command
from xray_drake.configuration import (
    tree_of,
)
from xray_drake.dataset.manifest import read_manifest
from xray_drake.dataset.reader import is_held_out
from xray_drake.files import InUseError, sole_writer
from xray_drake.occupancy.learned.inference import load_inference
from xray_drake.occupancy.learned.weights import (
    NetworkCard,
    load_weights,
    read_card,
)
from xray_drake.provenance import MANIFEST, ManifestError, read_runs
from xray_drake.training.config import TrainConfig, TrainingError
from xray_drake.training.losses import OccupancyMetrics
from xray_drake.training.module import CompactTraining
from xray_drake.training.prepare import PrepareConfig
from xray_drake.training.run import CARD, CHECKPOINT, WEIGHTS
from xray_drake.training.windows import WindowedData, WindowedTraining
from xray_drake.trees import write_tree

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
    options=SMALL,
    validation_share=SHARE,
    # 3 epochs of 3 steps.
    passes=36 / 12,
    items_per_epoch=12,
    batch_size=4,
    precision="32-true",
    prepare=PrepareConfig(virtual=1),
)


WINDOWED: dict[str, Any] = {
    "architecture": "windowed",
    "options": {"whole": SMALL, "near": {**SMALL, "widths": [8, 8, 8, 12]}},
}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny_dataset(
        tmp_path_factory.mktemp("training"),
        lambda i: synthetic_sample(i, cover=(0.4, 1.0)[i % 2], shape=SHAPE),
        HEAPS,
        shard_size=HEAPS,
        seed=5,
    )


@pytest.fixture(scope="module")
def cache(dataset: Path) -> Path:
    prepare_here(dataset, dataset / "cache", CONFIG)
    return dataset / "cache"


_Run = Callable[..., NetworkCard]


@pytest.fixture(scope="module")
def run(dataset: Path, cache: Path) -> _Run:
    """Trains in a folder."""

    def run(
        out: Path, *, resume: bool = False, mix: bool = False, **change: Any
    ) -> NetworkCard:
        config = dataclasses.replace(CONFIG, **change)
        how = {"resume": resume, "mix": mix, "cache": cache}
        return train_here(dataset, out, config, **how)

    return run


@pytest.fixture(scope="module")
def whole(run: _Run, dataset: Path) -> tuple[Path, NetworkCard]:
    """A run from beginning to end; not to be changed."""
    out = dataset.parent / "whole"
    return out, run(out)


def _same_weights(one: Path, other: Path) -> bool:
    first, second = (load_weights(run / WEIGHTS)[0] for run in (one, other))
    assert first.keys() == second.keys()
    return all(torch.equal(first[name], second[name]) for name in first)


def _logged(out: Path) -> list[dict[str, str]]:
    """The rows of all logs."""
    rows = []
    for path in out.rglob("metrics*.csv"):
        with path.open(newline="", encoding="utf-8") as file:
            rows += list(csv.DictReader(file))
    return rows


def _steps_of(checkpoint: Path) -> int:
    return torch.load(checkpoint, weights_only=True)["global_step"]


def test_a_run_writes_weights_that_inference_takes(
    whole: tuple[Path, NetworkCard], dataset: Path
) -> None:
    out, card = whole
    state, stored = load_weights(out / WEIGHTS)
    assert stored == card
    # They saw every step, and each is logged.
    (seen,) = {
        int(tensor)
        for name, tensor in state.items()
        if name.endswith("num_batches_tracked")
    }
    losses = [row["train/loss"] for row in _logged(out)]
    assert len([loss for loss in losses if loss]) == seen == STEPS
    sample = synthetic_sample(1, shape=SHAPE)
    outputs: list[Any] = ["occupancy", "posterior"]
    for output in outputs:
        inference = load_inference(
            out / WEIGHTS, target_size=sample.target_size, output=output
        )
        answer = inference.infer(
            sample.depth, sample.target_modal, sample.camera
        )
        assert answer.data.shape == SHAPE
        assert 0 < answer.data.max() <= 1


def test_the_card_and_the_manifest_say_what_was_trained_on_what(
    whole: tuple[Path, NetworkCard], dataset: Path
) -> None:
    out, card = whole
    assert (card.architecture, card.input) == ("compact", "geometry")
    assert card.options == CONFIG.options
    assert (card.targets, card.box_size) == (("box_2to1",), None)
    (data,) = card.data["datasets"]
    assert data["fingerprint"] == read_manifest(dataset).fingerprint()
    assert (data["seed"], data["scenario"]) == (5, "name: tiny\n")
    assert "unknown" in data["made by"]
    assert card.data["images used"] == HEAPS
    out_of = card.data["items to train on"] + card.data["items held out"]
    held_out = sum(is_held_out(heap, SHARE) for heap in range(HEAPS))
    assert held_out <= card.data["items held out"] <= 2 * held_out
    assert HEAPS < out_of <= 2 * HEAPS
    (told,) = read_runs(out)
    provenance = card.training["provenance"]
    assert provenance["code"] == told["code"]
    assert provenance["versions"]["lightning"] == version("lightning")
    assert card.training["made by"].startswith("Made by code")
    assert card.training["optimizer steps"] == STEPS
    assert card.training["prepare"]["virtual"] == 1
    assert (told["command"], told["dtype"]) == ("train", "32-true")
    assert told["seeds"] == [card.training["seed"]] == [0]
    assert told["settings"]["batch_size"] == 4
    (figures,) = card.figures.values()
    for name in ("loss", "iou", "balanced_accuracy", "mass_on_target"):
        assert np.isfinite(figures[f"validation/{name}"])
    assert (out / CARD).read_text(encoding="utf-8") == card.to_markdown()
    assert told["code"] in card.to_markdown()


def test_it_learns(run: _Run, tmp_path: Path) -> None:
    change = {"learning_rate": 0.01, "items_per_epoch": 60}
    first, last = (
        next(iter(run(tmp_path / str(n), passes=n, **change).figures.values()))
        for n in (0.1, 40.0)
    )
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
    """And is gone on with by other code on demand alone."""
    out = tmp_path / "run"
    # Of one epoch, so that the last checkpoint is the best.
    (before,) = run(out, passes=1.0).figures.values()
    assert _steps_of(out / CHECKPOINT) == 3
    shutil.copytree(out, tmp_path / "before")
    (after,) = run(out, passes=1.0, resume=True).figures.values()
    assert _same_weights(out, tmp_path / "before")
    assert after.keys() == before.keys()
    assert after["validation/loss"] == before["validation/loss"]
    path = out / MANIFEST
    path.write_text(path.read_text().replace('"code": "', '"code": "f'))
    with pytest.raises(ManifestError, match=r"holds results of code f"):
        run(out, passes=1.0, resume=True)
    card = run(out, passes=1.0, resume=True, mix=True)
    assert card.training["made by"].startswith("**Mixed**")


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


def test_weights_are_trained_further(
    whole: tuple[Path, NetworkCard], run: _Run, tmp_path: Path
) -> None:
    weights, out = whole[0] / WEIGHTS, tmp_path / "run"
    card = run(out, weights=str(weights), learning_rate=1e-12, passes=1)
    assert card.training["weights"] == str(weights)
    assert card.training["began with"]["optimizer steps"] == STEPS
    before, _ = load_weights(weights)
    after, _ = load_weights(out / WEIGHTS)
    learned = [name for name in before if name.endswith(".weight")]
    assert learned
    for name in learned:
        torch.testing.assert_close(after[name], before[name])
    # What is resumed needs them no more.
    change = {"weights": "gone", "learning_rate": 1e-12, "passes": 2}
    run(out, resume=True, **change)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"weights": "gone.safetensors"}, "gone"),
        ({"options": {**SMALL, "depths": [1, 1, 1, 2]}}, "is not the config"),
        ({**WINDOWED, "weights": ""}, "give its file by --weights"),
    ],
)
def test_weights_to_begin_with_must_be_the_networks(
    whole: tuple[Path, NetworkCard],
    run: _Run,
    tmp_path: Path,
    change: dict[str, Any],
    words: str,
) -> None:
    """A windowed network needs some: of what answers for hidden targets."""
    with pytest.raises(ValueError, match=words):
        run(tmp_path, **{"weights": str(whole[0] / WEIGHTS), **change})


def test_the_part_for_windows_is_trained_beside_that_for_images(
    whole: tuple[Path, NetworkCard], run: _Run, tmp_path: Path
) -> None:
    weights, out = whole[0] / WEIGHTS, tmp_path / "run"
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
    assert on.training["weights"] == str(out / WEIGHTS)
    assert load_weights(tmp_path / "on" / WEIGHTS)[0].keys() == after.keys()


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
    epochs = {int(row["epoch"]) for row in _logged(out)}
    assert epochs == set(range(steps // 3))


main = typer.Typer()
main.command()(train_command)


def _invoke(*arguments: object) -> Any:
    result = CliRunner().invoke(main, [str(word) for word in arguments])
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


@pytest.fixture
def command(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> list[str]:
    """Arguments of a run in the folder "run"."""
    monkeypatch.chdir(tmp_path)
    tree = tree_of(dataclasses.replace(CONFIG, passes=1.0))
    Path("tiny.yaml").write_text(write_tree(tree))
    given = {"out": "run", "config": "tiny.yaml", "cache": str(cache)}
    given["accelerator"] = "cpu"
    return [word for k, v in given.items() for word in (f"--{k}", v)]


def test_the_command_trains(dataset: Path, command: list[str]) -> None:
    result = _invoke(dataset, *command, "--seed", 3, "--passes", 0.5)
    assert result.exit_code == 0, result.output
    card = read_card(Path("run", WEIGHTS))
    assert (card.training["seed"], card.training["passes"]) == (3, 0.5)
    (figures,) = card.figures.values()
    assert f"validation/iou {figures['validation/iou']}" in result.stdout
    text = "".join(result.stdout.splitlines())
    assert f"run/{WEIGHTS} and run/{CARD}" in text


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
        (["--devices", "4"], "items_per_epoch is 12: 4 devices", 2),
        (["--passes", "nan"], "passes", 2),
        (["no_dataset"], "no_dataset is no dataset", 2),
    ],
)
def test_what_cannot_be_done_is_one_line(
    dataset: Path, command: list[str], options: list[str], words: str, code: int
) -> None:
    Path("bad.yaml").write_text("pases: 3\n")
    Path("old").mkdir()
    Path("old", CHECKPOINT).touch()
    Path("file").touch()
    if options[0].startswith("--"):
        options = [str(dataset), *options]
    result = _invoke(*command, *options)
    assert result.stdout == ""
    (line,) = result.stderr.splitlines()
    assert words in line
    assert result.exit_code == code
