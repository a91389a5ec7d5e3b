import builtins
import dataclasses
from collections.abc import Callable, Iterator
from typing import Any, cast

import numpy as np
import pytest

from tests.dataset.whole import bare_sample
from xray_drake.dataset.sample import Sample
from xray_drake.inspector.dataset import (
    DrakeViewer,
    Points,
    PyPIViewer,
    sample_layers,
    show_sample,
    start_viewer,
)


@pytest.fixture
def sample() -> Sample:
    mask = np.zeros((24, 32), bool)
    mask[10:14, 12:20] = True
    bare = bare_sample(mask, focal_length=35.0, heap_seed=1)
    depth = bare.depth.copy()
    depth[0, 0] = 0
    X_WC, X_WT = bare.X_WC.copy(), bare.X_WT.copy()
    X_WC[0, 3] = X_WT[0, 3] = 0.1
    return dataclasses.replace(
        bare,
        depth=depth,
        occupancy=mask * 0.5,
        X_WC=X_WC,
        X_WT=X_WT,
        target_size=np.array([0.16, 0.08, 0.005]),
    )


def test_layers_lie_where_they_belong(sample: Sample) -> None:
    layers: dict[str, Any] = sample_layers(sample)
    scene = layers["scene"]
    on_target = scene.positions[:, 2] > 0.004
    assert on_target.sum() == 32  # all of its pixels
    assert 50 < (~on_target).sum() < 24 * 32 // 4  # some of the others
    assert len(np.unique(scene.colors, axis=0)) == 2
    assert scene.positions.shape == scene.colors.shape
    assert scene.positions[:, 2].min() == pytest.approx(0, abs=1e-6)
    assert scene.positions[:, 2].max() == pytest.approx(0.005, abs=1e-6)

    occupancy = layers["occupancy"]
    assert occupancy.positions.shape == (32, 3)
    np.testing.assert_allclose(occupancy.positions[:, 2], 0.001)
    assert np.all(occupancy.colors == occupancy.colors[0])

    box = layers["target"]
    assert box.ends.shape == (12, 2, 3)
    np.testing.assert_allclose(
        np.ptp(box.ends.reshape(-1, 3), axis=0), sample.target_size
    )
    np.testing.assert_allclose(
        box.ends.mean(axis=(0, 1)), sample.X_WT[:3, 3], atol=1e-12
    )
    lengths = np.linalg.norm(box.ends[:, 0] - box.ends[:, 1], axis=1)
    np.testing.assert_allclose(
        np.sort(lengths), np.repeat([0.005, 0.08, 0.16], 4)
    )

    camera = layers["camera"]
    assert camera.ends.shape == (8, 2, 3)
    np.testing.assert_allclose(camera.ends[:4, 0], [[0.1, 0, 0.8]] * 4)
    np.testing.assert_allclose(camera.ends[4:, :, 2], 0.7)

    blank = dataclasses.replace(sample, occupancy=np.zeros(sample.shape))
    nothing = cast(Points, sample_layers(blank)["occupancy"])
    assert len(nothing.positions) == 0


def test_drakes_meshcat_shows_it(sample: Sample) -> None:
    viewer = start_viewer()
    assert isinstance(viewer, DrakeViewer)
    show_sample(viewer, sample)
    for path in ("scene", "occupancy", "camera", "target"):
        assert viewer.meshcat.HasPath(f"sample/{path}")
    assert viewer.url.startswith("http://localhost:")
    nothing = Points(np.zeros((0, 3)), np.zeros((0, 3)), 0.001)
    viewer.show("sample/occupancy", nothing)
    assert not viewer.meshcat.HasPath("sample/occupancy")


class _Node:
    """Stands in for meshcat.Visualizer, which starts a server."""

    def __init__(self, calls: list[tuple[str, str, Any]], path: str) -> None:
        self._calls, self._path = calls, path

    def __getitem__(self, path: str) -> "_Node":
        return _Node(self._calls, path)

    def set_object(self, shown: Any) -> None:
        # Everything that is sent is packed by lower().
        self._calls.append(("set", self._path, shown.lower()))

    def delete(self) -> None:
        self._calls.append(("delete", self._path, None))

    def set_transform(self, matrix: np.ndarray) -> None:
        self._calls.append(("transform", self._path, matrix))

    def set_property(self, key: str, value: Any) -> None:
        self._calls.append(("property", self._path, (key, value)))

    def url(self) -> str:
        return "http://127.0.0.1:7000/static/"


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, str, Any]]:
    import meshcat

    made: list[tuple[str, str, Any]] = []
    monkeypatch.setattr(meshcat, "Visualizer", lambda: _Node(made, ""))
    return made


def test_the_meshcat_of_pypi_shows_it(
    sample: Sample, calls: list[tuple[str, str, Any]]
) -> None:
    viewer = PyPIViewer()
    show_sample(viewer, sample)
    shown = {path: what for kind, path, what in calls if kind == "set"}
    kinds = {path: what["object"]["type"] for path, what in shown.items()}
    assert kinds == {
        "sample/scene": "Points",
        "sample/occupancy": "Points",
        "sample/camera": "LineSegments",
        "sample/target": "LineSegments",
    }
    assert shown["sample/camera"]["materials"][0]["color"] == 0x1A4CCC
    nothing = Points(np.zeros((0, 3)), np.zeros((0, 3)), 0.001)
    viewer.show("sample/occupancy", nothing)
    assert calls[-1] == ("delete", "sample/occupancy", None)


@pytest.fixture
def without(
    monkeypatch: pytest.MonkeyPatch,
) -> Iterator[Callable[[str], None]]:
    missing: list[str] = []
    original = builtins.__import__

    def importing(name: str, *rest: Any, **more: Any) -> Any:
        if name.split(".")[0] in missing or name in missing:
            raise ImportError(f"no {name}")
        return original(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", importing)
    yield missing.append


def test_which_meshcat_is_started(
    calls: list[tuple[str, str, Any]], without: Callable[[str], None]
) -> None:
    without("xray_drake.drawing.meshcat_layers")  # as where Drake is missing
    assert isinstance(start_viewer(), PyPIViewer)
    without("meshcat")
    with pytest.raises(RuntimeError, match="pip install meshcat"):
        start_viewer()
