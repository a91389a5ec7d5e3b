import json
import shutil
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests.cli.running import answer, complaint, output
from tests.dataset.conftest import synthetic_sample
from xray_drake.cli import generate as module
from xray_drake.dataset.generator import ShardReport
from xray_drake.dataset.manifest import ExpectedShard, Manifest, read_manifest
from xray_drake.dataset.shards import (
    ShardAttributes,
    ShardReader,
    write_shard,
)
from xray_drake.files import read_json_lines, sole_writer
from xray_drake.provenance import MANIFEST, read_runs

COMMAND = "generate --images 2 --shard-size 1 --num-objects 2"
generate, line_of = partial(answer, COMMAND), partial(complaint, COMMAND)


@pytest.fixture(autouse=True)
def made(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Makes shards without a simulation; names of what is made."""
    names: list[str] = []

    def run(
        out: Path,
        manifest: Manifest,
        missing: Sequence[ExpectedShard],
        **options: Any,
    ) -> Iterator[ShardReport]:
        for shard in missing:
            samples = [synthetic_sample(shard.first, shape=(384, 512))]
            attributes = ShardAttributes(
                split=shard.split,
                scenario=manifest.scenario,
                package_version="0.1.0",
                drake_version="1.51.1",
                dataset=manifest.fingerprint(),
                index=shard.index,
            )
            write_shard(out / shard.name, samples, attributes)
            names.append(shard.name)
            yield ShardReport(shard.name, 1, 1, (), 1.0)

    monkeypatch.setattr(module, "run_processes", run)
    return names


@pytest.fixture
def folder(tmp_path: Path, made: list[str]) -> Path:
    path = tmp_path / "dataset"
    assert "Made by code" in output(COMMAND, path)
    assert made == ["train-00000.h5", "train-00001.h5"]
    made.clear()
    return path


def test_a_manifest_lies_beside_the_shards(folder: Path) -> None:
    (run,) = read_runs(folder)
    assert run["command"] == "generate"
    assert (run["seeds"], run["weights"], run["dtype"]) == ([0], {}, "")
    assert run["scenario"] == read_manifest(folder).scenario
    assert run["settings"]["splits"]["train"] == 2
    assert "Made by" in output("dataset info", folder)


def test_a_dataset_has_one_writer(folder: Path, made: list[str]) -> None:
    (folder / "train-00001.h5").unlink()
    with sole_writer(folder):
        for options in ("", "--resume", "--resume --mix"):
            line = line_of(folder, options)
            assert "is being written by another process" in line
            assert str(folder) in line
    assert made == []
    assert generate(folder, "--resume")[0] == 0
    assert made == ["train-00001.h5"]


def test_a_copy_made_while_it_was_written_is_gone_on_with(
    folder: Path, tmp_path: Path, made: list[str]
) -> None:
    (folder / "train-00001.h5").unlink()
    with (folder / module.LOG).open("a") as log:
        log.write('{"name": "tra')
    with sole_writer(folder):
        copy = shutil.copytree(folder, tmp_path / "copy")
    assert (copy / ".lock").exists()
    code, _, _ = generate(copy, "--resume")
    assert code == 0
    assert made == ["train-00001.h5"]
    assert len(read_json_lines(copy / module.LOG)) == 3
    assert not list(copy.glob(".*"))


@pytest.mark.parametrize("seed", [0, 7], ids=["renamed", "foreign"])
def test_a_shard_that_belongs_elsewhere_is_put_aside(
    seed: int, folder: Path, tmp_path: Path, made: list[str]
) -> None:
    other = tmp_path / "other"
    generate(other, f"--seed {seed}")
    made.clear()
    foreign = (other / "train-00001.h5").read_bytes()
    (folder / "train-00000.h5").write_bytes(foreign)
    code, out, _ = generate(folder, "--resume")
    assert code == 0
    assert made == ["train-00000.h5"]
    assert "kept as train-00000.h5.aside): it is made again" in out
    assert (folder / "train-00000.h5.aside").read_bytes() == foreign
    with ShardReader(folder / "train-00000.h5") as shard:
        assert shard.attributes.index == 0
    # A second one does not take its place.
    (folder / "train-00000.h5").write_bytes(foreign)
    generate(folder, "--resume")
    assert (folder / "train-00000.h5.aside1").is_file()


def test_other_code_does_not_go_on(folder: Path, made: list[str]) -> None:
    (folder / "train-00001.h5").unlink()
    path = folder / MANIFEST
    tree = json.loads(path.read_text("utf-8"))
    tree["runs"][0]["code"] = "0123"
    path.write_text(json.dumps(tree), "utf-8")
    assert "code 0123" in line_of(folder, "--resume")
    assert made == []
    code, out, _ = generate(folder, "--resume --mix")
    assert code == 0
    assert made == ["train-00001.h5"]
    assert "**Mixed**" in out
    assert "**Mixed**" in output("dataset info", folder)


def test_other_versions_go_on_with_the_dataset_that_was_begun(
    folder: Path, made: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "train-00001.h5").unlink()
    begun = read_manifest(folder)
    newer = {"xray_drake": "9.0", "drake": "9.0"}
    monkeypatch.setattr("xray_drake.dataset.generator.versions", lambda: newer)
    assert "begun with drake_version" in line_of(folder, "--resume")
    assert generate(folder, "--resume --mix")[0] == 0
    assert read_manifest(folder) == begun
    with ShardReader(folder / "train-00001.h5") as shard:
        assert shard.attributes.dataset == begun.fingerprint()
