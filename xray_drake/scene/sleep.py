"""Puts resting bodies to sleep: Drake simulates all bodies all the time."""

from collections.abc import Iterable

import numpy as np
from pydrake.geometry import (
    CollisionFilterDeclaration,
    FilterId,
    GeometryId,
    GeometrySet,
    SceneGraph,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context

from xray_drake.scene.plant import PlantObject


class Sleeper:
    """Locks bodies in place and lets their contacts rest.

    A sleeping body's joint is locked, and contacts among sleeping bodies and
    the fixed ones are filtered out, so that they cost nothing. It does not
    wake by itself when it is touched: who moves something near it wakes it
    first. Works on the context of a running simulation, so from a monitor or
    between two ``AdvanceTo``, never from within a system of the diagram.

    The fixed bodies must be welded bodies, not the world body: see
    :func:`xray_drake.scene.plant.add_bin`.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        scene_graph: SceneGraph,
        objects: Iterable[PlantObject],
        *,
        fixed: Iterable[str] = ("bin", "tote"),
    ) -> None:
        """Builds the sleeper.

        Args:
            plant: finalized.
            scene_graph: of the plant.
            objects: bodies that can sleep.
            fixed: names of welded bodies that sleeping ones rest on.
        """
        self._plant = plant
        self._scene_graph = scene_graph
        self._objects = {item.name: item for item in objects}
        self._fixed = [
            geometry
            for name in fixed
            for geometry in plant.GetCollisionGeometriesForBody(
                plant.GetBodyByName(name)
            )
        ]
        self._filter: FilterId | None = None
        self._asleep: frozenset[str] = frozenset()

    @property
    def asleep(self) -> frozenset[str]:
        """Names of the bodies that sleep."""
        return self._asleep

    def set_asleep(self, root: Context, names: Iterable[str]) -> None:
        """Lets exactly these bodies sleep and wakes all others.

        Args:
            root: root context of the simulation.
            names: which objects.

        Raises:
            KeyError: an object that the sleeper does not know.
        """
        wanted = frozenset(names)
        context = self._plant.GetMyMutableContextFromRoot(root)
        self._recall(context)
        if wanted == self._asleep:
            return
        for name in wanted - self._asleep:
            joint = self._objects[name].joint
            joint.set_angular_velocity(context, np.zeros(3))
            joint.set_translational_velocity(context, np.zeros(3))
            joint.Lock(context)
        # Contacts come back before a body is free to fall.
        self._renew_filter(root, wanted)
        for name in self._asleep - wanted:
            self._objects[name].joint.Unlock(context)
        self._asleep = wanted

    def _recall(self, context: Context) -> None:
        """Forgets who slept in another context, as after a reset.

        One joint tells: in a new context none is locked.
        """
        for name in self._asleep:
            if not self._objects[name].joint.is_locked(context):
                self._asleep, self._filter = frozenset(), None
            return

    def _renew_filter(self, root: Context, names: frozenset[str]) -> None:
        context = self._scene_graph.GetMyMutableContextFromRoot(root)
        manager = self._scene_graph.collision_filter_manager(context)
        if self._filter is not None:
            manager.RemoveDeclaration(self._filter)
            self._filter = None
        if names:
            geometries: list[GeometryId] = list(self._fixed)
            for name in names:
                geometries += self._plant.GetCollisionGeometriesForBody(
                    self._objects[name].body
                )
            self._filter = manager.ApplyTransient(
                CollisionFilterDeclaration().ExcludeWithin(
                    GeometrySet(geometries)
                )
            )
