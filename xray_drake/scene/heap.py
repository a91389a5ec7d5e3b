"""Heaps: objects at rest in the bin, and how they are dropped."""

from dataclasses import dataclass, field

import numpy as np

from xray_drake.configuration import choice, count, number
from xray_drake.geometry.resting import lean, resting_poses
from xray_drake.geometry.tilt import tilt
from xray_drake.scene.object_model import ObjectModel

ARRANGEMENTS = ("one_by_one", "dump")

RELEASES = ("in_turn", "as_is")
"""How objects that are given poses come to rest: each is let go when those
before it rest, or all at once."""


@dataclass
class HeapConfig:
    """How a heap is dropped (PROTOCOL.md, "Scene")."""

    # "one_by_one", or "dump": all but the target fall together from a tray.
    arrangement: str = choice("one_by_one", ARRANGEMENTS)
    # The heap's centre is uniform within ± this in x and y, m.
    center_range: float = number(0.03, "[0, 1]")
    # Standard deviation of the objects' offsets from the centre, m.
    offset_sigma: float = number(0.045, "[0, 1]")
    # The offsets are truncated here, m.
    offset_limit: float = number(0.12, "(0, 1]")
    # The target falls from this height, flat or as it is to lie, m.
    target_height: float = number(0.05, "[0, 2]")
    # The others fall from this height over the floor ...
    drop_height: float = number(0.20, "(0, 2]")
    # ... or this much above the heap, whichever is higher, m.
    heap_clearance: float = number(0.05, "[0, 2]")
    # One object is released every so many seconds.
    drop_period: float = number(0.14, "(0, 10]")
    # "dump": size of the tray in x and y, m, ...
    tray_length: float = number(0.30, "(0, 2]")
    tray_width: float = number(0.24, "(0, 2]")
    # ... and its height over the floor, m.
    tray_height: float = number(0.25, "(0, 2]")
    # What rests sleeps while the others fall.
    sleep: bool = False
    # At rest: no body moves more than rest_motion (m) in rest_round (s).
    rest_round: float = number(0.3, "(0, 60]")
    rest_motion: float = number(0.0005, "(0, 0.1]")
    # One that has been waited for for late_after (s) may move late_motion (m):
    # one creeping object shall not cost the heap.
    late_after: float = number(1.2, "[0, 600]")
    late_motion: float = number(0.001, "(0, 0.1]")
    # A heap that does not rest is calmed every so many seconds: for calm_time,
    # s, its bodies' rotation is damped calm_factor times as strongly.
    calm_period: float = number(1.2, "(0, 600]")
    calm_time: float = number(0.3, "[0, 60]")
    calm_factor: float = number(20.0, "[1, 10000]")
    # A heap that does not rest within this time after the last drop failed, s.
    rest_timeout: float = number(8.0, "(0, 600]")
    # A picture taken while the heap grows waits for the heap to move less than
    # snapshot_motion (m) in 0.1 s, but no longer than snapshot_timeout (s).
    snapshot_motion: float = number(0.002, "(0, 0.1]")
    snapshot_timeout: float = number(0.5, "[0, 60]")
    # A failed heap is drawn again this often before giving up.
    max_attempts: int = count(10, "[1, 1000]")


class HeapError(RuntimeError):
    """A heap that failed: what happened, and to which seed."""


@dataclass(frozen=True, eq=False)
class Heap:
    """Objects at rest in the bin.

    Attributes:
        target: the object searched for.
        objects: the distractors that stayed in the bin.
        poses: name to (4, 4) pose X_WO, target included, m.
        seed: what makes the heap again.
        num_dropped: distractors dropped, those that fell outside included.
        attempts: draws it took; more than 1 where heaps of this seed failed.
        settle_time: simulated time from the first drop to rest, s.
        growth: the heap as it was when fewer objects had been dropped, where
            this was asked for; not wholly at rest.
        failures: one line each draw of this seed that failed before.
        redrawn: of the attempts, those that rested but did not count, since
            too much was seen of the target; see
            :func:`xray_drake.station.objects.make_heap`.
    """

    target: ObjectModel
    objects: tuple[ObjectModel, ...]
    poses: dict[str, np.ndarray] = field(repr=False)
    seed: int
    num_dropped: int
    attempts: int
    settle_time: float
    growth: tuple["Heap", ...] = field(default=(), repr=False)
    failures: tuple[str, ...] = ()
    redrawn: int = 0

    @property
    def target_tilt(self) -> float:
        """How far the target leans, rad.

        The angle between its z axis and the vertical, either face down; for
        one that does not lie flat, that to its nearest resting pose.
        """
        X_WT = self.poses[self.target.name]
        if not self.target.is_flat:
            poses = resting_poses(self.target.visual, self.target.p_OCom)
            return lean(poses, X_WT)
        return tilt(X_WT)

    @property
    def models(self) -> tuple[ObjectModel, ...]:
        """The target, then the distractors."""
        return (self.target, *self.objects)
