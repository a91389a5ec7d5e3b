"""Drops objects into the bin until the heap rests (paper section IV.A)."""

import gc
import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant, MultibodyPlantConfig
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder
from scipy.stats import truncnorm

from xray_drake.cell.bin import Bin
from xray_drake.faults import BREAKDOWNS
from xray_drake.geometry.resting import resting_poses
from xray_drake.scene.contact import ContactConfig, angular_damping
from xray_drake.scene.heap import (
    ARRANGEMENTS,
    RELEASES,
    Heap,
    HeapConfig,
    HeapError,
)
from xray_drake.scene.object_model import ObjectModel
from xray_drake.scene.plant import (
    PlantObject,
    add_bin,
    add_objects,
    add_plant,
    default_plant_config,
)
from xray_drake.scene.rest import box_corners, topples
from xray_drake.scene.sleep_monitor import SleepMonitor
from xray_drake.seeding import stream

_logger = logging.getLogger(__name__)

_PARKING_HEIGHT = 50.0
"""m. Objects wait there, locked and apart, until they are dropped."""

_TRAY_GAP = 0.001
"""m, between the objects that wait in the tray."""

_SNAPSHOT_ROUND = 0.1
"""s, over which a growing heap is watched before its picture is taken."""

_LOOKS = 3
"""How often a heap is looked at within a round of the test for rest."""

_CALM_RATE = 20.0
"""1/s, at which a calmed body loses speed."""

_DOZE_TIME = 1.0
_DOZE_STEP = 0.05
"""s. A heap is given so long to fall asleep, looked at so often."""


def drop_heap(
    target: ObjectModel,
    objects: Sequence[ObjectModel],
    seed: int,
    *,
    bin_: Bin | None = None,
    config: HeapConfig | None = None,
    contact: ContactConfig | None = None,
    plant_config: MultibodyPlantConfig | None = None,
    snapshots: Collection[int] = (),
    progress: Callable[[float], None] | None = None,
) -> Heap:
    """Drops the target, then the objects, and lets them rest.

    Objects that end outside the bin are removed. A heap that fails (NaN, no
    rest in time, target outside the bin) is drawn again from the next
    sub-seed. The result depends on the arguments alone: on one version of
    Drake the same arguments give the same heap, bit by bit.

    Args:
        target: dropped first, flat; one that does not lie so in a resting pose
            that is drawn with its probability.
        objects: dropped in this order.
        seed: of the heap's centre, offsets and orientations.
        bin_: what they are dropped into; by default the nominal cell's.
        config: how to drop.
        contact: the objects' material.
        plant_config: physics.
        snapshots: numbers of dropped objects at which the growing heap is
            remembered too (one by one only); see ``Heap.growth``. All of them
            is the heap itself.
        progress: called now and then with the share done, in [0, 1].

    Raises:
        HeapError: ``max_attempts`` draws failed.
        ValueError: no objects, two of the same name, an arrangement that does
            not exist, or snapshots that cannot be taken.
    """
    config = config or HeapConfig()
    if config.arrangement not in ARRANGEMENTS:
        raise ValueError(
            f"no arrangement is called {config.arrangement!r}: choose one of "
            f"{', '.join(ARRANGEMENTS)}"
        )
    if not objects:
        raise ValueError("a heap needs at least one object beside the target")
    names = [model.name for model in (target, *objects)]
    if len(set(names)) != len(names):
        raise ValueError(f"objects of a heap need distinct names: {names}")
    if snapshots and config.arrangement != "one_by_one":
        raise ValueError("a heap that is dumped has no snapshots")
    if not all(0 < count <= len(objects) for count in snapshots):
        raise ValueError(
            f"snapshots {sorted(snapshots)} of a heap of {len(objects)} "
            f"objects: each must be from 1 to {len(objects)}"
        )
    failures: list[str] = []
    box, rest = bin_ or Bin(), (contact, plant_config, progress)
    for attempt in range(1, config.max_attempts + 1):
        try:
            drop = _Drop(target, objects, box, config, *rest)
            heap = drop.run(seed, attempt, snapshots)
            return replace(heap, failures=tuple(failures))
        except HeapError as error:
            failures.append(
                f"heap of seed {seed}, draw {attempt} failed: {error}"
            )
            _logger.warning(failures[-1])
        finally:
            gc.collect()
    raise HeapError(
        f"seed {seed}: {config.max_attempts} heaps in a row failed, the last: "
        f"{failures[-1]}. Try other objects or physics settings"
    )


