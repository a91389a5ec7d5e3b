"""Cubes of 4 cm in the bin, to be put to sleep and woken."""

from itertools import combinations

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from xray_drake.scene.object_model import ObjectModel, object_from_pieces
from xray_drake.scene.plant import (
    add_bin,
    add_objects,
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


class Cubes:
    """A plant with bin, tote and cubes, and its simulation.

    Args:
        positions: of each cube's centre, m.
    """

    def __init__(self, **positions: tuple[float, float, float]) -> None:
        builder = DiagramBuilder()
        self.plant, self.scene_graph = add_plant(
            builder, default_plant_config()
        )
        add_bin(self.plant, with_tote=True)
        items = add_objects(self.plant, [cube(name) for name in positions])
        self.items = {item.name: item for item in items}
        for name, p_WO in positions.items():
            self.items[name].joint.SetDefaultPose(RigidTransform(list(p_WO)))
        self.plant.Finalize()
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        self.root = self.simulator.get_mutable_context()
        self.context = self.plant.GetMyMutableContextFromRoot(self.root)

    def advance(self, duration: float) -> None:
        self.simulator.AdvanceTo(self.root.get_time() + duration)

    def pose(self, name: str) -> np.ndarray:
        body = self.items[name].body
        return body.EvalPoseInWorld(self.context).GetAsMatrix4()

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
        inspector = query.inspector()
        shapes = {
            name: self.plant.GetCollisionGeometriesForBody(
                self.plant.GetBodyByName(name)
            )
            for name in (*self.items, "bin", "tote")
        }
        return {
            frozenset((one, other))
            for one, other in combinations(shapes, 2)
            if not all(
                inspector.CollisionFiltered(a, b)
                for a in shapes[one]
                for b in shapes[other]
            )
        }
