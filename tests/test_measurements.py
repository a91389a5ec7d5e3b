"""What the scripts of ``tests/benchmarks`` write beside their results."""

import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from xray_drake.files import LinesError, read_json_lines
from xray_drake.provenance import (
    ManifestError,
    current,
    manifest_path,
    read_runs,
)

SCRIPTS = Path(__file__).parent / "benchmarks"


def script(name: str) -> ModuleType:
    path = SCRIPTS / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def tall(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The comparison of tall targets, without heaps."""
    module = script("tall_targets")

    def photograph(target: str, seed: int, objects: int, file: Path) -> None:
        np.savez(file, seed=seed)

    def compare(target: str, images: object) -> dict[str, Any]:
        one = {"held": 1.0, "iou": 0.5, "support": 9, "seconds": 0.1}
        return {"visible": 0.5, "flat": one, "resting": one}

    monkeypatch.setattr(module, "photograph", photograph)
    monkeypatch.setattr(module, "compare", compare)
    return module


def test_measurements_are_gone_on_with_by_the_same_code_alone(
    tall: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tall.main(tmp_path, heaps=1)
    lines = tmp_path / "results.jsonl"
    (run,) = read_runs(lines)
    assert (run["command"], run["seeds"]) == ("tall_targets", [50_000])
    # The script is of the code.
    assert run["code"] != current().code
    assert len(read_json_lines(lines)) == 2
    assert "Made by" in capsys.readouterr().out

    # Killed in the middle of a line, it goes on.
    lines.write_text(lines.read_text()[:-5])
    tall.main(tmp_path, heaps=2)
    assert len(read_json_lines(lines)) == 4
    with pytest.raises(ManifestError, match="begun with objects 6, not 7"):
        tall.main(tmp_path, heaps=2, objects=7)
    path = manifest_path(lines)
    path.write_text(path.read_text().replace('"code": "', '"code": "f'))
    with pytest.raises(ManifestError, match="--mix"):
        tall.main(tmp_path, heaps=3)
    tall.main(tmp_path, heaps=3, mix=True)
    assert "**Mixed**" in capsys.readouterr().out
    with lines.open("a") as file:
        file.write("rubbish\n")
    with pytest.raises(LinesError, match="line 7 cannot be read"):
        tall.main(tmp_path, heaps=3)


def test_other_grasps_are_another_measurement(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = script("contact_grasps")
    monkeypatch.setattr(module, "shapes", lambda seed, meshes: [])
    monkeypatch.setattr(module, "table", lambda lines: [])
    monkeypatch.setattr(module, "disagreements", lambda lines: [])
    out = tmp_path / "grasps.jsonl"
    module.main(out)
    out.write_text('{"name": "lid", "rest": 0}\n')
    module.main(out)
    for change in ({"seed": 10_001}, {"carrier": "arm"}, {"load": [2.0]}):
        with pytest.raises(ManifestError, match="was begun with"):
            module.main(out, **change)
