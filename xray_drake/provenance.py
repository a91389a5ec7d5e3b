"""Where results come from: the manifest that every run writes beside them.

A manifest says which code, versions, weights and number type made a result, on
what processor, of which scenario and seeds, and when. It names no machine, no
user and no path but those that were given.
"""

import hashlib
import json
import os
import platform
import subprocess
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from datetime import date
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from xray_drake import __version__
from xray_drake.files import (
    append_json_lines,
    read_json_lines,
    sole_writer,
    write_whole_file,
)
from xray_drake.resources import models_dir

MANIFEST = "manifest.json"
"""In a folder of results; ``NAME.manifest.json`` beside a file of them."""

NO_CHECKOUT = "not a checkout"
UNKNOWN = "unknown"

_PACKAGES = ("drake", "torch", "lightning", "numpy")

_TREE = ("xray_drake", "models", "pyproject.toml")
"""What decides results, of a checkout."""

_NOT_CODE = {"networks", "pictures"}
"""Folders of models: weights have a digest of their own."""

_DIGITS = 16


class ManifestError(ValueError):
    """Results that cannot be gone on with, or a damaged manifest."""


@dataclass(frozen=True)
class Provenance:
    """What makes results, beside what is asked for.

    Attributes:
        commit: of the checkout that the package runs from, or
            :data:`NO_CHECKOUT`, or :data:`UNKNOWN` where git cannot tell.
        dirty: files of the package differ from the commit, or are not in it;
            None where that is not known.
        code: digest of the package's source and models, 16 hex digits; the
            same in a wheel as in the checkout that it was built from. Empty
            where it is not known.
        versions: of the packages that decide results, by their names.
        weights: digest of each file of weights that was used, by its name.
        dtype: in which networks compute, "float32" or as training calls
            it; empty where none does.
        processor: model and architecture.
        date: of the run, ISO 8601.
    """

    commit: str = UNKNOWN
    dirty: bool | None = None
    code: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    weights: Mapping[str, str] = field(default_factory=dict)
    dtype: str = ""
    processor: str = ""
    date: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Returns it as JSON takes it."""
        return asdict(self)

    @classmethod
    def from_dict(cls, tree: Mapping[str, Any]) -> "Provenance":
        """Reads it from a manifest's run, or from a record that has its keys.

        What is missing is unknown.
        """
        return cls(
            **{name: tree[name] for name in asdict(cls()) if name in tree}
        )

    def differences(self, now: "Provenance") -> list[str]:
        """Says in what later results would differ, a few words each.

        Weights and number types are compared where both use a network.
        """
        found = []
        if not self.code or self.code != now.code:
            then = self._source() if self.code else "code that is not known"
            found.append(f"{then}, now {now._source()}")
        for name in sorted({*self.versions, *now.versions}):
            pair = [p.versions.get(name, "none") for p in (self, now)]
            if self.versions and pair[0] != pair[1]:
                found.append(f"{name} {pair[0]}, now {pair[1]}")
        used = [sorted(p.weights.values()) for p in (self, now)]
        if all(used) and used[0] != used[1]:
            found.append(f"weights {_named(self)}, now {_named(now)}")
        types = self.dtype, now.dtype
        if all(types) and types[0] != types[1]:
            found.append(f"{types[0]}, now {types[1]}")
        return found

    def _source(self) -> str:
        commit = self.commit
        if commit not in (NO_CHECKOUT, UNKNOWN):
            commit = f"commit {commit[:10]}{' with changes' * bool(self.dirty)}"
        return f"code {self.code or UNKNOWN} ({commit})"


@dataclass(frozen=True)
class Run:
    """One run, as its manifest has it.

    Attributes:
        command: its name.
        provenance: what made it.
        scenario: as YAML; of several, one document each.
        seeds: of its heaps, or the one that all follows from.
        settings: whatever else was asked for, as JSON takes it.
    """

    command: str
    provenance: Provenance
    scenario: str = ""
    seeds: Sequence[int] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Returns the run as JSON takes it."""
        return {
            "command": self.command,
            **self.provenance.to_dict(),
            "scenario": self.scenario,
            "seeds": list(self.seeds),
            "settings": dict(self.settings),
        }


def current(*, weights: Iterable[Path] = (), dtype: str = "") -> Provenance:
    """Returns the provenance of what this process makes.

    Args:
        weights: files, or folders of them; what is not there is left out.
        dtype: in which networks compute.
    """
    commit, dirty = _checkout()
    return Provenance(
        commit=commit,
        dirty=dirty,
        code=_code(),
        versions=versions(),
        weights=_weights(weights),
        dtype=dtype,
        processor=_processor(),
        date=date.today().isoformat(),
    )


