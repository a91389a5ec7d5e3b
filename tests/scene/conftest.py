"""A cache of imported meshes for each test."""

from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XRAY_DRAKE_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "meshes"
