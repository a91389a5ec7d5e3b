"""Lets what rests fall asleep, and wakes what is disturbed."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, EventStatus
from scipy.spatial.transform import Rotation

from xray_drake.configuration import number
from xray_drake.geometry.convex import CUBE_AXES
from xray_drake.scene.plant import PlantObject
from xray_drake.scene.rest import CORNERS, box_corners
from xray_drake.scene.sleep import Sleeper

_GRAVITY = np.array([0.0, 0.0, -9.81])


@dataclass
class SleepConfig:
    """When bodies fall asleep and what wakes them."""

    # s between two looks at the bodies.
    look_period: float = number(0.025, "(0, 10]")
    # A body falls asleep when no point of it has moved farther than
    # quiet_motion (m) for quiet_time (s): 3 mm/s is still.
    quiet_motion: float = number(0.0005, "(0, 0.1]")
    quiet_time: float = number(0.15, "(0, 60]")
    # A body that is faster than this wakes what it is about to touch and what
    # that touches, m/s. Slower ones lean on sleepers as on the bin.
    impact_speed: float = number(0.3, "[0, 100]")
    # A body that has moved this far since it last did wakes the neighbours
    # that it had, since they may have lost their support, and those that it
    # has now, m.
    drift: float = number(0.003, "(0, 1]")
    # Neighbours are bodies whose pieces, within 26 planes each, are nearer than
    # this, m.
    margin: float = number(0.001, "[0, 0.1]")
    # What a mover is about to come nearer to than this stays awake, m.
    reach: float = number(0.004, "[0, 0.1]")


class _Look(NamedTuple):
    """What was seen of the n bodies.

    ``corners``: (n, 8, 3) of their bounding boxes, m; ``low`` and ``high``:
    (m, 13) extents of their m pieces along the axes, m.
    """

    time: float
    corners: np.ndarray
    low: np.ndarray
    high: np.ndarray


class SleepMonitor:
    """A simulator monitor that puts resting bodies to sleep.

    A body that has been still for a while is locked in place by a
    :class:`Sleeper`, so that its contacts with other sleepers cost nothing.
    Fast bodies wake what they are about to touch, together with its
    neighbours; bodies that have moved wake their neighbours, whose support
    they may have been. That includes bodies that are set to another pose from
    outside, asleep or not (one that sleeps goes on sleeping there).

    A heap that fell asleep is close to rest but not at rest: what was locked
    under load gives way when it wakes. Wake all, and look whether they move,
    before relying on it (:func:`xray_drake.scene.drop.drop_heap` does).

    Movers are bodies of another kind, a gripper's: they never sleep, and what
    is near them, or near what is drawn of them (a suction cup's lip is soft and
    does not collide), does not sleep either, nor do its neighbours and what
    lies on those.

    Give it to ``Simulator.set_monitor``, see :func:`attach_sleep`, or call it
    from another monitor with the root context after each step. Who sleeps is
    part of the context, but how long bodies have been still is remembered
    here, so give each simulation a monitor of its own. When time goes back all
    have to be still anew; :meth:`forget` makes it so too.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        scene_graph: SceneGraph,
        objects: Iterable[PlantObject],
        *,
        movers: Iterable[RigidBody] = (),
        config: SleepConfig | None = None,
    ) -> None:
        """Builds the monitor.

        Args:
            plant: finalized.
            scene_graph: of the plant.
            objects: bodies that can sleep.
            movers: bodies that wake what is near.
            config: when they do.

        Raises:
            ValueError: no objects, the world body has collision geometry, or a
                mover has none or one that is not bounded.
        """
        self._plant = plant
        self._items = list(objects)
        if not self._items:
            raise ValueError("there is no body that could sleep")
        self._index = {item.name: i for i, item in enumerate(self._items)}
        self._config = config or SleepConfig()
        self._sleeper = Sleeper(plant, scene_graph, self._items)
        joints = [item.joint for item in self._items]
        self._q = np.array([j.position_start() for j in joints])[:, None]
        self._v = np.array([j.velocity_start() for j in joints])[:, None]
        self._corners = np.array(
            [box_corners(item.model, np.eye(4)) for item in self._items]
        )
        self._radius = np.linalg.norm(self._corners, axis=-1).max(axis=-1)
        pieces = [
            (index, piece)
            for index, item in enumerate(self._items)
            for piece in item.model.pieces
        ]
        sizes = [len(piece) for _, piece in pieces]
        self._points = np.concatenate([piece for _, piece in pieces])
        self._starts = np.cumsum([0, *sizes[:-1]])
        self._owner = np.array([index for index, _ in pieces])
        self._point_owner = np.repeat(self._owner, sizes)
        self._movers = [
            (body, _hulls(plant, scene_graph, body)) for body in movers
        ]
        self._last: _Look | None = None
        self._anchor = _Look(0.0, *[np.empty(0)] * 3)
        self._still = np.empty(0)
        self._still_since = np.empty(0)

    def asleep(self, root: Context) -> frozenset[str]:
        """Returns the names of the bodies that sleep in a root context."""
        return self._sleeper.asleep(root)

    def set_asleep(self, root: Context, names: Iterable[str]) -> None:
        """Lets exactly these bodies sleep; see :class:`Sleeper`."""
        names, before = frozenset(names), self.asleep(root)
        if names == before:
            return
        self._sleeper.set_asleep(root, names)
        self._restart(before - names, root.get_time())

    def wake(self, root: Context, names: Iterable[str]) -> None:
        """Wakes bodies; those that are awake have to be still anew to sleep.

        Raises:
            KeyError: an object that the monitor does not know.
        """
        names = self._known(names)
        self._sleeper.set_asleep(root, self.asleep(root) - names)
        self._restart(names, root.get_time())

    def forget(self) -> None:
        """Forgets what it has seen; the next look is the first."""
        self._last = None

    def __call__(
        self, root: Context, *, awake: Iterable[str] = ()
    ) -> EventStatus:
        """Looks at the bodies, if it is time to; see :meth:`look`."""
        since = np.inf if self._last is None else self._last.time
        elapsed = root.get_time() - since
        if not 0 <= elapsed < self._config.look_period - 1e-9:
            self.look(root, awake=awake)
        return EventStatus.DidNothing()

    def look(self, root: Context, *, awake: Iterable[str] = ()) -> None:
        """Looks at the bodies, wakes some and lets others sleep.

        Args:
            root: root context of the simulation.
            awake: names of bodies that must not sleep since something pulls
                at them. Their neighbours, what lies on those, and on that, do
                not sleep either: asleep, they would hold them fast.

        Raises:
            KeyError: an object that the monitor does not know.
        """
        config = self._config
        context = self._plant.GetMyContextFromRoot(root)
        look, anchor = self._see(context, root.get_time()), self._anchor
        pulled = self._mask(self._known(awake)) | self._met(context, look)
        if self._last is None or look.time < self._last.time:
            anchor = look
            self._still = look.corners.copy()
            self._still_since = np.full(len(self._items), look.time)
        self._last = look
        # Said so that a body that went to NaN is not still.
        moved = ~(_distance(look.corners, self._still) <= config.quiet_motion)
        self._still[moved] = look.corners[moved]
        self._still_since[moved] = look.time

        drifted = _distance(look.corners, anchor.corners) > config.drift
        disturbed = (
            self._left_or_met(drifted, look, anchor)
            | self._struck(context, look, pulled)
            | self._pulled_along(pulled, look)
        )
        self._anchor = self._renewed(anchor, look, drifted)
        self._still_since[disturbed] = look.time
        still = look.time - self._still_since >= config.quiet_time - 1e-9
        asleep = self._mask(self.asleep(root))
        sleeping = (asleep | still) & ~disturbed
        self._sleeper.set_asleep(
            root, [self._items[i].name for i in np.flatnonzero(sleeping)]
        )

    def _known(self, names: Iterable[str]) -> frozenset[str]:
        names = frozenset(names)
        unknown = names - self._index.keys()
        if unknown:
            raise KeyError(f"no such sleepers: {', '.join(sorted(unknown))}")
        return names

    def _mask(self, names: frozenset[str]) -> np.ndarray:
        return np.array([item.name in names for item in self._items])

    def _restart(self, names: Iterable[str], time: float) -> None:
        if self._last is not None:
            for name in names:
                self._still_since[self._index[name]] = time

    def _see(self, context: Context, time: float) -> _Look:
        q = self._plant.GetPositions(context)[self._q + np.arange(7)]
        R = Rotation.from_quat(q[:, [1, 2, 3, 0]]).as_matrix()
        p = q[:, 4:]
        owner = self._point_owner
        points = np.einsum("nij,nj->ni", R[owner], self._points) + p[owner]
        along = points @ CUBE_AXES.T
        return _Look(
            time,
            np.einsum("nij,nkj->nki", R, self._corners) + p[:, None],
            np.minimum.reduceat(along, self._starts),
            np.maximum.reduceat(along, self._starts),
        )

    def _met(self, context: Context, look: _Look) -> np.ndarray:
        """Says what movers may be near until the next look, (n,) bool."""
        met = np.zeros(len(self._items), dtype=bool)
        config = self._config
        for body, hulls in self._movers:
            X_WB = self._plant.EvalBodyPoseInWorld(context, body)
            V_WB = self._plant.EvalBodySpatialVelocityInWorld(context, body)
            arms = hulls @ X_WB.rotation().matrix().T
            v = V_WB.translational() + np.cross(V_WB.rotational(), arms)
            here = arms + X_WB.translation()
            way = np.concatenate([here, here + config.look_period * v], axis=1)
            along = way @ CUBE_AXES.T
            low = along.min(axis=1, keepdims=True) - config.reach
            high = along.max(axis=1, keepdims=True) + config.reach
            meet = (low <= look.high) & (high >= look.low)
            pieces = meet.all(axis=-1).any(axis=0)
            met[self._owner[pieces]] = True
        return met

    def _renewed(
        self, anchor: _Look, look: _Look, drifted: np.ndarray
    ) -> _Look:
        """Returns the anchor with the drifted bodies as they are now."""
        pieces = drifted[self._owner, None]
        return _Look(
            look.time,
            np.where(drifted[:, None, None], look.corners, anchor.corners),
            np.where(pieces, look.low, anchor.low),
            np.where(pieces, look.high, anchor.high),
        )

    def _left_or_met(
        self, drifted: np.ndarray, look: _Look, anchor: _Look
    ) -> np.ndarray:
        """Says which bodies were near drifted ones, or are now, (n,) bool.

        Wherever a body has been since its anchor, it reaches no more than
        ``drift`` beyond where it was then.
        """
        drift = self._config.drift
        left = self._neighbours(drifted, look, there=anchor, farther=drift)
        return left | self._neighbours(drifted, look)

    def _struck(
        self, context: Context, look: _Look, pulled: np.ndarray
    ) -> np.ndarray:
        """Says which bodies fast ones may strike before the next look.

        And which are near those, where it is not one that is pulled; (n,) bool.
        """
        config, step = self._config, self._config.look_period
        v = self._plant.GetVelocities(context)[self._v + np.arange(6)]
        fast = np.linalg.norm(v[:, 3:], axis=1) > config.impact_speed
        turn = np.linalg.norm(v[:, :3], axis=1) * self._radius * step
        straight = (v[:, 3:] * step) @ CUBE_AXES.T
        fall = straight + (_GRAVITY * step**2) @ CUBE_AXES.T
        back = np.minimum(np.minimum(straight, fall), 0) - turn[:, None]
        forth = np.maximum(np.maximum(straight, fall), 0) + turn[:, None]
        swept = look._replace(
            low=look.low + back[self._owner],
            high=look.high + forth[self._owner],
        )
        struck = self._neighbours(fast & ~pulled, look, there=swept)
        return (
            struck
            | self._neighbours(struck, look)
            | self._neighbours(fast & pulled, look, there=swept)
        )

    def _pulled_along(self, pulled: np.ndarray, look: _Look) -> np.ndarray:
        """Says which bodies a pull at others may move, (n,) bool.

        Those, their neighbours, and what lies on any of them.
        """
        reached, before = pulled | self._neighbours(pulled, look), pulled
        while (reached != before).any():
            before = reached
            reached = before | self._neighbours(before, look, above=True)
        return reached

    def _neighbours(
        self,
        which: np.ndarray,
        look: _Look,
        *,
        there: _Look | None = None,
        farther: float = 0.0,
        above: bool = False,
    ) -> np.ndarray:
        """Says which bodies others come near, (n,) bool.

        Pieces are bounded by the 26 planes across ``CUBE_AXES``, which in a
        heap is much tighter than by a box.

        Args:
            which: (n,) bool, the others.
            look: where all bodies are.
            there: where the others are, if not there.
            farther: beyond the margin within which bodies are neighbours, m.
            above: only bodies with a piece higher than the near piece.
        """
        there, margin = there or look, self._config.margin + farther
        near = np.zeros(len(self._items), dtype=bool)
        for index in np.flatnonzero(which):
            own = self._owner == index
            low, high = there.low[own, None], there.high[own, None]
            meet = (low - margin <= look.high) & (high + margin >= look.low)
            pairs = meet.all(axis=-1)
            if above:
                middle = (low + high)[..., 0]
                pairs &= (look.low + look.high)[:, 0] > middle
            owners = self._owner[pairs.any(axis=0)]
            near[owners[owners != index]] = True
        return near


