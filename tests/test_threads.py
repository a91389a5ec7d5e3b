import os
from pathlib import Path

import pytest

from xray_drake import threads
from xray_drake.threads import usable_cores


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine of eight cores; its cgroups are written by the test."""
    monkeypatch.setattr(os, "cpu_count", lambda: 8)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)))
    monkeypatch.setattr(threads, "_CGROUPS", tmp_path / "cgroup")
    monkeypatch.setattr(threads, "_OWN_CGROUPS", tmp_path / "own")
    return tmp_path


def test_no_more_cores_than_the_affinity_allows(
    machine: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert usable_cores() == 8
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3})
    assert usable_cores() == 1
    monkeypatch.delattr(os, "sched_getaffinity")  # macOS
    assert usable_cores() == 8


@pytest.mark.parametrize(
    ("own", "limits", "cores"),
    [
        ("0::/", {"cpu.max": "max 100000"}, 8),
        ("0::/", {"cpu.max": "250000 100000"}, 3),
        ("0::/", {"cpu.max": "50000 100000"}, 1),
        ("0::/a/b", {"a/b/cpu.max": "max 100000", "a/cpu.max": "2 1"}, 2),
        ("0::/../host", {"cpu.max": "400000 100000"}, 4),
        (
            "4:cpu,cpuacct:/d",
            {
                "cpu,cpuacct/d/cpu.cfs_quota_us": "200000",
                "cpu,cpuacct/d/cpu.cfs_period_us": "100000",
            },
            2,
        ),
        (
            "1:cpu:/",
            {"cpu/cpu.cfs_quota_us": "-1", "cpu/cpu.cfs_period_us": "100000"},
            8,
        ),
        ("2:memory:/x", {}, 8),
    ],
)
def test_no_more_cores_than_the_quota_pays_for(
    machine: Path, own: str, limits: dict[str, str], cores: int
) -> None:
    """Of both versions of cgroups, as containers and SLURM set them."""
    (machine / "own").write_text(f"{own}\n")
    for name, text in limits.items():
        path = machine / "cgroup" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"{text}\n")
    assert usable_cores() == cores
