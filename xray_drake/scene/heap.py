"""Drops objects into the bin until the heap rests (paper section IV.A)."""

import gc
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant, MultibodyPlantConfig
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder
from scipy.stats import truncnorm

from xray_drake.scene.object_model import ObjectModel
from xray_drake.scene.plant import (
    PlantObject,
    add_bin,
    add_object,
    add_objects,
    add_plant,
    default_plant_config,
    inside_bin,
)
from xray_drake.scene.rest import RestTest, box_corners
from xray_drake.seeding import stream

_logger = logging.getLogger(__name__)

_PARKING_HEIGHT = 50.0
"""m. Objects wait there, locked and apart, until they are dropped."""


@dataclass
class HeapConfig:
    """How a heap is dropped (PROTOCOL.md, "Scene")."""

    # The heap's centre is uniform within ± this in x and y, m.
    center_range: float = 0.03
    # Standard deviation of the objects' offsets from the centre, m.
    offset_sigma: float = 0.045
    # The offsets are truncated here, m.
    offset_limit: float = 0.12
    # The target falls flat from this height, m.
    target_height: float = 0.05
    # The others fall from this height over the floor ...
    drop_height: float = 0.20
    # ... or this much above the heap, whichever is higher, m.
    heap_clearance: float = 0.05
    # One object is released every so many seconds.
    drop_period: float = 0.28
    # At rest: no body moves more than rest_motion (m) in rest_round (s).
    rest_round: float = 0.3
    rest_motion: float = 0.0005
    # A heap that does not rest within this time after the last drop failed, s.
    rest_timeout: float = 8.0
    # A failed heap is drawn again this often before giving up.
    max_attempts: int = 10


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
    """

    target: ObjectModel
    objects: tuple[ObjectModel, ...]
    poses: dict[str, np.ndarray] = field(repr=False)
    seed: int
    num_dropped: int
    attempts: int
    settle_time: float

    @property
    def target_tilt(self) -> float:
        """Angle between the target's z axis and the vertical, rad.

        Either face may lie down.
        """
        return float(
            np.arccos(min(1.0, abs(self.poses[self.target.name][2, 2])))
        )

    @property
    def models(self) -> tuple[ObjectModel, ...]:
        """The target, then the distractors."""
        return (self.target, *self.objects)


def drop_heap(
    target: ObjectModel,
    objects: Sequence[ObjectModel],
    seed: int,
    *,
    config: HeapConfig | None = None,
    plant_config: MultibodyPlantConfig | None = None,
    progress: Callable[[float], None] | None = None,
) -> Heap:
    """Drops the target, then the objects one by one, and lets them rest.

    Objects that end outside the bin are removed. A heap that fails (NaN, no
    rest in time, target outside the bin) is drawn again from the next
    sub-seed. The result depends on the arguments alone: on one version of
    Drake the same arguments give the same heap, bit by bit.

    Args:
        target: dropped first, flat.
        objects: dropped in this order.
        seed: of the heap's centre, offsets and orientations.
        config: how to drop.
        plant_config: physics.
        progress: called now and then with the share done, in [0, 1].

    Raises:
        HeapError: ``max_attempts`` draws failed.
        ValueError: no objects, or two of the same name.
    """
    config = config or HeapConfig()
    if not objects:
        raise ValueError("a heap needs at least one object beside the target")
    names = [model.name for model in (target, *objects)]
    if len(set(names)) != len(names):
        raise ValueError(f"objects of a heap need distinct names: {names}")
    reason = ""
    for attempt in range(1, config.max_attempts + 1):
        rng = stream(seed, "heap", attempt)
        try:
            return _Drop(
                target, objects, rng, config, plant_config, progress
            ).run(seed, attempt)
        except HeapError as error:
            reason = str(error)
            _logger.warning(
                "heap of seed %d, draw %d failed: %s", seed, attempt, error
            )
        finally:
            gc.collect()
    raise HeapError(
        f"seed {seed}: {config.max_attempts} heaps in a row failed, the last: "
        f"{reason}. Try other objects or physics settings"
    )


class _Drop:
    def __init__(
        self,
        target: ObjectModel,
        objects: Sequence[ObjectModel],
        rng: np.random.Generator,
        config: HeapConfig,
        plant_config: MultibodyPlantConfig | None,
        progress: Callable[[float], None] | None,
    ) -> None:
        self._config = config
        self._rng = rng
        self._progress = progress or (lambda share: None)
        builder = DiagramBuilder()
        plant, _ = add_plant(builder, plant_config or default_plant_config())
        add_bin(plant)
        self._plant: MultibodyPlant = plant
        self._target = add_object(plant, target)
        self._others = add_objects(plant, objects)
        plant.Finalize()
        self._simulator = Simulator(builder.Build())
        self._context: Context = plant.GetMyMutableContextFromRoot(
            self._simulator.get_mutable_context()
        )
        self._bottoms = {
            item.name: item.model.visual.vertices for item in self._all
        }

    @property
    def _all(self) -> list[PlantObject]:
        return [self._target, *self._others]

    def run(self, seed: int, attempt: int) -> Heap:
        config, rng = self._config, self._rng
        for index, item in enumerate(self._all):
            X = RigidTransform([2.0 * index, 0.0, _PARKING_HEIGHT])
            item.joint.SetPose(self._context, X)
            item.joint.Lock(self._context)
        center = rng.uniform(-config.center_range, config.center_range, 2)
        yaw = RollPitchYaw(0, 0, rng.uniform(0, 2 * np.pi)).ToRotationMatrix()
        self._release(
            self._target, yaw, center + self._offset(), config.target_height
        )
        self._advance(config.drop_period)
        for index, item in enumerate(self._others):
            height = max(
                config.drop_height,
                self._heap_top() + config.heap_clearance,
            )
            self._release(
                item, _random_rotation(rng), center + self._offset(), height
            )
            self._advance(config.drop_period)
            self._progress((index + 1) / (len(self._others) + 4))
        self._settle()
        self._progress(1.0)
        return self._result(seed, attempt)

    def _offset(self) -> np.ndarray:
        config = self._config
        limit = config.offset_limit / config.offset_sigma
        return truncnorm.rvs(
            -limit,
            limit,
            scale=config.offset_sigma,
            size=2,
            random_state=self._rng,
        )

    def _release(
        self, item: PlantObject, R: RotationMatrix, xy: np.ndarray, z: float
    ) -> None:
        """Puts an object with its lowest point at height z, at rest, free."""
        lowest = (self._bottoms[item.name] @ R.matrix().T)[:, 2].min()
        item.joint.Unlock(self._context)
        item.joint.SetPose(
            self._context, RigidTransform(R, [xy[0], xy[1], z - lowest])
        )
        item.joint.set_angular_velocity(self._context, np.zeros(3))
        item.joint.set_translational_velocity(self._context, np.zeros(3))

    def _pose(self, item: PlantObject) -> np.ndarray:
        return item.body.EvalPoseInWorld(self._context).GetAsMatrix4()

    def _points(self, item: PlantObject) -> np.ndarray:
        X = self._pose(item)
        return self._bottoms[item.name] @ X[:3, :3].T + X[:3, 3]

    def _dropped(self) -> list[PlantObject]:
        return [i for i in self._all if not i.joint.is_locked(self._context)]

    def _heap_top(self) -> float:
        tops = [
            self._points(item)[:, 2].max()
            for item in self._dropped()
            if inside_bin(self._pose(item)[:3, 3])
        ]
        return max(tops, default=0.0)

    def _advance(self, duration: float) -> None:
        context = self._simulator.get_mutable_context()
        try:
            self._simulator.AdvanceTo(context.get_time() + duration)
        except RuntimeError as error:
            raise HeapError(f"the simulation stopped: {error}") from error
        if not np.isfinite(self._plant.GetPositions(self._context)).all():
            raise HeapError("the simulation went to NaN")

    def _settle(self) -> None:
        config = self._config
        context = self._simulator.get_context()
        deadline = context.get_time() + config.rest_timeout
        test = RestTest(config.rest_motion, config.rest_round)
        while context.get_time() < deadline:
            self._remove_outside()
            corners = [
                box_corners(item.model, self._pose(item))
                for item in self._dropped()
            ]
            test = test.update(context.get_time(), np.concatenate(corners))
            if test.at_rest:
                return
            self._advance(config.rest_round)
        raise HeapError(f"no rest within {config.rest_timeout} s")

    def _remove_outside(self) -> None:
        """Parks what fell outside, so that settling need not wait for it."""
        for index, item in enumerate(self._all):
            if item.joint.is_locked(self._context):
                continue
            if not inside_bin(self._pose(item)[:3, 3]):
                if item is self._target:
                    p = self._pose(item)[:3, 3].round(3).tolist()
                    raise HeapError(f"the target left the bin, to {p} m")
                X = RigidTransform([2.0 * index, 0.0, _PARKING_HEIGHT])
                item.joint.SetPose(self._context, X)
                item.joint.set_angular_velocity(self._context, np.zeros(3))
                item.joint.set_translational_velocity(
                    self._context, np.zeros(3)
                )
                item.joint.Lock(self._context)

    def _result(self, seed: int, attempt: int) -> Heap:
        inside = [item for item in self._others if item in self._dropped()]
        if not inside:
            raise HeapError("all objects fell outside the bin")
        return Heap(
            target=self._target.model,
            objects=tuple(item.model for item in inside),
            poses={
                item.name: self._pose(item) for item in [self._target, *inside]
            },
            seed=seed,
            num_dropped=len(self._others),
            attempts=attempt,
            settle_time=self._simulator.get_context().get_time(),
        )


def _random_rotation(rng: np.random.Generator) -> RotationMatrix:
    """Uniform on SO(3): a normalized Gaussian quaternion."""
    q = rng.normal(size=4)
    return RotationMatrix(Quaternion(q / np.linalg.norm(q)))
