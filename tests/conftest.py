"""A small heap, put together by hand, and what is built from it."""

import os
import tempfile
from dataclasses import dataclass

import numpy as np
import pytest

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.scene.heap import Heap
from xray_drake.scene.object_model import ObjectModel, object_from_pieces
from xray_drake.scene.shapes import box
from xray_drake.scene.targets import target_model
from xray_drake.search.diagram import SearchDiagram, build_search_diagram
from xray_drake.station.scenario import Scenario

_CACHE = tempfile.TemporaryDirectory(prefix="xray_drake_cache_")
os.environ["XRAY_DRAKE_CACHE"] = _CACHE.name
"""Imported meshes are not kept in the user's own cache."""

_TARGET = "box_2to1"
_YAW = 0.4
_ALONG = np.array([np.cos(_YAW), np.sin(_YAW)])
_MIDDLE = np.array([0.02, -0.03])


@dataclass(frozen=True, eq=False)
class Observation:
    """What the overhead camera sees of the tiny heap, and the truth.

    Attributes:
        depth: (H, W) float32, m.
        labels: (H, W) int16.
        label_of: object name to its value in ``labels``.
        camera: of both images.
        heap: what is seen.
    """

    depth: np.ndarray
    labels: np.ndarray
    label_of: dict[str, int]
    camera: PinholeCamera
    heap: Heap


def _block(
    name: str,
    size: tuple[float, float, float],
    color: tuple[float, float, float],
) -> ObjectModel:
    return object_from_pieces(
        name,
        list(box(*size).surfaces),
        density=500.0,
        color=(*color, 1.0),
    )


def _lying(xy: np.ndarray, z: float, yaw: float) -> np.ndarray:
    c, s = np.cos(yaw), np.sin(yaw)
    X_WO = np.eye(4)
    X_WO[:2, :2] = [[c, -s], [s, c]]
    X_WO[:3, 3] = *xy, z
    return X_WO


@pytest.fixture(scope="session")
def tiny_heap() -> Heap:
    """A 2:1 box under a book, one end peeping out, and two bystanders.

    The book lies flat on the target and on a pad of the same thickness; block
    and plank stand apart.
    """
    book = _block("book", (0.08, 0.06, 0.02), (0.2, 0.4, 0.7))
    pad = _block("pad", (0.03, 0.05, 0.005), (0.9, 0.8, 0.3))
    block = _block("block", (0.05, 0.03, 0.06), (0.3, 0.7, 0.4))
    plank = _block("plank", (0.12, 0.03, 0.015), (0.6, 0.5, 0.4))
    return Heap(
        target=target_model(_TARGET),
        objects=(book, pad, block, plank),
        poses={
            _TARGET: _lying(_MIDDLE, 0.0025, _YAW),
            "book": _lying(_MIDDLE + 0.026 * _ALONG, 0.015, _YAW),
            "pad": _lying(_MIDDLE + 0.047 * _ALONG, 0.0025, _YAW),
            "block": _lying(np.array([-0.1, 0.05]), 0.03, 0.3),
            "plank": _lying(np.array([0.05, 0.09]), 0.0075, -0.2),
        },
        seed=7,
        num_dropped=4,
        attempts=1,
        settle_time=0.0,
    )


def _tiny_scenario() -> Scenario:
    scenario = Scenario(name="tiny", seed=7)
    scenario.scene.num_objects = 4
    scenario.perception.occupancy = "exact"
    # Or it might draw the target from under the book at once.
    scenario.policy.target_first = False
    return scenario


@pytest.fixture
def tiny_scenario() -> Scenario:
    """The tiny heap's search, exact inference; free to be changed."""
    return _tiny_scenario()


@pytest.fixture(scope="session")
def tiny_diagram(tiny_heap: Heap) -> SearchDiagram:
    """The search of the tiny heap; contexts are the tests' own."""
    return build_search_diagram(_tiny_scenario(), heap=tiny_heap)


@pytest.fixture(scope="session")
def recorded_observation(tiny_diagram: SearchDiagram) -> Observation:
    """The tiny heap, rendered once."""
    context = tiny_diagram.CreateDefaultContext()
    images = [
        np.array(tiny_diagram.GetOutputPort(name).Eval(context).data[:, :, 0])
        for name in ("overhead.depth_image", "overhead.label_image")
    ]
    for image in images:
        image.setflags(write=False)
    return Observation(
        depth=images[0],
        labels=images[1],
        label_of=dict(tiny_diagram.station.labels),
        camera=tiny_diagram.GetOutputPort("overhead.camera").Eval(context),
        heap=tiny_diagram.heap,
    )
