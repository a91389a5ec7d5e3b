"""The gripper's model file, and how it behaves in a plant."""

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce

from tests.gripper.cells import STEP, DrivenCell, block
from tests.nominal import CELL
from tests.poses import downwards
from xray_drake.cell.gripper import load_gripper
from xray_drake.choices import CARRIERS
from xray_drake.grasping.gripper_geometry import gripper_geometry
from xray_drake.gripper.actuation.contact import ExecutionConfig
from xray_drake.gripper.carriers.carrier import Tracking
from xray_drake.gripper.carriers.paths import Leg
from xray_drake.gripper.grip_surfaces import GRIP, PAD
from xray_drake.scene.object_model import object_from_pieces
from xray_drake.scene.shapes import box


class Cell(DrivenCell):
    """The gripper with what its fingers do."""

    def close(self, force):
        """Closes within a second, with a force that never gets larger."""
        gripper, finger = self.gripper, 0.0
        lead = force / gripper.finger_stiffness
        for _ in range(200):
            finger = min(
                finger + gripper.finger_speed * STEP,
                float(self.fingers.mean()) + lead,
            )
            self.fix(fingers=np.array([finger, finger, 0, 0]))
            self.advance(STEP)

    def lift(self):
        self.move(np.array([0, 0, 0.08, 0, 0, 0]), 0.5)

    @property
    def fingers(self):
        return self.positions(self.gripper.finger_instance)

    @property
    def wrist(self):
        return self.positions(self.gripper.carrier_instance)

    @property
    def rates(self):
        """Of the wrist's joints."""
        return self.plant.GetVelocities(
            self.plant_context, self.gripper.carrier_instance
        )

    def effort(self, part):
        return self.diagram.GetOutputPort(f"{part}_effort").Eval(self.context)


@pytest.fixture(scope="module")
def alone():
    return Cell()


def jaw_at(z):
    return downwards(0.05, 0.02, z)


def brick(mass):
    return block((0.03, 0.03, 0.03), mass)


def pushed(cell, body, *force):
    """Pushes a body (N) from now on."""
    push = ExternallyAppliedSpatialForce()
    push.body_index = body.index()
    push.F_Bq_W = SpatialForce(tau=np.zeros(3), f=force)
    cell.fix(force=[push])


@pytest.mark.parametrize("time_step", [0.001, 0.005, 0.01])
def test_what_the_wrist_feels_is_contact_alone(time_step):
    """It goes as fast as it does to a grasp, and weighs 1.5 kg."""
    cell = Cell(time_step=time_step)
    wrist = cell.gripper.carrier
    start = cell.q
    end = start + np.array([0.02, -0.15, -0.15, 0, 0, 0])
    tick = 0
    for force in (0.0, 3.0):
        pushed(cell, cell.gripper.base, 0.0, 0.0, force)
        tick += round(0.2 / time_step)
        cell.simulator.AdvanceTo(tick * time_step)
        path = wrist.path(
            start, [Leg(end, 0.8)], tick * time_step, acceleration=4.0
        )
        felt = []
        while (time := tick * time_step) < path.end_time:
            desired, rate = path.sample(time)
            cell.want(desired, rate)
            tick += 1
            cell.simulator.AdvanceTo(tick * time_step)
            tracking = Tracking(
                cell.wrist, cell.rates, desired, rate, path.acceleration(time)
            )
            felt.append(wrist.force(tracking) + [0, 0, force])
        assert np.abs(felt).max() < 0.4 * ExecutionConfig.contact_force
        start, end = end, start


def outlines(cell):
    """Lower and upper corners of all collision shapes, in the base frame."""
    inspector = cell.scene_graph.model_inspector()
    plant, context = cell.plant, cell.plant.CreateDefaultContext()
    X_BW = cell.gripper.base.EvalPoseInWorld(context).inverse()
    found = {}
    for body in cell.gripper.bodies(plant):
        X_BL = X_BW @ body.EvalPoseInWorld(context)
        for geometry in plant.GetCollisionGeometriesForBody(body):
            around = inspector.GetObbInGeometryFrame(geometry)
            X_BS = X_BL @ inspector.GetPoseInFrame(geometry) @ around.pose()
            extent = np.abs(X_BS.rotation().matrix()) @ around.half_width()
            p = X_BS.translation()
            found.setdefault(body.name(), []).append((p - extent, p + extent))
    return found


def test_it_touches_nothing_that_planning_would_not(alone):
    geometry = gripper_geometry(load_gripper())
    for name, boxes in outlines(alone).items():
        closing = {"left_finger": -1, "right_finger": 1}.get(name, 0)
        own = geometry.closing == closing
        lower, upper = geometry.lower[own], geometry.upper[own]
        lows, highs = (
            np.array(corners) for corners in zip(*boxes, strict=True)
        )
        inside = (lows[:, None] >= lower - 1e-9) & (
            highs[:, None] <= upper + 1e-9
        )
        assert inside.all(axis=2).any(axis=1).all(), name
        # And the outline is the same, but for the bellows.
        bellows = [0.009, 0, 0] if closing == 0 else np.zeros(3)
        least, most = lower.min(axis=0), upper.max(axis=0) - bellows
        np.testing.assert_allclose(lows.min(axis=0), least, atol=1e-9)
        np.testing.assert_allclose(highs.max(axis=0), most, atol=1e-9)


