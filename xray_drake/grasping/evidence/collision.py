"""Collision checks of a gripper that comes straight down on a heap."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from pydrake.geometry import (
    Box,
    CollisionFilterDeclaration,
    Convex,
    Cylinder,
    GeometryId,
    QueryObject,
    SceneGraphInspector,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    CoulombFriction,
)
from pydrake.multibody.tree import RigidBody, SpatialInertia
from pydrake.systems.framework import DiagramBuilder

from xray_drake.cell.bin import Bin
from xray_drake.grasping.evidence.approach_shape import box_points
from xray_drake.grasping.gripper_geometry import GripperGeometry
from xray_drake.messages import GraspKind
from xray_drake.scene.object_model import ObjectModel
from xray_drake.scene.plant import add_bin

_POINT_SPACING = 0.0249
"""Of the points that stand for the bin, m."""

_ALONG_X = RotationMatrix.MakeYRotation(np.pi / 2)
"""Turns a cylinder's axis from z to x."""

_FRICTION = CoulombFriction(1.0, 1.0)
_INERTIA = SpatialInertia.SolidSphereWithMass(1.0, 0.01)
"""Of no account: nothing is simulated."""

_OBJECT_AWAY = RigidTransform([0.0, 0.0, 100.0])
_TOOL_AWAY = RigidTransform([0.0, 0.0, -100.0])
"""Poses of bodies that take no part."""


def _points_on(
    inspector: SceneGraphInspector, geometry: GeometryId
) -> np.ndarray:
    """Returns (m, 3) points on the sides of an anchored box, in the world."""
    half = 0.5 * np.array(inspector.GetShape(geometry).size())
    points = box_points(-half, half, _POINT_SPACING)
    return (inspector.GetPoseInFrame(geometry) @ points.T).T


