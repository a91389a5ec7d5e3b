"""Surfaces of objects that only the gripper's pads feel."""

from collections.abc import Iterable

import numpy as np
from pydrake.geometry import (
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    CollisionFilterDeclaration,
    Convex,
    GeometryId,
    GeometrySet,
    ProximityProperties,
    SceneGraph,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, ModelInstanceIndex

from xray_drake.gripper.mounted import MountedGripper
from xray_drake.scene.plant import PlantObject

PAD = "pad"
"""Name of a pad's collision geometry in the model file."""

GRIP = "grip"
"""What the names of the hard copies begin with."""


def add_grip_surfaces(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    gripper: MountedGripper,
    objects: Iterable[PlantObject],
) -> None:
    """Lets the pads feel objects as hard, and all else feel them as they are.

    The objects of a heap are soft, or the heap would not come to rest: between
    two fingers they would give way by centimetres. Point contact is no way out,
    for its normals on convex pieces are wrong by more than 10° once in ten to
    thirty times. So each object gets hard hydroelastic copies of its pieces;
    the pads touch those and not the soft ones, and nothing else touches them.

    Args:
        plant: with everything in it that has collision geometry; not finalized.
        scene_graph: of the plant.
        gripper: from :func:`~xray_drake.gripper.mounted.add_gripper`.
        objects: what can be gripped, from ``add_object``.
    """
    gripped = []
    for item in objects:
        gripped.append(item.body.index())
        friction = CoulombFriction(item.model.friction, item.model.friction)
        for number, vertices in enumerate(item.model.pieces):
            plant.RegisterCollisionGeometry(
                item.body,
                RigidTransform(),
                Convex(
                    points=np.asarray(vertices).T,
                    label=f"{item.name}_{GRIP}_{number}",
                ),
                f"{GRIP}_{number}",
                _hard(friction),
            )
    # Only now, for Drake's lists of geometries do not outlast registering.
    inspector = scene_graph.model_inspector()
    pads: list[GeometryId] = []
    hard: list[GeometryId] = []
    soft: list[GeometryId] = []
    others: list[GeometryId] = []
    models: dict[ModelInstanceIndex, list[GeometryId]] = {
        gripper.carrier_instance: [],
        gripper.finger_instance: [],
    }
    for index in map(BodyIndex, range(plant.num_bodies())):
        body = plant.get_body(index)
        model = models.get(body.model_instance(), [])
        for geometry in plant.GetCollisionGeometriesForBody(body):
            name = inspector.GetName(geometry).split("::")[-1]
            model.append(geometry)
            if index in gripped:
                kind = hard if name.startswith(f"{GRIP}_") else soft
            else:
                kind = pads if name == PAD else others
            kind.append(geometry)
    filters = CollisionFilterDeclaration()
    filters.ExcludeWithin(GeometrySet(hard))
    filters.ExcludeBetween(GeometrySet(hard), GeometrySet([*others, *soft]))
    filters.ExcludeBetween(GeometrySet(pads), GeometrySet(soft))
    # The carrier's capsules overlap with the gripper where the last axes bend.
    filters.ExcludeBetween(*map(GeometrySet, models.values()))
    scene_graph.collision_filter_manager().Apply(filters)


def _hard(friction: CoulombFriction) -> ProximityProperties:
    proximity = ProximityProperties()
    AddContactMaterial(friction=friction, properties=proximity)
    AddRigidHydroelasticProperties(properties=proximity)
    return proximity