@cache
def versions() -> Mapping[str, str]:
    """Returns the versions that results depend on, of what is installed."""
    found = {"xray_drake": __version__}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def manifest_path(result: Path) -> Path:
    """Returns where the manifest of a folder, or of a file, of results is."""
    if result.is_dir():
        return result / MANIFEST
    return result.with_name(f"{result.name}.{MANIFEST}")


def read_runs(result: Path) -> list[dict[str, Any]]:
    """Reads the runs of a manifest; without one there are none.

    Args:
        result: folder or file of results.

    Raises:
        ManifestError: it is damaged.
    """
    path = manifest_path(result)
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
        runs = tree["runs"]
        if not all(isinstance(run, dict) for run in runs):
            raise TypeError("a run is no mapping")
    except FileNotFoundError:
        return []
    except (ValueError, KeyError, TypeError) as error:
        reason = " ".join(str(error).split())
        raise ManifestError(
            f"{path} is damaged ({reason}): restore it, or choose another "
            "place for the results"
        ) from error
    return runs


def check_resumable(
    result: Path,
    now: Provenance,
    *,
    settings: Mapping[str, Any] | None = None,
    made_by: Iterable[Provenance] = (),
    mix: bool = False,
) -> None:
    """Refuses to go on with results that other code or weights have made.

    Args:
        result: folder or file that holds some.
        now: what would go on.
        settings: of its run, those that must be as they were.
        made_by: what the results say themselves.
        mix: let other code, versions, weights and number types in.

    Raises:
        ManifestError: they were made by other code, versions, weights or
            another number type, or it is not known by what, or with other
            settings; or the manifest is damaged.
    """
    runs = read_runs(result)
    for run in runs:
        _check_settings(result, run.get("settings", {}), settings or {})
    if mix:
        return
    before = [Provenance.from_dict(run) for run in runs]
    for then in [*before, *made_by] or [Provenance()]:
        if found := then.differences(now):
            raise ManifestError(
                f"{result} holds results of {'; '.join(found)}: choose "
                "another place, or give --mix to go on all the same"
            )


def _check_settings(
    result: Path, before: Mapping[str, Any], now: Mapping[str, Any]
) -> None:
    # As JSON gives it back.
    for key, value in json.loads(json.dumps(now)).items():
        if before.get(key, value) != value:
            raise ManifestError(
                f"{result} was begun with {key} {before[key]!r}, not {value!r}"
                ": go on with the same, or choose another place"
            )


def record_run(result: Path, run: Run, *, resumed: bool = False) -> None:
    """Writes a run into the manifest beside its results.

    Args:
        result: folder or file of results; the folder is there.
        run: that begins, or has ended.
        resumed: keep the runs before it; what is without a manifest is of an
            unknown one.

    Raises:
        ManifestError: the manifest is damaged.
        OSError: it cannot be written.
    """
    runs = read_runs(result) if resumed else []
    if resumed and not runs:
        runs = [Run(UNKNOWN, Provenance()).to_dict()]
    # As JSON gives it back.
    this = json.loads(json.dumps(run.to_dict()))
    if this not in runs:
        runs.append(this)
    text = json.dumps({"runs": runs}, indent=1, ensure_ascii=False) + "\n"
    write_whole_file(manifest_path(result), text.encode())


@contextmanager
def open_lines(
    path: Path, run: Run, *, mix: bool = False
) -> Iterator[tuple[list[dict[str, Any]], Callable[[dict[str, Any]], None]]]:
    """Opens a file of results, a JSON object a line, to go on with it.

    Yields:
        What it holds, and a function that adds a line.

    Args:
        path: of the file; its folder is there.
        run: with settings that must be as they were.
        mix: see :func:`check_resumable`.

    Raises:
        InUseError: another process writes it.
        LinesError: a line cannot be read.
        ManifestError: see :func:`check_resumable`.
        OSError: it cannot be read or written.
    """
    with sole_writer(path):
        lines = read_json_lines(path)
        if lines:
            check_resumable(
                path, run.provenance, settings=run.settings, mix=mix
            )
        record_run(path, run, resumed=bool(lines))
        with append_json_lines(path) as add:
            yield lines, add


def made_by(result: Path) -> str:
    """Says in a line what made results, as their manifest has it.

    Raises:
        ManifestError: it is damaged.
    """
    runs = read_runs(result)
    return describe(
        map(Provenance.from_dict, runs or [{}]),
        seeds=(seed for run in runs for seed in run.get("seeds", ())),
    )


