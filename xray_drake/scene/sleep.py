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
    between two ``AdvanceTo``, never from within a system of the diagram. Who
    sleeps is part of the context: one sleeper serves many simulations.

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
        self._filters: set[FilterId] = set()

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
        for old in [f for f in self._filters if manager.IsActive(f)]:
            manager.RemoveDeclaration(old)
            self._filters.remove(old)
        if names:
            geometries: list[GeometryId] = list(self._fixed)
            for name in names:
                geometries += self._plant.GetCollisionGeometriesForBody(
                    self._objects[name].body
                )
            self._filters.add(
                manager.ApplyTransient(
                    CollisionFilterDeclaration().ExcludeWithin(
                        GeometrySet(geometries)
                    )
                )
            )
