"""Puts resting bodies to sleep: Drake simulates all bodies all the time."""

from collections.abc import Iterable
from weakref import WeakKeyDictionary

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

_FILTERS: WeakKeyDictionary[SceneGraph, list[FilterId]] = WeakKeyDictionary()
"""All filters ever applied to a scene graph's contexts. A cloned context has
those of the original, and a second sleeper finds those of the first."""


class Sleeper:
    """Locks bodies in place and lets their contacts rest.

    A sleeping body's joint is locked, and contacts among sleeping bodies and
    those welded to the world are filtered out, so that they cost nothing. It
    does not wake by itself when it is touched: who moves something near it
    wakes it first, see :class:`~xray_drake.scene.sleep_monitor.SleepMonitor`.
    Works on the context of a running simulation, so from a monitor or between
    two ``AdvanceTo``, never from within a system of the diagram. Who sleeps is
    part of the context: one sleeper serves many simulations.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        scene_graph: SceneGraph,
        objects: Iterable[PlantObject],
    ) -> None:
        """Builds the sleeper.

        Args:
            plant: finalized.
            scene_graph: of the plant.
            objects: bodies that can sleep.

        Raises:
            ValueError: the world body itself has collision geometry.
        """
        if plant.GetCollisionGeometriesForBody(plant.world_body()):
            raise ValueError(
                "bodies cannot sleep beside collision geometry of the world "
                "body, on which Drake up to 1.51 ends the process: give it to "
                "a body that is welded to the world, as add_bin does"
            )
        self._plant = plant
        self._scene_graph = scene_graph
        self._objects = {item.name: item for item in objects}
        self._fixed = [
            geometry
            for body in plant.GetBodiesWeldedTo(plant.world_body())
            for geometry in plant.GetCollisionGeometriesForBody(body)
        ]
        self._filters = _FILTERS.setdefault(scene_graph, [])

    def asleep(self, root: Context) -> frozenset[str]:
        """Returns the names of the bodies that sleep in a root context."""
        context = self._plant.GetMyContextFromRoot(root)
        return frozenset(
            name
            for name, item in self._objects.items()
            if item.joint.is_locked(context)
        )

    def set_asleep(self, root: Context, names: Iterable[str]) -> None:
        """Lets exactly these bodies sleep and wakes all others.

        Args:
            root: root context of the simulation.
            names: which objects.

        Raises:
            KeyError: an object that the sleeper does not know.
        """
        wanted, asleep = frozenset(names), self.asleep(root)
        if wanted == asleep:
            return
        unknown = wanted - self._objects.keys()
        if unknown:
            raise KeyError(f"no such sleepers: {', '.join(sorted(unknown))}")
        context = self._plant.GetMyMutableContextFromRoot(root)
        for name in wanted - asleep:
            joint = self._objects[name].joint
            joint.set_angular_velocity(context, np.zeros(3))
            joint.set_translational_velocity(context, np.zeros(3))
            joint.Lock(context)
        # Contacts come back before a body is free to fall.
        self._renew_filter(root, wanted)
        for name in asleep - wanted:
            self._objects[name].joint.Unlock(context)

    def _renew_filter(self, root: Context, names: frozenset[str]) -> None:
        context = self._scene_graph.GetMyMutableContextFromRoot(root)
        manager = self._scene_graph.collision_filter_manager(context)
        old = next(filter(manager.IsActive, reversed(self._filters)), None)
        if old is not None:
            manager.RemoveDeclaration(old)
        if names:
            geometries: list[GeometryId] = list(self._fixed)
            for name in names:
                geometries += self._plant.GetCollisionGeometriesForBody(
                    self._objects[name].body
                )
            self._filters.append(
                manager.ApplyTransient(
                    CollisionFilterDeclaration().ExcludeWithin(
                        GeometrySet(geometries)
                    )
                )
            )