def _hulls(
    plant: MultibodyPlant, scene_graph: SceneGraph, body: RigidBody
) -> np.ndarray:
    """Returns (n, 8, 3) corners, in the body's frame, of its geometries' boxes.

    Raises:
        ValueError: a geometry that is not bounded, or a body without any.
    """
    inspector = scene_graph.model_inspector()
    hulls = []
    for geometry in (
        *plant.GetCollisionGeometriesForBody(body),
        *plant.GetVisualGeometriesForBody(body),
    ):
        box = inspector.GetObbInGeometryFrame(geometry)
        if box is None:
            raise ValueError(
                f"a mover must be bounded: {inspector.GetName(geometry)} is not"
            )
        X_BG = inspector.GetPoseInFrame(geometry) @ box.pose()
        corners = (2 * CORNERS - 1) * box.half_width()
        hulls.append(corners @ X_BG.rotation().matrix().T + X_BG.translation())
    if not hulls:
        raise ValueError(f"a mover must have geometry: {body.name()} has none")
    return np.array(hulls)


def _distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Largest distance of (n, 8, 3) corners, (n,)."""
    return np.linalg.norm(a - b, axis=-1).max(axis=-1)


def attach_sleep(
    simulator: Simulator,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    objects: Iterable[PlantObject],
    *,
    config: SleepConfig | None = None,
) -> SleepMonitor:
    """Lets the resting bodies of any diagram sleep.

    A simulator has one monitor; this sets it. To have another as well, set one
    that calls both.

    Args:
        simulator: of a diagram that holds the plant.
        plant: finalized.
        scene_graph: of the plant.
        objects: bodies that can sleep, from ``add_object``. What they rest on
            must be a welded body, not the world: see ``add_bin``.
        config: when they sleep.
    """
    monitor = SleepMonitor(plant, scene_graph, objects, config=config)
    simulator.set_monitor(monitor)
    return monitor
