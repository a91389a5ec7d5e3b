import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli.running import answer, complaint, output
from tests.dataset.whole import bare_sample, flip_bit, tiny_dataset
from xray_drake.cli import inspect as inspect_module
from xray_drake.dataset.sample import Sample


def _sample(heap_seed: int) -> Sample:
    mask = np.zeros((24, 32), bool)
    mask[10:14, 12:20] = True
    return bare_sample(mask, focal_length=35.0, heap_seed=heap_seed)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tiny_dataset(tmp_path, _sample, 3, shard_size=2, shape=(24, 32))


@pytest.mark.parametrize("option", ["", "--fast"])
def test_check_of_a_sound_dataset(folder: Path, option: str) -> None:
    (line,) = output("dataset check", folder, option).splitlines()
    assert line.startswith("sound")
    assert "3 of 3 samples in 2 shards" in line


def test_check_of_a_damaged_dataset(folder: Path) -> None:
    flip_bit(folder / "train-00001.h5")
    code, out, _ = answer("dataset check", folder)
    assert code == 1
    defect, count = out.splitlines()
    assert defect.startswith("train-00001.h5: damaged or no shard: Can")
    assert count == "1 defect: 3 of 3 samples in 2 shards"


def test_check_as_json(folder: Path) -> None:
    (folder / "train-00000.h5").unlink()
    code, out, _ = answer("dataset check --json", folder)
    assert code == 1
    report = json.loads(out)
    assert not report["sound"]
    nothing = {"sample": None, "key": None}
    defect = {"file": "train-00000.h5", **nothing, "problem": "missing"}
    assert report["defects"] == [defect]
    assert report["num_samples"] == 1
    assert report["num_expected"] == 3
    assert report["statistics"]["fully_visible"] == 1.0


def test_info(folder: Path) -> None:
    out = output("dataset info", folder)
    for words in ("3 of 3", "box_2to1", "32×24", "Drake 1.51.1", "100.0%"):
        assert words in out
    as_json = output("dataset info --json", folder)
    assert json.loads(as_json)["statistics"]["objects_max"] == 0


@pytest.mark.parametrize(
    "command",
    ["dataset check", "dataset info", "inspect", "evaluate occupancy"],
)
def test_no_dataset_is_one_line(tmp_path: Path, command: str) -> None:
    (tmp_path / "nothing").mkdir()
    line = complaint(command, tmp_path / "nothing")
    assert "nothing is no dataset" in line
    assert "xray-drake generate" in line


def test_inspect_writes_a_figure_beside_the_caller_by_default(
    folder: Path, monkeypatch: pytest.MonkeyPatch, tmp_path_factory: Any
) -> None:
    out = folder / "figure.png"
    told = output(f"inspect {folder} --samples 2 --out {out}")
    assert told == f"wrote {out}\n"
    assert out.read_bytes().startswith(b"\x89PNG")
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    output("inspect", folder)
    assert Path("samples.png").is_file()


@pytest.mark.parametrize(
    ("options", "line", "code"),
    [
        ("--index 3", "has no sample 3: there are 3, from 0", 2),
        ("--split test", "holds no sample of what was asked for", 2),
        ("--split tests", "no split is called 'tests'", 2),
        ("--target lid", "holds no sample of what was asked for", 2),
        ("--out figure.xyz", "should end in .png, .pdf or .svg", 2),
        ("--out nowhere/figure.png", "nowhere/figure.png", 1),
    ],
)
def test_what_inspect_cannot_do_is_one_line(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    options: str,
    line: str,
    code: int,
) -> None:
    monkeypatch.chdir(folder)
    assert line in complaint("inspect", folder, options, code=code)


def test_a_draw_depends_on_its_seed(folder: Path) -> None:
    def drawn(seed: int, samples: int = 2) -> list[int]:
        chosen = inspect_module.choose(
            folder,
            samples=samples,
            indices=None,
            split=None,
            targets=None,
            seed=seed,
        )
        for index, sample in chosen:
            assert sample.heap_seed == index
        return [index for index, _ in chosen]

    assert drawn(0) == drawn(0)
    assert len({tuple(drawn(seed)) for seed in range(8)}) > 1
    assert drawn(0, samples=99) == [0, 1, 2]


def test_inspect_in_meshcat_goes_around(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from xray_drake.inspector import dataset as viewers

    shown: list[str] = []

    class _Viewer:
        url = "http://localhost:7000"

        def show(self, path: str, layer: object) -> None:
            shown.append(path)

    answers = iter(["", "", ""])

    def enter(prompt: str) -> str:
        try:
            return next(answers)
        except StopIteration:
            raise KeyboardInterrupt from None

    monkeypatch.setattr(viewers, "start_viewer", _Viewer)
    monkeypatch.setattr("builtins.input", enter)
    out = output(f"inspect {folder} --meshcat --index 2 --index 0")
    assert "http://localhost:7000" in out
    lines = [li for li in out.splitlines() if li[:6] == "sample"]
    numbers = [line.split(":")[0] for line in lines]
    assert numbers == ["sample 2", "sample 0"] * 2
    assert shown.count("sample/scene") == 4
    assert not (Path.cwd() / "samples.png").exists()
