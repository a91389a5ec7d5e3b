import json
import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.cli.running import answer, complaint, output
from tests.dataset.whole import bare_sample, tiny_dataset
from xray_drake.dataset.manifest import read_manifest
from xray_drake.dataset.sample import Sample
from xray_drake.files import sole_writer
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.messages import OccupancyDistribution
from xray_drake.occupancy import inference
from xray_drake.occupancy.learned.weights import WeightsError
from xray_drake.provenance import Provenance, describe, read_runs

COUNT = 4
TARGETS = ("box_2to1", "lid")


def _sample(heap_seed: int) -> Sample:
    """A target in full view; the depth's corner says which sample it is."""
    mask = np.zeros((24, 32), bool)
    mask[10:13, 12:18] = True
    depth = np.where(mask, 0.795, 0.8)
    depth[0, 0] = 0.7 + 0.01 * heap_seed
    return replace(
        bare_sample(mask, focal_length=35.0, heap_seed=heap_seed),
        depth=depth,
        depth_without_target=depth,
        target_size=np.array([0.14, 0.07, 0.005 + 0.005 * (heap_seed % 2)]),
        target_name=TARGETS[heap_seed % 2],
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tiny_dataset(
        *(tmp_path, _sample, COUNT),
        shard_size=2,
        targets=TARGETS,
        shape=(24, 32),
    )


class _Networks:
    """Stands for what reads networks; remembers what it saw.

    A network named "modal" answers the modal mask; "weak", half of it for the
    sample of seed 2; any, nothing without scaling, and a quarter of it for
    posterior.
    """

    def __init__(self) -> None:
        self.loaded: list[tuple[str, tuple[float, ...]]] = []
        self.dtypes: set[str] = set()
        self.depths: list[np.ndarray] = []
        self.cameras: list[PinholeCamera] = []

    def load_inference(
        self,
        path: Path,
        *,
        target_size: np.ndarray,
        scaling: bool = True,
        output: str = "occupancy",
        dtype: str = "float32",
        floor: object = None,
    ) -> Any:
        if path.stem == "gone":
            raise WeightsError(f"{path} holds no weights")
        self.loaded.append((path.stem, tuple(target_size.tolist())))
        self.dtypes.add(dtype)

        def infer(
            depth: np.ndarray, mask: np.ndarray, camera: PinholeCamera
        ) -> OccupancyDistribution:
            self.depths.append(depth)
            self.cameras.append(camera)
            seed = round((float(depth[0, 0]) - 0.7) / 0.01)
            weak = path.stem == "weak" and seed == 2
            value = (0.5 if weak else 1.0) * scaling
            if output == "posterior":
                value /= 4
            return OccupancyDistribution(mask * value, 0.02)

        return SimpleNamespace(infer=infer)


@pytest.fixture
def networks(monkeypatch: pytest.MonkeyPatch) -> _Networks:
    networks = _Networks()
    monkeypatch.setattr(inference, "load_inference", networks.load_inference)
    return networks


def _rows(output: str) -> dict[tuple[str, str], list[str]]:
    lines = [li for li in output.splitlines() if li.startswith("|")][2:]
    cells = [[c.strip() for c in li.strip("|").split("|")] for li in lines]
    return {(row[0], row[1]): row[2:] for row in cells}


COMMAND = "evaluate occupancy"
MODAL = "--weights modal --no-geometric"


def test_a_manifest_lies_beside_the_results(
    folder: Path, networks: _Networks, tmp_path: Path
) -> None:
    weights = tmp_path / "modal.safetensors"
    weights.write_bytes(b"weights")
    out = tmp_path / "out"
    out.mkdir()
    printed = output(
        f"{COMMAND} {folder} --weights {weights} --no-geometric --seed 4",
        f"--json {out}/a.json",
    )
    assert sorted(p.name for p in out.iterdir()) == [
        *("a.json", "a.json.manifest.json")
    ]
    (run,) = read_runs(out / "a.json")
    assert run["command"] == "evaluate"
    assert (run["seeds"], run["dtype"]) == ([4], "float32")
    assert run["weights"].keys() == {"modal.safetensors"}
    assert run["scenario"] == "name: tiny\n"
    assert run["settings"]["fingerprint"] == read_manifest(folder).fingerprint()
    made_by = Provenance.from_dict(run)
    told = json.loads((out / "a.json").read_text())
    assert Provenance.from_dict(told["provenance"]) == made_by
    assert describe([made_by], seeds=[4]) in printed


def test_what_goes_to_a_pipe_has_no_manifest(
    folder: Path, tmp_path: Path
) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        output(f"{COMMAND} {folder} --images 1 --json {pipe}")
        assert os.read(reader, 10).startswith(b"{")
    finally:
        os.close(reader)
    assert not list(tmp_path.glob("*pipe*json"))


def test_two_evaluations_do_not_write_to_one_file(
    folder: Path, networks: _Networks, tmp_path: Path
) -> None:
    path = tmp_path / "a.json"
    with sole_writer(path):
        line = complaint(f"{COMMAND} {folder} --json {path}")
    assert "is being written by another process" in line
    assert not path.exists()


@pytest.mark.parametrize("option", ["unscaled", "posterior"])
def test_a_network_in_another_way(
    folder: Path, networks: _Networks, option: str
) -> None:
    rows = _rows(output(f"{COMMAND} {folder} {MODAL} --{option}"))
    assert rows["all, 4", "modal"][:2] == ["100.0%", "1.000"]
    other = rows["all, 4", f"modal, {option}"]
    assert other[1] == "0.000"
    # A posterior is off by more than the metrics allow, yet on the target.
    assert (other[4][:5] == "1.000") == (option == "posterior")


@pytest.mark.parametrize(
    ("option", "expected"),
    [("", "float32"), ("--dtype bfloat16", "bfloat16")],
)
def test_what_a_network_computes_in(
    option: str,
    expected: str,
    folder: Path,
    networks: _Networks,
    tmp_path: Path,
) -> None:
    path = tmp_path / "out.json"
    output(f"{COMMAND} {folder} {MODAL} --json {path} {option}")
    assert networks.dtypes == {expected}
    assert json.loads(path.read_text())["dtype"] == expected


def test_exact_inference_and_a_network(
    folder: Path, networks: _Networks, tmp_path: Path
) -> None:
    out = tmp_path / "results.json"
    weights = "--weights nets/modal.safetensors"
    printed = output(f"{COMMAND} {folder} {weights} --json {out}")
    rows = _rows(printed)
    assert list(rows)[:2] == [("all, 4", "modal"), ("all, 4", "geometric")]
    assert ("lid, 2", "modal") in rows
    assert rows["all, 4", "modal"][:2] == ["100.0%", "1.000"]
    assert f"wrote {out}" in printed
    # Once for each size of target, not for each image.
    assert len(networks.loaded) == len(set(networks.loaded)) == 2
    told = json.loads(out.read_text(encoding="utf-8"))
    assert told["dataset"] == str(folder)
    assert list(told["predictors"]) == ["modal", "geometric"]
    images = told["predictors"]["geometric"]["images"]
    assert [image["heap_seed"] for image in images] == [0, 1, 2, 3]
    modal = told["predictors"]["modal"]
    assert modal["overall"]["target_mass"]["value"] == 1.0


@pytest.mark.parametrize(
    ("flags", "names"),
    [
        ("--geometric-label --no-geometric", {"geometric_label"}),
        ("--expected --no-exact", {"geometric_label"}),
        ("--geometric-label", {"geometric_label", "geometric"}),
    ],
)
def test_the_label_guessed_without_a_network(
    folder: Path, flags: str, names: set[str]
) -> None:
    """Old names of options do, with a line that says so."""
    code, out, _ = answer(f"{COMMAND} {folder} --images 1 {flags}")
    assert code == 0
    assert {name for _, name in _rows(out)} == names


def test_what_inference_is_told_wrongly(
    folder: Path, networks: _Networks
) -> None:
    command = f"{COMMAND} {folder} {MODAL} --images 1"
    output(command)
    told = output(command, "--height-offset 0.01 --focal-error 0.02 --noise")
    rightly, wrongly = networks.cameras
    assert wrongly.X_WC[2, 3] - rightly.X_WC[2, 3] == pytest.approx(0.01)
    assert wrongly.intrinsics[0, 0] == pytest.approx(1.02 * 35)
    clean, noisy = networks.depths
    assert not np.array_equal(clean, noisy)
    # The label stays where it was.
    assert _rows(told)["all, 1", "modal"][:2] == ["100.0%", "1.000"]


def test_a_figure_of_the_worst(
    folder: Path,
    networks: _Networks,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from xray_drake.inspector import figures

    drawn: list[Any] = []
    original = figures.prediction_figure

    def remember(examples: Any) -> Any:
        drawn.extend(examples)
        return original(examples)

    monkeypatch.setattr(figures, "prediction_figure", remember)
    out = tmp_path / "worst.png"
    weak = f"{COMMAND} {folder} --weights weak --no-geometric --figure {out}"
    output(f"{weak} --weights modal --worst --examples 1")
    assert out.read_bytes().startswith(b"\x89PNG")
    (example,) = drawn
    assert example.sample.heap_seed == 2
    assert example.ious == {"weak": 0.0, "modal": 1.0}
    assert example.predictions["weak"].data.max() == 0.5
    drawn.clear()
    output(weak)
    assert [e.sample.heap_seed for e in drawn] == [0, 1, 2, 3]


def test_images_are_drawn_by_the_seed(
    folder: Path, networks: _Networks
) -> None:
    def seen(seed: int) -> tuple[float, ...]:
        networks.depths.clear()
        output(f"{COMMAND} {folder} {MODAL} --images 2 --seed {seed}")
        return tuple(float(depth[0, 0]) for depth in networks.depths)

    assert seen(0) == seen(0)
    assert len(seen(0)) == 2
    assert len({seen(seed) for seed in range(8)}) > 1


def test_networks_of_one_name_go_by_their_paths(
    folder: Path, networks: _Networks
) -> None:
    paths = ("a/net.safetensors", "b/net.safetensors", "geometric.safetensors")
    options = [f"--weights {path}" for path in paths]
    rows = _rows(output(COMMAND, folder, *options, "--images 1"))
    assert [name for _, name in rows][:4] == [*paths, "geometric"]


def test_some_of_a_dataset(folder: Path, networks: _Networks) -> None:
    command = f"{COMMAND} {folder} {MODAL}"
    assert ("all, 2", "modal") in _rows(output(command, "--target lid"))
    assert {size[2] for _, size in networks.loaded} == {0.01}
    # As while it is being made.
    (folder / "train-00001.h5").unlink()
    assert "train-00001.h5 is missing" in complaint(command)
    assert ("all, 2", "modal") in _rows(output(command, "--incomplete"))


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ("--no-geometric", "nothing to evaluate: give --weights"),
        ("--weights a --weights a", "given twice"),
        ("--weights gone", "gone holds no weights"),
        ("--split tests", "no split is called 'tests'"),
        ("--target flute", "holds no sample of what was asked for"),
        ("--focal-error -1", "focal length"),
        ("--figure figure.xyz", "should end in .png, .pdf or .svg"),
        ("--figure nowhere/f.png", "nowhere does not exist"),
        ("--json nowhere/out.json", "nowhere does not exist"),
        ("--json .", "cannot write .: it is a folder"),
    ],
)
def test_what_cannot_be_done_is_one_line(
    folder: Path,
    networks: _Networks,
    monkeypatch: pytest.MonkeyPatch,
    options: str,
    line: str,
) -> None:
    monkeypatch.chdir(folder)
    assert line in complaint(COMMAND, folder, options)
