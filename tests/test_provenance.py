import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import xray_drake
from xray_drake.provenance import (
    MANIFEST,
    NO_CHECKOUT,
    ManifestError,
    Provenance,
    Run,
    check_resumable,
    current,
    describe,
    manifest_path,
    read_runs,
    record_run,
)
from xray_drake.resources import models_dir

PACKAGE = Path(xray_drake.__file__).parent


def git(folder: Path, *arguments: str) -> str:
    user = ("-c", "user.name=x", "-c", "user.email=x@example.org")
    return subprocess.run(
        ["git", *user, *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.strip()


def commit(folder: Path, what: str = ".") -> None:
    git(folder, "init", "-q")
    git(folder, "add", what)
    git(folder, "commit", "-q", "-m", "All")


def copy(folder: Path) -> Path:
    """Copies what a digest of the code is made of."""
    shutil.copytree(
        PACKAGE,
        folder / "xray_drake",
        ignore=shutil.ignore_patterns("__pycache__", "models"),
    )
    shutil.copytree(
        models_dir(),
        folder / "models",
        ignore=shutil.ignore_patterns("networks", "pictures"),
    )
    return folder


def asked(folder: Path, **environment: str) -> Provenance:
    """Returns the provenance that a package there tells."""
    script = (
        "import json; from xray_drake.provenance import current\n"
        "print(json.dumps(current().to_dict()))"
    )
    environment = {**os.environ, "PYTHONPATH": str(folder), **environment}
    output = subprocess.run(
        [sys.executable, "-c", script],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        check=True,
    ).stdout
    return Provenance.from_dict(json.loads(output))


def test_a_checkout_tells_its_commit_and_changes(tmp_path: Path) -> None:
    copy(tmp_path)
    (tmp_path / "pyproject.toml").write_text('[project]\nname = "xray-drake"\n')
    (tmp_path / ".gitignore").write_text("__pycache__/\n")
    commit(tmp_path)
    # Results in the tree are no change of it.
    (tmp_path / "a.json").write_text("{}")
    found = asked(tmp_path, GIT_DIR=str(tmp_path / "elsewhere"))
    assert found.commit == git(tmp_path, "rev-parse", "HEAD")
    assert found.dirty is False
    assert found.code == current().code
    with (tmp_path / "xray_drake" / "seeding.py").open("a") as file:
        file.write("# changed\n")
    changed = asked(tmp_path)
    assert (changed.commit, changed.dirty) == (found.commit, True)
    assert changed.code != found.code


@pytest.mark.parametrize("project", [None, "my-robot"])
def test_somebody_elses_repository_is_not_ours(
    tmp_path: Path, project: str | None
) -> None:
    """As in a virtual environment, or copied to the top of a repository."""
    folder = tmp_path
    if project is None:
        folder = tmp_path / ".venv" / "site-packages"
    else:
        text = f'[project]\nname = "{project}"\n'
        (tmp_path / "pyproject.toml").write_text(text)
    copy(folder)
    (tmp_path / "robot.py").touch()
    commit(tmp_path, "robot.py")
    (folder / "models" / "scenarios" / "demo.yaml").write_text("horizon: 3\n")
    found = asked(folder)
    assert (found.commit, found.dirty) == (NO_CHECKOUT, None)
    # Other code is found all the same.
    assert found.code not in ("", current().code)


def test_what_is_told(tmp_path: Path) -> None:
    weights = tmp_path / "net.safetensors"
    weights.write_bytes(b"1")
    found = current(weights=[weights, tmp_path / "gone"], dtype="float32")
    assert found.versions.keys() == {
        *("xray_drake", "drake", "torch", "lightning", "numpy")
    }
    assert list(found.weights) == ["net.safetensors"]
    assert found.processor
    assert found.date.count("-") == 2
    text = json.dumps(found.to_dict())
    assert Provenance.from_dict(json.loads(text)) == found
    assert os.uname().nodename not in text
    assert str(tmp_path) not in text
    assert current(weights=[tmp_path]).weights == found.weights
    weights.write_bytes(b"2")
    assert current(weights=[weights]).weights != found.weights


HERE = current(dtype="float32")
OTHERS = {
    "code": replace(HERE, code="0123", commit="ab" * 20, dirty=True),
    "drake": replace(HERE, versions={**HERE.versions, "drake": "1.40.0"}),
    "weights": replace(HERE, weights={"a": "1"}),
    "bfloat16": replace(HERE, dtype="bfloat16"),
    "not known": Provenance(),
}


@pytest.fixture(params=["folder", "x.jsonl"])
def result(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    path = tmp_path / request.param
    if path.suffix:
        path.touch()
    else:
        path.mkdir()
    return path


@pytest.mark.parametrize("what", OTHERS)
def test_other_code_does_not_go_on(what: str, result: Path) -> None:
    now = replace(HERE, weights={"b": "2"})
    record_run(result, Run("benchmark", OTHERS[what]))
    with pytest.raises(ManifestError, match=what) as error:
        check_resumable(result, now)
    assert str(result) in str(error.value)
    assert "--mix" in str(error.value)
    check_resumable(result, now, mix=True)
    record_run(result, Run("benchmark", now), resumed=True)
    # And it is not forgotten.
    with pytest.raises(ManifestError, match=what):
        check_resumable(result, now)
    found = map(Provenance.from_dict, read_runs(result))
    assert describe(found).startswith("**Mixed**")


def test_the_same_code_goes_on(result: Path) -> None:
    without = replace(HERE, dtype="", date="2020-01-01", processor="x")
    record_run(result, Run("benchmark", without, seeds=[1]))
    # A network may join where none was used, on another processor.
    now = replace(HERE, weights={"a": "1"})
    check_resumable(result, now)
    run = Run("benchmark", now, "name: x\n", seeds=range(2, 4))
    for _ in range(2):
        record_run(result, run, resumed=True)
    assert [r["seeds"] for r in read_runs(result)] == [[1], [2, 3]]
    record_run(result, run)
    assert len(read_runs(result)) == 1


def test_other_settings_do_not_go_on(result: Path) -> None:
    record_run(result, Run("measure", HERE, settings={"load": (1, 2)}))
    check_resumable(result, HERE, settings={"load": (1, 2), "new": 3})
    words = r"begun with load \[1, 2\], not \[1\]"
    with pytest.raises(ManifestError, match=words):
        check_resumable(result, HERE, settings={"load": [1]}, mix=True)


def test_results_without_a_manifest_are_of_unknown_code(result: Path) -> None:
    for made_by, words in (
        ([], "not known"),
        ([HERE, OTHERS["drake"]], r"drake 1\.40\.0, now"),
    ):
        with pytest.raises(ManifestError, match=words):
            check_resumable(result, HERE, made_by=made_by)
    check_resumable(result, HERE, made_by=[HERE])
    record_run(result, Run("benchmark", HERE), resumed=True)
    found = [r["command"] for r in read_runs(result)]
    assert found == ["unknown", "benchmark"]


@pytest.mark.parametrize("text", ["{", "[]", '{"runs": 3}', '{"runs": [3]}'])
def test_a_damaged_manifest_is_named(text: str, result: Path) -> None:
    manifest_path(result).write_text(text)
    with pytest.raises(ManifestError, match=f"{MANIFEST} is damaged"):
        check_resumable(result, HERE, mix=True)


def test_a_line_for_reports() -> None:
    one = Provenance(
        commit="0123456789abcdef",
        dirty=True,
        code="c0de",
        versions={"drake": "1.51.1"},
        processor="Z80",
        date="2026-11-30",
    )
    other = replace(
        one, weights={"n": "aa"}, dtype="float32", date="2026-12-01"
    )
    code = "Made by code c0de (commit 0123456789 with changes); drake 1.51.1"
    line = describe([one, other, one], scenario="demo", seeds=[3, 1, 2, 9, 1])
    assert line == (
        f"{code}; weights n aa; float32; Z80; scenario demo; seeds 1 to 3, 9; "
        "2026-11-30 to 2026-12-01."
    )
    line = describe([one], seeds=[4])
    assert line == f"{code}; no weights; Z80; seed 4; 2026-11-30."