def describe(
    provenances: Iterable[Provenance],
    *,
    scenario: str = "",
    seeds: Iterable[int] = (),
) -> str:
    """Says in a line what made results; "Mixed" where they do not agree.

    Args:
        provenances: of each result.
        scenario: its name.
        seeds: of the results.
    """
    every = list(provenances)
    sources = _distinct(p._source() for p in every)
    packages = _distinct(
        ", ".join(f"{name} {text}" for name, text in p.versions.items())
        for p in every
    )
    weights = _distinct(_named(p) for p in every)
    types = _distinct(p.dtype for p in every)
    mixed = max(map(len, (_distinct(p.code for p in every), packages))) > 1
    mixed |= len(weights) > 1 or len(types) > 1
    mixed |= any(not p.code for p in every) and any(p.code for p in every)
    days = sorted({p.date for p in every if p.date})
    parts = [
        " and ".join(sources),
        " and ".join(packages),
        f"weights {' and '.join(weights)}" if weights else "no weights",
        " and ".join(types),
        " and ".join(_distinct(p.processor for p in every)),
        f"scenario {scenario}" if scenario else "",
        _numbers(seeds),
        " to ".join(dict.fromkeys((days[0], days[-1]))) if days else "",
    ]
    line = "; ".join(part for part in parts if part)
    return f"**Mixed**: {line}." if mixed else f"Made by {line}."


def _distinct(texts: Iterable[str]) -> list[str]:
    return sorted({text for text in texts if text})


def _named(provenance: Provenance) -> str:
    return ", ".join(f"{n} {d}" for n, d in provenance.weights.items())


def _numbers(seeds: Iterable[int]) -> str:
    """Writes seeds in short: "seeds 0 to 29, 99"."""
    spans: list[list[int]] = []
    for seed in sorted(set(seeds)):
        if spans and seed == spans[-1][1] + 1:
            spans[-1][1] = seed
        else:
            spans.append([seed, seed])
    if not spans:
        return ""
    words = ", ".join(" to ".join(map(str, dict.fromkeys(s))) for s in spans)
    return f"{'seed' if words.isdigit() else 'seeds'} {words}"


@cache
def _checkout() -> tuple[str, bool | None]:
    """Returns commit and whether it was changed, of a checkout of our own.

    The package may lie inside somebody else's repository.
    """
    root = Path(__file__).resolve().parents[1]
    if not (root / ".git").exists() or not _is_ours(root / "pyproject.toml"):
        return NO_CHECKOUT, None
    try:
        commit = _git(root, "rev-parse", "HEAD").strip()
        changed = _git(root, "status", "--porcelain", "--", *_TREE)
    except (OSError, subprocess.SubprocessError):
        return UNKNOWN, None
    return commit, bool(changed.strip())


def _is_ours(project: Path) -> bool:
    try:
        tree = tomllib.loads(project.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return tree.get("project", {}).get("name") == "xray-drake"


def _git(root: Path, *arguments: str) -> str:
    # Within a hook, git's variables name another repository.
    environment = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith("GIT_")
    } | {"GIT_CEILING_DIRECTORIES": str(root.parent)}
    return subprocess.run(
        ["git", "--no-optional-locks", *arguments],
        cwd=root,
        env=environment,
        capture_output=True,
        text=True,
        errors="replace",
        check=True,
        timeout=20,
    ).stdout


@cache
def _code() -> str:
    package, models = Path(__file__).resolve().parent, models_dir()
    files = {
        f"xray_drake/{path.relative_to(package).as_posix()}": path
        for path in package.rglob("*.py")
        if models not in path.parents
    }
    for path in models.rglob("*"):
        inside = path.relative_to(models)
        if path.is_file() and inside.parts[0] not in _NOT_CODE:
            files[f"models/{inside.as_posix()}"] = path
    digest = hashlib.sha256()
    for name in sorted(files):
        data = files[name].read_bytes()
        digest.update(f"{name}\0{len(data)}\0".encode())
        digest.update(data)
    return digest.hexdigest()[:_DIGITS]


def _weights(paths: Iterable[Path]) -> dict[str, str]:
    found: dict[str, str] = {}
    for path in paths:
        inside = path.glob("*.safetensors") if path.is_dir() else [path]
        for file in sorted(inside):
            if file.is_file():
                stat = file.stat()
                key = file.resolve(), stat.st_mtime_ns, stat.st_size
                name = file.name
                if found.get(name, _digest(*key)) != _digest(*key):
                    name = str(file)
                found[name] = _digest(*key)
    return found


@cache
def _digest(path: Path, changed: int, size: int) -> str:
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256")
    return digest.hexdigest()[:_DIGITS]


@cache
def _processor() -> str:
    model = ""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        model = platform.processor()
    else:
        for line in text.splitlines():
            key, _, value = line.partition(":")
            if key.strip() == "model name":
                model = " ".join(value.split())
                break
    machine = platform.machine()
    return f"{model} ({machine})" if model not in ("", machine) else machine
