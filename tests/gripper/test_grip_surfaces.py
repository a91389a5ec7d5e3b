import numpy as np
import pytest
from pydrake.math import RigidTransform

from tests.gripper.cells import DrivenCell
from tests.poses import downwards
from xray_drake.gripper.grip_surfaces import GRIP, PAD
from xray_drake.scene.object_model import object_from_pieces
from xray_drake.scene.shapes import box


def step(name):
    pieces = [
        *box(0.04, 0.03, 0.02).surfaces,
        *box(0.02, 0.03, 0.02, (0.0, 0.0, 0.02)).surfaces,
    ]
    return object_from_pieces(name, pieces, density=500.0)


class Scene(DrivenCell):
    def touching(self, jaw, a, b):
        """Which kinds of geometry may meet, with both objects on the floor.

        Args:
            jaw: where the open jaw is, pointing down, m.
            a: x of the first object, m.
            b: x of the second, m.
        """
        self.at(downwards(*jaw))
        context = self.plant_context
        self.plant.SetPositions(
            context, self.gripper.finger_instance, np.full(2, 0.011)
        )
        for item, x in zip(self.items.values(), (a, b), strict=True):
            item.joint.SetPose(context, RigidTransform([x, 0.0, 0.0145]))
        query = self.plant.get_geometry_query_input_port().Eval(context)
        inspector = self.scene_graph.model_inspector()

        def kind(geometry):
            name = inspector.GetName(geometry).split("::")[-1]
            return name.rstrip("_0123456789").split("_")[0]

        return {
            frozenset({kind(first), kind(second)})
            for first, second in query.FindCollisionCandidates()
        }


@pytest.fixture(scope="module")
def scene():
    return Scene(step("a"), step("b"))


def test_pads_meet_the_hard_surfaces_and_nothing_else_does(scene):
    """The jaw about the first object, a finger well into it, and the second
    into it and the floor; then the jaw on the floor."""
    touching = scene.touching((0.0, 0.005, 0.01), 0.0, 0.03)
    assert [pair for pair in touching if GRIP in pair] == [{PAD, GRIP}]
    assert frozenset({PAD, "piece"}) not in touching
    # Objects meet each other, the floor and the fingers as ever.
    for other in ("piece", "floor", "finger"):
        assert frozenset({"piece", other}) in touching
    touching = scene.touching((0.1, 0.1, 0.001), -0.1, -0.2)
    assert frozenset({PAD, "floor"}) in touching
