"""Tells whether bodies rest."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np

from xray_drake.messages import Message
from xray_drake.scene.object_model import ObjectModel

_FALLEN = -0.05
"""What is deeper than this has left the cell and falls on, m."""

CORNERS = np.array(list(product((False, True), repeat=3)))
"""(8, 3) bool: which corners of a box are at the upper end along x, y, z."""

_NOISE = 1e-4
"""m. What moves less between two looks is not toppling."""


def box_corners(model: ObjectModel, X_WO: np.ndarray) -> np.ndarray:
    """Returns the (8, 3) corners of an object's bounding box, in the world."""
    low, high = model.visual.bounds
    corners = np.where(CORNERS, high, low)
    return corners @ X_WO[:3, :3].T + X_WO[:3, 3]


def corners_in_cell(
    placed: Iterable[tuple[ObjectModel, np.ndarray]],
) -> np.ndarray:
    """Returns (8 n, 3) corners of the boxes of n objects, in the world, m.

    Those of objects that have fallen out of the cell are left out: they fall
    for ever, and nothing waits for them.

    Args:
        placed: objects and their 4×4 poses X_WO.
    """
    corners = [
        box_corners(model, X_WO)
        for model, X_WO in placed
        if not X_WO[2, 3] < _FALLEN  # What is lost to NaN is not at rest.
    ]
    return np.concatenate([np.zeros((0, 3)), *corners])


@dataclass(frozen=True, eq=False)
class RestTest(Message):
    """Whether nothing has moved far for a whole round.

    Speeds alone mislead: a creeping heap is slow, a light body may quiver in
    place, and one at its turning point is slow for an instant. So points fixed
    to the bodies are compared from round to round.

    Attributes:
        motion: no point may move farther than this within a round, m.
        round_time: length of a round, s.
        since: when the round began, s.
        reference: (n, 3) the points then, in the world, m.
        at_rest: the last whole round was quiet.
    """

    motion: float
    round_time: float
    since: float = -np.inf
    reference: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    at_rest: bool = False

    def is_due(self, time: float) -> bool:
        """Says whether the round is over at ``time`` (s)."""
        return time - self.since >= self.round_time - 1e-9

    def update(self, time: float, points: np.ndarray) -> "RestTest":
        """Returns the test after a look.

        Args:
            time: now, s.
            points: (n, 3) points fixed to the bodies, in the world, m; another
                number of points begins a new round.
        """
        if len(points) == len(self.reference):
            if not self.is_due(time):
                return self
            moved = np.linalg.norm(points - self.reference, axis=-1)
            at_rest = bool(moved.max(initial=0.0) <= self.motion)
        else:
            at_rest = False
        return RestTest(self.motion, self.round_time, time, points, at_rest)


def topples(looks: Sequence[np.ndarray]) -> bool:
    """Says whether a body moves ever faster, as what begins to topple does.

    Args:
        looks: points fixed to the bodies, (n, 3) m each, at equal intervals.
    """
    first = np.linalg.norm(looks[1] - looks[0], axis=-1)
    last = np.linalg.norm(looks[-1] - looks[-2], axis=-1)
    return bool(((last > _NOISE) & (last > 1.5 * first)).any())