def test_pads_are_where_and_as_large_as_planning_has_them(alone):
    inspector = alone.scene_graph.model_inspector()
    parameters = load_gripper()
    gap = 0.0
    for name, side in (("left_finger", 1), ("right_finger", -1)):
        body = alone.plant.GetBodyByName(name)
        shapes = {
            inspector.GetName(geometry).split("::")[-1]: geometry
            for geometry in alone.plant.GetCollisionGeometriesForBody(body)
        }
        width, _, height = inspector.GetShape(shapes[PAD]).size()
        assert (width, height) == (parameters.pad_width, parameters.pad_height)
        pad, finger = (
            side * inspector.GetPoseInFrame(shapes[kind]).translation()[1]
            - inspector.GetShape(shapes[kind]).size()[1] / 2
            for kind in (PAD, "finger")
        )
        assert finger - pad == pytest.approx(0.001)
        gap += 0.029 + pad  # where the finger stands when open
    assert gap == pytest.approx(parameters.opening)


def test_frames_are_those_of_planning_and_it_waits_at_home(alone):
    gripper, carrier = alone.gripper, alone.gripper.carrier
    geometry = gripper_geometry(load_gripper())
    np.testing.assert_allclose(gripper.X_BJ, geometry.X_BJ, atol=1e-12)
    np.testing.assert_allclose(gripper.X_BC, geometry.X_BC, atol=1e-12)
    X_WB = carrier.pose(carrier.home)
    np.testing.assert_allclose(X_WB @ gripper.X_BJ, CELL.X_WH, atol=1e-9)
    context = alone.plant.CreateDefaultContext()
    stands = gripper.base.EvalPoseInWorld(context).GetAsMatrix4()
    np.testing.assert_allclose(stands, X_WB, atol=1e-9)


@pytest.mark.parametrize("carrier", CARRIERS)
def test_at_home_the_camera_does_not_see_it(carrier):
    cell = Cell(camera=True, carrier=carrier)
    gripper, plant = cell.gripper, cell.plant
    labels = [
        int(index)
        for instance in (gripper.finger_instance, gripper.carrier_instance)
        for index in plant.GetBodyIndices(instance)
    ]
    port = cell.diagram.GetOutputPort("label")
    assert not np.isin(port.Eval(cell.context).data, labels).any()
    cell.at(jaw_at(0.1))
    assert np.isin(port.Eval(cell.context).data, labels).any()


def test_its_fingers_are_one():
    """What pushes on one moves both; the wrist stays where it is."""
    cell = Cell()
    cell.fix(fingers=np.array([0.01, 0.01, 0, 0]))
    cell.advance(0.3)
    np.testing.assert_allclose(cell.wrist, cell.gripper.carrier.home, atol=1e-6)
    np.testing.assert_allclose(cell.fingers, 0.01, atol=1e-5)
    pushed(cell, cell.plant.GetBodyByName("left_finger"), 0.0, 8.0, 0.0)
    cell.advance(0.3)
    moved = np.abs(cell.fingers - 0.01)
    np.testing.assert_allclose(moved, 8.0 / (2 * 2000.0), rtol=0.05)
    assert cell.fingers[0] == pytest.approx(cell.fingers[1], abs=1e-5)


@pytest.mark.parametrize(
    ("force", "mass", "holds"),
    [(20.0, 0.3, True), (3.5, 0.3, True), (2.4, 0.3, False)],
)
def test_what_friction_can_hold(force, mass, holds):
    """Two pads of friction ½ hold as much as each squeezes: 2.94 N here."""
    cell = Cell(brick(mass))
    cell.at(jaw_at(0.015))
    cell.close(force)
    assert np.abs(cell.effort("fingers")).max() <= force + 0.1
    start = cell.height("brick")
    cell.lift()
    lifted = cell.height("brick") - start
    if holds:
        assert lifted == pytest.approx(0.08, abs=0.003)
    else:
        assert lifted < 0.06


def step(name):
    pieces = [
        *box(0.04, 0.03, 0.02).surfaces,
        *box(0.02, 0.03, 0.02, (0.0, 0.0, 0.02)).surfaces,
    ]
    return object_from_pieces(name, pieces, density=500.0)


class Scene(DrivenCell):
    """Two objects on the floor, and the jaw about them."""

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
    inspector = scene.scene_graph.model_inspector()
    names = [inspector.GetName(i) for i in inspector.GetAllGeometryIds()]
    assert sum(f"::{GRIP}_" in name for name in names) == 2 * 2  # of pieces
