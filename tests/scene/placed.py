"""Objects in a plant, seen by cameras; cubes to be put to sleep and woken."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraConfig

from tests.nominal import CELL
from xray_drake.geometry.camera import PinholeCamera
from xray_drake.scene.cameras import add_camera
from xray_drake.scene.object_model import ObjectModel, object_from_pieces
from xray_drake.scene.plant import (
    add_cell,
    add_object,
    add_plant,
    default_plant_config,
)
from xray_drake.scene.shapes import box

HALF = 0.02


def cube(name: str) -> ObjectModel:
    side = 2 * HALF
    return object_from_pieces(
        name, list(box(side, side, side).surfaces), density=500.0
    )


class Placed:
    """Bin, tote, objects and a camera, and their simulation.

    Args:
        models: the objects.
        poses: name to position or 4×4 pose, m.
        camera: what looks at them.
    """

    def __init__(
        self,
        models: Iterable[ObjectModel],
        poses: Mapping[str, Sequence[float] | np.ndarray] | None = None,
        *,
        camera: CameraConfig | None = None,
        **options: Any,
    ) -> None:
        builder = DiagramBuilder()
        self.plant, self.scene_graph = add_plant(
            builder, default_plant_config()
        )
        add_cell(self.plant, CELL)
        self.items = {
            model.name: add_object(self.plant, model, **options)
            for model in models
        }
        for name, X_WO in (poses or {}).items():
            X = RigidTransform(np.array(X_WO, dtype=float))
            self.items[name].joint.SetDefaultPose(X)
        self.plant.Finalize()
        if camera is not None:
            sensor, source = add_camera(builder, self.scene_graph, camera)
            assert sensor.get_name() == camera.name
            self._ports = {
                "depth": sensor.depth_image_32F_output_port(),
                "label": sensor.label_image_output_port(),
                "color": sensor.color_image_output_port(),
                "camera": source.get_output_port(),
            }
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        self.root = self.simulator.get_mutable_context()
        self.context = self.plant.GetMyMutableContextFromRoot(self.root)

    def advance(self, duration: float) -> None:
        self.simulator.AdvanceTo(self.root.get_time() + duration)

    def pose(self, name: str) -> np.ndarray:
        body = self.items[name].body
        return body.EvalPoseInWorld(self.context).GetAsMatrix4()

    def _seen(self, name: str) -> Any:
        port = self._ports[name]
        return port.Eval(port.get_system().GetMyContextFromRoot(self.root))

    def image(self, name: str) -> np.ndarray:
        data = self._seen(name).data
        return np.array(data[:, :, 0] if data.shape[2] == 1 else data)

    @property
    def camera(self) -> PinholeCamera:
        return self._seen("camera")

    def mask(self, name: str) -> np.ndarray:
        return self.image("label") == int(self.items[name].body_index)


class Cubes(Placed):
    """Cubes of 4 cm, whose centres are at given positions, m."""

    def __init__(self, **positions: tuple[float, float, float]) -> None:
        super().__init__(map(cube, positions), positions)

    def height(self, name: str) -> float:
        return float(self.pose(name)[2, 3])

    def put(self, name: str, *p_WO: float) -> None:
        """Sets a cube's position, upright and as fast as it was."""
        self.items[name].joint.SetPose(self.context, RigidTransform(list(p_WO)))

    def push(self, name: str, *v_WO: float) -> None:
        """Sets a cube's velocity, m/s."""
        joint = self.items[name].joint
        joint.set_translational_velocity(self.context, np.array(v_WO))

    def locked(self) -> set[str]:
        return {
            name
            for name, item in self.items.items()
            if item.joint.is_locked(self.context)
        }

    def compared(self) -> set[frozenset[str]]:
        """Names of the two bodies of each contact that is looked for."""
        query = self.scene_graph.get_query_output_port().Eval(
            self.scene_graph.GetMyContextFromRoot(self.root)
        )
        filtered = query.inspector().CollisionFiltered
        shapes = {
            name: self.plant.GetCollisionGeometriesForBody(
                self.plant.GetBodyByName(name)
            )[-1]
            for name in (*self.items, "bin", "tote")
        }
        return {
            frozenset(pair)
            for pair in combinations(shapes, 2)
            if not filtered(*(shapes[name] for name in pair))
        }
