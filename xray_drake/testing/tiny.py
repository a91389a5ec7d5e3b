"""A small heap, put together by hand: quick to build, known in all places."""

from dataclasses import dataclass

import numpy as np

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.messages import InstanceMasks
from xray_drake.perception.ground_truth import instances_from_labels
from xray_drake.scene.heap import Heap
from xray_drake.scene.object_model import ObjectModel, object_from_pieces
from xray_drake.scene.shapes import box
from xray_drake.scene.targets import target_model
from xray_drake.search.diagram import SearchDiagram
from xray_drake.station.scenario import Scenario

_TARGET = "box_2to1"
_YAW = 0.4
_ALONG = np.array([np.cos(_YAW), np.sin(_YAW)])
_MIDDLE = np.array([0.02, -0.03])


@dataclass(frozen=True, eq=False)
class Observation:
    """What the camera sees of a heap, and the truth.

    Attributes:
        depth: (H, W) float32, m.
        labels: (H, W) int16, the number of the body that a pixel shows.
        label_of: object name to its value in ``labels``; of objects that no
            pixel shows, too.
        camera: of both images.
        heap: what is seen.
    """

    depth: np.ndarray
    labels: np.ndarray
    label_of: dict[str, int]
    camera: PinholeCamera
    heap: Heap

    @property
    def instances(self) -> InstanceMasks:
        """The modal masks of the objects that are seen, the target's too."""
        return instances_from_labels(self.labels, self.label_of)


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


def make_tiny_heap() -> Heap:
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


def make_tiny_scenario() -> Scenario:
    """Returns the tiny heap's search, with exact inference."""
    scenario = Scenario(name="tiny", seed=7)
    scenario.scene.num_objects = 4
    scenario.perception.occupancy = "geometric"
    # Or it might draw the target from under the book at once.
    scenario.policy.target_first = False
    return scenario


def observe(diagram: SearchDiagram) -> Observation:
    """Renders the heap of a search as it lies in the default context."""
    context = diagram.CreateDefaultContext()
    name = diagram.scenario.camera.name
    images = [
        np.array(diagram.GetOutputPort(port).Eval(context).data[:, :, 0])
        for port in (f"{name}.depth_image", f"{name}.label_image")
    ]
    for image in images:
        image.setflags(write=False)
    return Observation(
        depth=images[0],
        labels=images[1],
        label_of=dict(diagram.station.labels),
        camera=diagram.GetOutputPort(f"{name}.camera").Eval(context),
        heap=diagram.heap,
    )