def release_heap(
    target: ObjectModel,
    objects: Sequence[ObjectModel],
    poses: Mapping[str, np.ndarray],
    *,
    release: str,
    order: Sequence[str] = (),
    bin_: Bin | None = None,
    config: HeapConfig | None = None,
    contact: ContactConfig | None = None,
    plant_config: MultibodyPlantConfig | None = None,
    progress: Callable[[float], None] | None = None,
) -> Heap:
    """Lets objects go at given poses, and waits until they rest.

    Objects that end outside the bin are removed.

    Args:
        target: what is searched for.
        objects: the others.
        poses: name to the 4×4 pose X_WO at which it is let go, m.
        release: one of :data:`RELEASES`.
        order: names of all in the order in which they are let go; by default
            the target's comes first.
        bin_: in which they lie; by default the nominal cell's.
        config: how they come to rest.
        contact: their material.
        plant_config: physics.
        progress: called now and then with the share done, in [0, 1].

    Raises:
        HeapError: they do not come to rest, or the target leaves the bin.
        ValueError: there is no such release.
    """
    if release not in RELEASES:
        raise ValueError(
            f"no release is called {release!r}: choose one of "
            f"{', '.join(RELEASES)}"
        )
    drop = _Drop(
        target,
        objects,
        bin_ or Bin(),
        config or HeapConfig(),
        contact,
        plant_config,
        progress,
    )
    try:
        return drop.release(poses, order, in_turn=release == RELEASES[0])
    finally:
        gc.collect()


