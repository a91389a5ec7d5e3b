"""Where the target is not, remembered from look to look.

The paper's future work: "we will look to add memory to the policy so that if
objects shift into previously free space, the distribution will not cover that
area" (section VI).
"""

from dataclasses import dataclass, field, replace

import numpy as np

from xray_drake.geometry.camera import PinholeCamera
from xray_drake.geometry.floor_grid import Floor, observed_heights
from xray_drake.geometry.readings import check_shapes, depth_readings
from xray_drake.messages import Message, freeze_arrays
from xray_drake.policy.beyond.shifts import (
    Look,
    distance_to,
    renamed,
    shifts_seen,
)

_REACH = 1.1
"""How much farther the target may reach than it is long: in perspective it is
seen larger away from the axis."""

_LEAST_ROOM = 0.5
"""Share of the target's area that must be left for it."""


@dataclass(frozen=True, eq=False)
class Belief(Message):
    """What is known after a look.

    Attributes:
        look: the look.
        recalled: (H, W) bool: the target is not here, by earlier looks.
        empty: (H, W) bool: the target is not here, by all looks.
        number: actions that had been done when it was formed; −1 for none.
    """

    look: Look = field(default_factory=Look)
    recalled: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), bool))
    empty: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), bool))
    number: int = -1

    def __post_init__(self) -> None:
        freeze_arrays(self, recalled=bool, empty=bool)


@dataclass(frozen=True, eq=False)
class TargetMemory:
    """Keeps what was once seen free of the target, until it may have moved.

    A look shows the target's absence in two ways: where a surface lower than
    the target is seen, none of it is; and where part of it is seen, all of it
    is within its length of that part. Both are kept per pixel, for one camera
    that does not move.

    The target moves only if something that touches it does, and over a share of
    its way at most. So at each further look, for everything that is seen to
    have moved (:func:`~xray_drake.policy.beyond.shifts.shifts_seen`): where the
    target may have been within its own length of that thing, it may now be as
    much farther, and what is that near is empty no longer. What was lifted may
    have dragged it a little, even if nothing else moved. If the target is seen
    where it should not be, or no room is left for it, the memory was wrong, and
    lets go.

    The belief becomes a distribution by the inference itself: in the depth
    image *as remembered*, the floor takes the place of whatever covers what is
    known to be empty. A pose that needs such a pixel is then excluded as it
    would be if the floor were still seen.

    It keeps no state of its own.

    Attributes:
        target_size: (3,) length, width, thickness of the target, m.
        floor: inside of the bin's.
        noise: a depth that changes by less has not changed, m.
        least_pixels: what changed in fewer has not moved.
        share: a thing that moves may drag the target over this share of its
            way. At 1 nothing is remembered but where nothing has moved: what a
            thing that slides or topples covers is never farther from where it
            was than its way. But it does not drag a flat target by friction,
            since the floor holds that at least as well; it must hook or push
            it.
        drag: a thing that is lifted may drag it this far though nothing else
            moves, m.
        margin: around what was not seen empty, so much is not taken for empty,
            m.
        low: where a surface lower than this share of the target's thickness is
            seen, the target is not.
        names_last: instances have the same names at every look; else they are
            known by their places.
    """

    target_size: np.ndarray
    floor: Floor
    noise: float = 0.002
    least_pixels: int = 8
    share: float = 0.25
    drag: float = 0.01
    margin: float = 0.003
    low: float = 0.5
    names_last: bool = True

    def update(
        self,
        belief: Belief,
        look: Look,
        camera: PinholeCamera,
        *,
        lifted: str = "",
        slipped: str = "",
    ) -> Belief:
        """Adds a look to a belief.

        Args:
            belief: after the look before; an empty one at the start.
            look: what is seen now.
            camera: of both looks.
            lifted: what was taken out of the bin in between.
            slipped: what was lifted and fell back.

        Raises:
            ValueError: an image of another shape than the camera's.
        """
        check_shapes(
            {
                "depth image": look.depth,
                "target mask": look.target,
                "instance image": look.instances.labels,
            },
            camera,
        )
        scale = camera.floor_scale
        reach = _REACH * scale * float(np.hypot(*self.target_size[:2]))
        heights = observed_heights(
            depth_readings(look.depth, camera), camera, 0.0
        )
        low = (heights > -np.inf) & (heights < self.low * self.target_size[2])
        low &= ~look.target
        floor = self._floor(camera)

        recalled = np.zeros(camera.shape, dtype=bool)
        if belief.empty.shape == camera.shape:
            recalled = self._still_empty(
                belief, look, floor, scale, reach, lifted, slipped
            )
            if (recalled & look.target).any():
                recalled &= ~_near(look.target, reach)
            room = np.count_nonzero(floor & ~recalled & ~low)
            area = scale**2 * self.target_size[0] * self.target_size[1]
            if room < _LEAST_ROOM * area:
                recalled = np.zeros(camera.shape, dtype=bool)

        seen = floor & low & ~_near(~low, self.margin * scale)
        if look.target.any():
            seen |= floor & ~_near(look.target, reach)
        return Belief(look, recalled, recalled | seen)

    def recall(self, belief: Belief, camera: PinholeCamera) -> np.ndarray:
        """Returns the (H, W) float32 depth image as remembered, m."""
        depth = belief.look.depth
        away = belief.recalled & ~belief.look.target
        if not away.any():
            return depth
        floor = camera.plane_depth(0.0).astype(np.float32)
        seen_lower = np.isfinite(depth) & (depth >= floor)
        return np.where(away & ~seen_lower, floor, depth)

    def _still_empty(
        self,
        belief: Belief,
        look: Look,
        floor: np.ndarray,
        scale: float,
        reach: float,
        lifted: str,
        slipped: str,
    ) -> np.ndarray:
        """Returns what was empty, without where the target can have come."""
        before = belief.look
        if not self.names_last:
            instances = renamed(before.instances, look.instances, gone=lifted)
            look = replace(look, instances=instances)
        shifts = shifts_seen(
            before,
            look,
            scale,
            lifted=lifted,
            noise=self.noise,
            least_pixels=self.least_pixels,
        )
        target = {before.target_name, look.target_name} - {""}
        if target & {lifted, slipped}:
            return np.zeros_like(floor)
        ways = []
        for shift in shifts:
            # The target itself moves all its way.
            share = 1.0 if shift.name in target else self.share
            ways.append((shift.where, share * shift.distance))
        for name in (lifted, slipped):
            if name in before.instances.names:
                where = before.instances.mask(name)
                ways.append((where, self.drag * scale))
        still = belief.empty.copy()
        possible = floor & ~belief.empty
        for where, distance in ways:
            still &= ~_near(possible & _near(where, reach), distance)
        return still

    def _floor(self, camera: PinholeCamera) -> np.ndarray:
        """Returns the (H, W) bool pixels whose rays meet the bin floor."""
        p_W = camera.unproject(camera.plane_depth(0.0))[..., :2]
        planes = self.floor.half_planes(0.0)
        return (p_W @ planes[:, :2].T <= planes[:, 2]).all(axis=-1)


def _near(mask: np.ndarray, distance: float) -> np.ndarray:
    """Returns the (H, W) bool pixels within ``distance`` of a mask's."""
    if not mask.any():
        return np.zeros(mask.shape, dtype=bool)
    return distance_to(mask) <= distance