class GraspScene:
    """Bin, heap and a gripper in a scene that is only asked, never simulated.

    A straight approach is checked in one query: the gripper's boxes are
    extended backwards along the approach by its length. For boxes and a
    translation along one of their axes that is the exact swept volume. So it
    is for stem and cup, which are cylinders, along their axis; for the jaw's
    approach, across it, their bounding boxes stand in.

    The jaw comes along its z axis, as four bodies: the base and the two
    fingers, which can be set at any opening. The suction cup comes along the
    cup's z axis with the jaw closed, as one body, its bellows compressed or
    extended by what ``cup_standoff`` says.

    Objects and bin ignore each other. Objects that are not in the poses set
    take no part.

    What is set stays set until it is set again, so whoever asks sets it first,
    as grasp planners do. Two threads cannot use one scene, nor a planner or a
    diagram that holds one, at the same time.

    Attributes:
        bin_points: (m, 3) points on the surface of the bin, in the world, m.
    """

    def __init__(
        self,
        objects: Sequence[ObjectModel],
        *,
        gripper: GripperGeometry,
        approach_distance: float = 0.10,
        cup_standoff: float = 0.002,
        bin_: Bin | None = None,
    ) -> None:
        """Builds the scene.

        Args:
            objects: whose convex pieces can be hit; names are unique.
            gripper: its frames and boxes.
            approach_distance: length of the straight approach, m.
            cup_standoff: the cup's box ends this far before its lip, m.
            bin_: in which they lie; by default the nominal cell's.

        Raises:
            ValueError: two objects with the same name.
        """
        if len({model.name for model in objects}) != len(objects):
            raise ValueError("objects of a grasp scene need unique names")
        self._open_width = gripper.open_width
        self._X_GB = {
            kind: np.linalg.inv(gripper.frame(kind)) for kind in gripper.kinds
        }

        builder = DiagramBuilder()
        plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
        self._plant = plant
        bin_body = add_bin(plant, bin_ or Bin())
        bin_ids = plant.GetCollisionGeometriesForBody(bin_body)
        self._owner: dict[GeometryId, str] = dict.fromkeys(bin_ids, "bin")
        inspector = scene_graph.model_inspector()
        self.bin_points = np.concatenate(
            [_points_on(inspector, geometry) for geometry in bin_ids]
        )

        self._instance = plant.AddModelInstance("grasp_scene")
        jaw, *cups = (
            gripper.approach(kind, approach_distance, cup_standoff)
            for kind in gripper.kinds
        )
        self._base, *fingers = (
            self._add_tool(f"jaw_{side:g}", jaw, jaw.closing == side)
            for side in (0.0, -1.0, 1.0)
        )
        self._fingers = dict(zip((-1.0, 1.0), fingers, strict=True))
        self._suctions = [
            self._add_tool("suction", cup, cup.closing == 0.0) for cup in cups
        ]
        self._objects = {
            model.name: self._add_object(model) for model in objects
        }
        plant.Finalize()

        tools = [self._base, *fingers, *self._suctions]
        for group in ([*self._objects.values(), bin_body], tools):
            scene_graph.collision_filter_manager().Apply(
                CollisionFilterDeclaration().ExcludeWithin(
                    plant.CollectRegisteredGeometries(group)
                )
            )
        self._diagram = builder.Build()
        self._root_context = self._diagram.CreateDefaultContext()
        self._context = plant.GetMyMutableContextFromRoot(self._root_context)
        self.set_poses({})

    def _add_tool(
        self, name: str, tool: GripperGeometry, part: np.ndarray
    ) -> RigidBody:
        """Adds a body of some of the boxes, or of the cylinders in them."""
        body = self._plant.AddRigidBody(name, self._instance, _INERTIA)
        boxes = tool.lower[part], tool.upper[part], tool.round[part]
        for i, (a, b, tube) in enumerate(zip(*boxes, strict=True)):
            length, width, height = b - a
            turn = _ALONG_X if tube else RotationMatrix()
            self._plant.RegisterCollisionGeometry(
                body,
                RigidTransform(turn, 0.5 * (a + b)),
                Cylinder(0.5 * width, length)
                if tube
                else Box(length, width, height),
                f"{name}_{i}",
                _FRICTION,
            )
        return body

    def _add_object(self, model: ObjectModel) -> RigidBody:
        body = self._plant.AddRigidBody(
            f"object {model.name}", self._instance, _INERTIA
        )
        piece: Any  # pydrake's stubs know no array types
        for i, piece in enumerate(model.pieces):
            geometry = self._plant.RegisterCollisionGeometry(
                body,
                RigidTransform(),
                Convex(points=piece.T, label=model.name),
                f"piece_{i}",
                _FRICTION,
            )
            self._owner[geometry] = model.name
        return body

    def _place(self, body: RigidBody, X_WB: RigidTransform) -> None:
        self._plant.SetFreeBodyPose(self._context, body, X_WB)

    def set_poses(self, poses: Mapping[str, np.ndarray]) -> None:
        """Places the objects.

        Args:
            poses: 4×4 X_WO of each object that takes part.

        Raises:
            KeyError: a name that is not in the scene.
        """
        unknown = set(poses) - set(self._objects)
        if unknown:
            raise KeyError(f"no such objects: {sorted(unknown)}")
        for name, body in self._objects.items():
            X_WO = poses.get(name)
            away = X_WO is None
            self._place(body, _OBJECT_AWAY if away else RigidTransform(X_WO))

    @contextmanager
    def without(self, name: str) -> Iterator[None]:
        """Takes an object out while the context lasts."""
        body = self._objects[name]
        saved = self._plant.GetFreeBodyPose(self._context, body)
        self._place(body, _OBJECT_AWAY)
        try:
            yield
        finally:
            self._place(body, saved)

    def _query(self) -> QueryObject:
        return self._plant.get_geometry_query_input_port().Eval(self._context)

    def _set_jaw(self, X_WG: np.ndarray, opening: float) -> None:
        X_WB = RigidTransform(X_WG @ self._X_GB[GraspKind.JAW])
        self._place(self._base, X_WB)
        travel = 0.5 * (self._open_width - opening)
        for side, body in self._fingers.items():
            self._place(body, X_WB @ RigidTransform([0, side * travel, 0]))
        for body in self._suctions:
            self._place(body, _TOOL_AWAY)

    def _set_suction(self, X_WG: np.ndarray) -> None:
        for body in [self._base, *self._fingers.values()]:
            self._place(body, _TOOL_AWAY)
        X_WB = RigidTransform(X_WG @ self._X_GB[GraspKind.SUCTION])
        for body in self._suctions:
            self._place(body, X_WB)

    def jaw_collides(self, X_WG: np.ndarray, opening: float) -> bool:
        """Returns whether the approach of the jaw hits anything.

        Args:
            X_WG: 4×4 pose of the jaw frame at the end of the approach.
            opening: distance of the pads, m.
        """
        self._set_jaw(X_WG, opening)
        return bool(self._query().HasCollisions())

    def suction_collides(self, X_WG: np.ndarray) -> bool:
        """Returns whether the approach of the suction cup hits anything.

        Args:
            X_WG: 4×4 pose of the cup frame at the end of the approach.
        """
        self._set_suction(X_WG)
        return bool(self._query().HasCollisions())

    def hit(self) -> tuple[str, ...]:
        """Returns what the last check hit: names of objects, or ``bin``."""
        pairs = self._query().ComputePointPairPenetration()
        names = {
            self._owner[id]
            for pair in pairs
            for id in (pair.id_A, pair.id_B)
            if id in self._owner
        }
        return tuple(sorted(names))