class _Drop:
    def __init__(
        self,
        target: ObjectModel,
        objects: Sequence[ObjectModel],
        bin_: Bin,
        config: HeapConfig,
        contact: ContactConfig | None,
        plant_config: MultibodyPlantConfig | None,
        progress: Callable[[float], None] | None,
    ) -> None:
        self._bin = bin_
        self._config = config
        self._contact = contact or ContactConfig()
        self._progress = progress or (lambda share: None)
        builder = DiagramBuilder()
        plant, scene_graph = add_plant(
            builder, plant_config or default_plant_config()
        )
        add_bin(plant, bin_)
        self._plant: MultibodyPlant = plant
        self._all = add_objects(
            plant, [target, *objects], contact=contact, visible=False
        )
        self._target, *self._others = self._all
        plant.Finalize()
        self._simulator = Simulator(builder.Build())
        self._root: Context = self._simulator.get_mutable_context()
        self._context: Context = plant.GetMyMutableContextFromRoot(self._root)
        self._parked: set[str] = set()
        self._sleep = SleepMonitor(plant, scene_graph, self._all)
        if config.sleep:
            self._simulator.set_monitor(self._sleep)

    def run(self, seed: int, attempt: int, snapshots: Collection[int]) -> Heap:
        config = self._config
        rng = self._rng = stream(seed, "heap", attempt)
        for item in self._all:
            self._park(item)
        center = rng.uniform(-config.center_range, config.center_range, 2)
        yaw = RollPitchYaw(0, 0, rng.uniform(0, 2 * np.pi)).ToRotationMatrix()
        R = yaw @ _lying(self._target.model, seed, attempt)
        self._release(
            self._target, R, center + self._offset(), config.target_height
        )
        self._advance(config.drop_period)
        growth: list[Heap] = []
        if config.arrangement == "dump":
            self._dump()
        else:
            for count in range(1, len(self._others) + 1):
                self._drop_one(self._others[count - 1], center)
                if count in snapshots and count < len(self._others):
                    growth.append(self._snapshot(seed, attempt, count))
        self._settle()
        self._progress(1.0)
        heap = self._result(seed, attempt, len(self._others))
        return replace(heap, growth=tuple(growth))

    def release(
        self,
        poses: Mapping[str, np.ndarray],
        order: Sequence[str],
        *,
        in_turn: bool,
    ) -> Heap:
        for item in self._all:
            self._park(item)
        named = {item.name: item for item in self._all}
        for released, name in enumerate(order or named):
            item = named[name]
            self._sleep.wake(self._root, [name])
            self._parked.discard(name)
            X_WO = np.array(poses[name])
            R = RotationMatrix.ProjectToRotationMatrix(X_WO[:3, :3])
            self._place(item, RigidTransform(R, X_WO[:3, 3]))
            if in_turn:
                self._settle()
            self._progress(released / (len(self._all) + 4))
        if not in_turn:
            self._settle()
        self._progress(1.0)
        return self._result(0, 1, len(self._others))

    def _drop_one(self, item: PlantObject, center: np.ndarray) -> None:
        config = self._config
        above = self._heap_top() + config.heap_clearance
        height = max(config.drop_height, above)
        R = _random_rotation(self._rng)
        self._release(item, R, center + self._offset(), height)
        self._advance(config.drop_period)
        self._progress(len(self._dropped()) / (len(self._all) + 4))

    def _dump(self) -> None:
        """Stacks the objects loosely in the tray and lets all fall."""
        config, rng = self._config, self._rng
        half = np.array([config.tray_length, config.tray_width]) / 2
        placed: list[tuple[np.ndarray, np.ndarray, float]] = []
        for item in self._others:
            R = _random_rotation(rng)
            points = item.model.visual.vertices @ R.matrix().T
            low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
            # What is wider than the tray stands over both its edges.
            ends = np.stack([-half - low, half - high])
            xy = rng.uniform(ends.min(axis=0), ends.max(axis=0))
            low, high = low + xy, high + xy
            below = [
                top
                for least, most, top in placed
                if (least < high).all() and (most > low).all()
            ]
            z = max(below, default=config.tray_height) + _TRAY_GAP
            self._release(item, R, xy, z)
            placed.append((low, high, z + float(np.ptp(points[:, 2]))))
        self._advance(config.drop_period)

    def _offset(self) -> np.ndarray:
        config = self._config
        limit = config.offset_limit / config.offset_sigma
        drawn = truncnorm(-limit, limit, scale=config.offset_sigma)
        return drawn.rvs(size=2, random_state=self._rng)

    def _park(self, item: PlantObject) -> None:
        """Locks an object far away, at rest, where it costs nothing."""
        x = 2.0 * self._all.index(item)
        self._place(item, RigidTransform([x, 0.0, _PARKING_HEIGHT]))
        item.joint.Lock(self._context)
        self._parked.add(item.name)

    def _release(
        self, item: PlantObject, R: RotationMatrix, xy: np.ndarray, z: float
    ) -> None:
        """Puts an object with its lowest point at height z, at rest, free."""
        lowest = (item.model.visual.vertices @ R.matrix().T)[:, 2].min()
        self._sleep.wake(self._root, [item.name])
        self._parked.discard(item.name)
        self._place(item, RigidTransform(R, [xy[0], xy[1], z - lowest]))

    def _place(self, item: PlantObject, X_WO: RigidTransform) -> None:
        item.joint.SetPose(self._context, X_WO)
        item.joint.set_angular_velocity(self._context, np.zeros(3))
        item.joint.set_translational_velocity(self._context, np.zeros(3))

    def _pose(self, item: PlantObject) -> np.ndarray:
        return item.body.EvalPoseInWorld(self._context).GetAsMatrix4()

    def _dropped(self) -> list[PlantObject]:
        return [item for item in self._all if item.name not in self._parked]

    def _heap_top(self) -> float:
        tops = [0.0]
        for item in self._dropped():
            X = self._pose(item)
            if self._bin.is_over(X[:3, 3]):
                heights = item.model.visual.vertices @ X[2, :3] + X[2, 3]
                tops.append(float(heights.max()))
        return max(tops)

    def _advance(self, duration: float) -> None:
        try:
            self._simulator.AdvanceTo(self._root.get_time() + duration)
        except BREAKDOWNS as error:
            raise HeapError(f"the simulation stopped: {error}") from error
        if not np.isfinite(self._plant.GetPositions(self._context)).all():
            raise HeapError("the simulation went to NaN")

    def _settle(self) -> None:
        """Waits until nothing has moved for a whole round.

        As ``RestTest``, but looked at more often, and later more tolerant.
        """
        config = self._config
        deadline = self._root.get_time() + config.rest_timeout
        late = self._root.get_time() + config.late_after
        calm_at = self._root.get_time() + config.calm_period
        if config.sleep:
            self._doze(deadline)
        looks: list[np.ndarray] = []
        while self._root.get_time() < deadline:
            if self._remove_outside():
                looks = []
            if self._root.get_time() > calm_at:
                self._calm()
                calm_at = self._root.get_time() + config.calm_period
                looks = []
            looks = [*looks[-_LOOKS:], self._corners()]
            moved = np.linalg.norm(looks[-1] - np.array(looks), axis=-1)
            in_time = self._root.get_time() < late
            allowed = config.rest_motion if in_time else config.late_motion
            still = float(moved.max()) <= allowed
            if still and len(looks) > _LOOKS and not topples(looks):
                return
            if not still:
                looks = looks[-1:]
            self._advance(config.rest_round / _LOOKS)
        raise HeapError(f"no rest within {config.rest_timeout} s")

    def _calm(self) -> None:
        """Damps all motion for a moment.

        A light body may hop, by micrometres and for ever, because a time step
        is long for it; that carries it, and what it bears, along slowly. Once
        it lies still, it stays so.
        """
        self._damp(self._config.calm_factor, _CALM_RATE)
        self._advance(self._config.calm_time)
        self._damp(1.0, 0.0)

    def _damp(self, factor: float, rate: float) -> None:
        """Damps rotation ``factor`` times as usual, and speed at ``rate``."""
        for item in self._all:
            turn = angular_damping(item.model, self._contact) * factor
            damping = np.repeat([turn, item.model.mass * rate], 3)
            item.joint.SetDampingVector(self._context, damping)

    def _doze(self, deadline: float) -> None:
        """Lets all fall asleep, then wakes them.

        What rests only because it or its neighbours are locked moves then.
        """
        deadline = min(deadline, self._root.get_time() + _DOZE_TIME)
        self._simulator.set_monitor(self._sleep)
        while self._root.get_time() < deadline:
            if len(self._sleep.asleep(self._root)) == len(self._all):
                break
            self._advance(_DOZE_STEP)
            self._remove_outside()
        self._simulator.clear_monitor()
        self._sleep.wake(self._root, [item.name for item in self._dropped()])

    def _corners(self) -> np.ndarray:
        items = self._dropped()
        return np.concatenate(
            [box_corners(item.model, self._pose(item)) for item in items]
        )

    def _snapshot(self, seed: int, attempt: int, count: int) -> Heap:
        deadline = self._root.get_time() + self._config.snapshot_timeout
        while self._root.get_time() < deadline:
            before = self._corners()
            self._advance(_SNAPSHOT_ROUND)
            moved = np.linalg.norm(self._corners() - before, axis=-1)
            if moved.max() <= self._config.snapshot_motion:
                break
        self._remove_outside()
        return self._result(seed, attempt, count)

    def _remove_outside(self) -> bool:
        """Parks what fell outside, so that settling need not wait for it."""
        removed = False
        for item in self._dropped():
            p_WO = self._pose(item)[:3, 3]
            if self._bin.is_over(p_WO):
                continue
            if item is self._target:
                where = p_WO.round(3).tolist()
                raise HeapError(f"the target left the bin, to {where} m")
            self._park(item)
            removed = True
        return removed

    def _result(self, seed: int, attempt: int, num_dropped: int) -> Heap:
        inside = [i for i in self._dropped() if i is not self._target]
        if not inside:
            raise HeapError("all objects fell outside the bin")
        return Heap(
            target=self._target.model,
            objects=tuple(item.model for item in inside),
            poses={i.name: self._pose(i) for i in [self._target, *inside]},
            seed=seed,
            num_dropped=num_dropped,
            attempts=attempt,
            settle_time=self._root.get_time(),
        )


def _lying(target: ObjectModel, seed: int, attempt: int) -> RotationMatrix:
    """Draws how a target lies, all but yaw; flat ones draw nothing."""
    if target.is_flat:
        return RotationMatrix.Identity()
    poses = resting_poses(target.visual, target.p_OCom)
    rng = stream(seed, "resting pose", attempt)
    chosen = rng.choice(len(poses), p=[pose.probability for pose in poses])
    return RotationMatrix.ProjectToRotationMatrix(poses[chosen].R_WO)


def _random_rotation(rng: np.random.Generator) -> RotationMatrix:
    """Uniform on SO(3): a normalized Gaussian quaternion."""
    q = rng.normal(size=4)
    return RotationMatrix(Quaternion(q / np.linalg.norm(q)))
